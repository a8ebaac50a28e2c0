"""`Camera` and `CameraPair`: two calibrated cameras whose pictures are not rectified."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.sizes import wrong_size
from mobilestereonet.errors import InputError

Matrix: TypeAlias = NDArray[np.float64]
Size: TypeAlias = tuple[int, int]
"""Width and height in px."""

PINHOLE_COEFFICIENTS = (5, 8, 12, 14)
"""Numbers of distortion coefficients that OpenCV's pinhole model has, besides four and none."""

FISHEYE_COEFFICIENTS = 4

MAX_ROTATION_ERROR = 5e-3
"""Largest entry of R R^T - 1 for a rotation R that a file has in few digits."""

MIN_FOCAL_PER_WIDTH = 0.05
"""Shortest focal length that is believed, per width: a view of 169 degrees."""

MAX_VIEW_DEG = 155.0
"""Widest horizontal view of a picture that is not one of a fisheye lens."""

_IDENTITY = np.eye(3)


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics of one camera.

    Attributes:
        matrix: Camera matrix in px, (3, 3).
        distortion: Distortion coefficients in OpenCV's order, (n,).
        fisheye: Whether they are those of `cv2.fisheye` (equidistant), not of the pinhole model.

    Raises:
        InputError: If the matrix is none of a camera, or the model has not so many coefficients.
    """

    matrix: Matrix
    distortion: Matrix
    fisheye: bool = False

    def __post_init__(self) -> None:
        check_camera_matrix(self.matrix)
        count = len(self.distortion)
        if not np.isfinite(self.distortion).all():
            raise InputError(f"distortion must be finite, got {self.distortion.tolist()}")
        if self.fisheye and count != FISHEYE_COEFFICIENTS:
            raise InputError(f"a fisheye lens has 4 distortion coefficients, got {count}")
        if not self.fisheye and count not in (0, 4, *PINHOLE_COEFFICIENTS):
            raise InputError(
                "a pinhole camera has 0, 4, 5, 8, 12 or 14 distortion coefficients, "
                f"k1 k2 p1 p2 k3 ..., got {count}: write 0 for those that were not calibrated"
            )

    @property
    def distorts(self) -> bool:
        """Whether straight lines are bent."""
        return self.fisheye or bool(self.distortion.any())

    def resized(self, factors: tuple[float, float]) -> Camera:
        """The same camera, its pictures resized by factors of width and height."""
        return replace(self, matrix=resized_matrix(self.matrix, factors))


@dataclass(frozen=True, eq=False)
class Rectification:
    """Rotations and projections that rectify the pictures of two cameras.

    Attributes:
        rotations: Of the left and the right camera into the rectified frame, (3, 3) each.
        projections: Of the rectified frame to pixels, (3, 4) each, with the baseline in metres.
        size: Width and height of the rectified pictures; None if it is that of the raw ones.
    """

    rotations: tuple[Matrix, Matrix]
    projections: tuple[Matrix, Matrix]
    size: Size | None = None


@dataclass(frozen=True, eq=False)
class CameraPair:
    """Two cameras whose pictures are not rectified.

    Attributes:
        left: The left camera.
        right: The right camera.
        rotation: From the left camera's frame to the right one's, (3, 3).
        translation: The same, (3,), in metres.
        size: Width and height of their pictures, in px; None if unknown.
        rectification: How to rectify them, where the file tells.

    Raises:
        InputError: If the rotation is none, or a value cannot be right.
    """

    left: Camera
    right: Camera
    rotation: Matrix
    translation: Matrix
    size: Size | None = None
    rectification: Rectification | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", checked_rotation(self.rotation, "R"))
        if not np.isfinite(self.translation).all() or not self.translation.any():
            raise InputError(
                f"T must be finite and not zero, it is the baseline, got {self.translation}"
            )
        if self.left.fisheye != self.right.fisheye:
            raise InputError(
                "one camera is a fisheye and the other one is not: such a pair cannot be rectified"
            )
        x, y, _ = -self.rotation.T @ self.translation  # of the right camera
        if abs(y) > abs(x):
            raise InputError(
                "the cameras are one above the other: only pairs side by side are matched"
            )
        if x < 0:
            raise InputError(
                f"the baseline must be positive, got {x:g} m: are the cameras swapped?"
            )
        if self.size is not None:
            self.check_size(self.size)

    def check_size(self, size: Size) -> None:
        """Check that the cameras can have taken pictures of this size.

        Raises:
            InputError: If they were calibrated at another one, or a principal point is outside.
        """
        if self.size is not None and self.size != size:
            raise wrong_size(self.size, size, "the cameras were calibrated at")
        for camera, side in ((self.left, "left"), (self.right, "right")):
            check_principal_point(camera.matrix, size, side)
            check_focal_lengths(camera.matrix, size, side, fisheye=camera.fisheye)

    def resized(self, size: Size) -> CameraPair:
        """The same cameras, their pictures resized to another width and height."""
        assert self.size is not None
        factors = (size[0] / self.size[0], size[1] / self.size[1])
        rectification = self.rectification
        if rectification is not None:
            left, right = (resized_matrix(p, factors) for p in rectification.projections)
            own = rectification.size
            rectified = own and (round(own[0] * factors[0]), round(own[1] * factors[1]))
            rectification = replace(rectification, projections=(left, right), size=rectified)
        return replace(
            self,
            left=self.left.resized(factors),
            right=self.right.resized(factors),
            size=size,
            rectification=rectification,
        )

    @property
    def is_rectified(self) -> bool:
        """Whether raw pictures are rectified ones: of parallel, like cameras that bend nothing."""
        alike = np.allclose(self.left.matrix[1], self.right.matrix[1], atol=1e-3)
        alike &= np.isclose(self.left.matrix[0, 0], self.right.matrix[0, 0], atol=1e-3)
        parallel = np.allclose(self.rotation, _IDENTITY, atol=1e-6)
        along_x = np.abs(self.translation[1:]).max() <= 1e-6 * abs(self.translation[0])
        bend = self.left.distorts or self.right.distorts
        stays = self.rectification is None or all(
            np.allclose(projection[:, :3], camera.matrix, atol=1e-3)
            for projection, camera in zip(
                self.rectification.projections, (self.left, self.right), strict=True
            )
        )
        return bool(alike and parallel and along_x and stays and not bend)


def resized_matrix(matrix: Matrix, factors: tuple[float, float]) -> Matrix:
    """A camera or projection matrix of pictures that are resized, pixel centres at integers."""
    result = matrix.copy()
    for axis, factor in enumerate(factors):
        result[axis] *= factor
        result[axis, 2] += (factor - 1) / 2
    return result


def check_camera_matrix(matrix: Matrix, name: str = "K") -> None:
    """Check the first three columns of a camera or projection matrix.

    Raises:
        InputError: If it is none.
    """
    square = matrix[:, :3]
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} must be finite, got {matrix.tolist()}")
    if not np.allclose(square[2], (0, 0, 1), atol=1e-6):
        if np.allclose(square[:, 2], (0, 0, 1), atol=1e-6):
            raise InputError(
                f"{name} is transposed, as MATLAB has it, its rows are {square.tolist()}: write "
                "fx 0 cx; 0 fy cy; 0 0 1"
            )
        raise InputError(f"the last row of {name} must be 0 0 1, got {square[2].tolist()}")
    for axis, focal in ((0, "fx"), (1, "fy")):
        if not square[axis, axis] > 0:
            raise InputError(f"{name}: {focal} must be positive, got {square[axis, axis]:g}")
    if abs(square[0, 1]) > 0.1 * square[0, 0] or abs(square[1, 0]) > 1e-3 * square[1, 1]:
        raise InputError(f"{name} is no camera matrix fx 0 cx; 0 fy cy; 0 0 1: {square.tolist()}")


def check_principal_point(matrix: Matrix, size: Size, side: str) -> None:
    """Check that a camera's principal point is in its pictures.

    Raises:
        InputError: If it is not.
    """
    width, height = size
    cx, cy = matrix[:2, 2]
    if not (-0.5 <= cx <= width - 0.5 and -0.5 <= cy <= height - 0.5):
        raise InputError(
            f"the {side} camera's principal point ({cx:g}, {cy:g}) is outside of its pictures of "
            f"{width}x{height}: is it the calibration of another size?"
        )


def check_focal_lengths(matrix: Matrix, size: Size, side: str, *, fisheye: bool = False) -> None:
    """Check that a camera's focal lengths are in pixels of pictures of this size.

    Raises:
        InputError: If they are not.
    """
    width, height = size
    fx, fy = matrix[0, 0], matrix[1, 1]
    if min(fx / width, fy / width) < MIN_FOCAL_PER_WIDTH:
        raise InputError(
            f"the {side} camera's focal lengths are {fx:g} and {fy:g} for pictures of "
            f"{width}x{height}: they must be in pixels, not in millimetres"
        )
    view = math.degrees(2 * math.atan(width / 2 / fx))
    if view > MAX_VIEW_DEG and not fisheye:
        raise InputError(
            f"the {side} camera's focal length of {fx:g} px gives pictures of {width}x{height} a "
            f"view of {view:.0f} degrees: is it of pictures of another size, or of a fisheye lens "
            "(--fisheye)? With predict, batch, video and live, --fov DEGREES --baseline METRES in "
            "place of the file confirms so wide a view"
        )


def checked_rotation(rotation: Matrix, name: str) -> Matrix:
    """The rotation nearest to a matrix that is one up to rounding.

    Args:
        rotation: (3, 3), or a rotation vector (3,) in radians.
        name: What messages call it.

    Raises:
        InputError: If it is none.
    """
    if rotation.size == 3:
        rotation = np.asarray(cv2.Rodrigues(rotation.reshape(3))[0], np.float64)
    if not np.isfinite(rotation).all():
        raise InputError(f"{name} must be finite, got {rotation.tolist()}")
    if np.abs(rotation @ rotation.T - _IDENTITY).max() > MAX_ROTATION_ERROR:
        raise InputError(
            f"{name} is no rotation, its rows are not orthonormal: {rotation.tolist()}"
        )
    if np.linalg.det(rotation) < 0:
        raise InputError(f"{name} is no rotation but a reflection, its determinant is -1")
    u, _, v = np.linalg.svd(rotation)
    return np.asarray(u @ v, np.float64)
