"""ROS's camera_info: the messages of a stereo camera, or the files of its calibration."""

from __future__ import annotations

from typing import Any

import numpy as np

from mobilestereonet.data.rig.cameras import (
    Camera,
    CameraPair,
    Matrix,
    Rectification,
    Size,
    checked_rotation,
)
from mobilestereonet.data.rig.entries import Entries
from mobilestereonet.data.rig.lenses import camera_of
from mobilestereonet.data.rig.rectified import from_projections
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.rig.values import matrix_of, number_of, size_of
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

PROJECTION = ("projection_matrix", "P", "p")
"""Names in a file, in ROS 1's messages, in ROS 2's."""

_MATRIX = ("camera_matrix", "K", "k")
_DISTORTION = ("distortion_coefficients", "D", "d")
_RECTIFICATION = ("rectification_matrix", "R", "r")
_SIDES = (("image_width", "image_height"), ("width", "height"))
_MAX_DISTANCE = 0.15
"""How far a principal point usually is from the middle, per width."""


def is_camera_info(entries: Entries) -> bool:
    """Whether entries are one camera's camera_info."""
    return not entries.keys().isdisjoint(PROJECTION) and not {"P1", "P2"} <= entries.keys()


def pair_of_infos(
    left: Entries | None, right: Entries, told: Told
) -> tuple[CameraPair | Calibration, ...]:
    """Geometries of a stereo camera: of its raw pictures, where that is known, and the rectified.

    Args:
        left: Left camera's camera_info; None if it is not given. Then both views have the right
            one's principal point, as `cv2.stereoRectify` sees to by default.
        right: Right camera's camera_info.
        told: What the user says.

    Raises:
        InputError: If a value is missing or impossible.
    """
    right_window = _Window(right)
    right_projection = right_window.apply(matrix_of(right, PROJECTION, (3, 4)))
    if left is None:
        if right_projection[0, 3] == 0 and told.baseline is None:
            raise InputError(
                "its projection matrix has no baseline: it is the left camera's file, or the "
                "baseline is in the other one's; give both, --rig LEFT --rig RIGHT"
            )
        if right_projection[0, 3] > 0:
            raise InputError(
                f"the baseline must be positive, got "
                f"{-right_projection[0, 3] / right_projection[0, 0]:g} m: are the cameras swapped? "
                "Give both files, --rig LEFT --rig RIGHT"
            )
        left_projection = right_projection * [1, 1, 1, 0]
        return (from_projections(left_projection, right_projection, told, "m", right_window.size),)
    left_window = _Window(left)
    left_projection = left_window.apply(matrix_of(left, PROJECTION, (3, 4)))
    if left_window.size != right_window.size:
        raise InputError(
            f"the pictures are {left_window.size} (left) and {right_window.size} (right): two "
            "views must have one size"
        )
    size = left_window.size
    rectified = from_projections(left_projection, right_projection, told, "m", size)
    if told.rectified or not all(_tells_raw(info) for info in (left, right)):
        return (rectified,)
    cameras = [
        _raw_camera(info, window, told)
        for info, window in ((left, left_window), (right, right_window))
    ]
    rotations = [
        checked_rotation(matrix_of(info, _RECTIFICATION, (3, 3)), "R") for info in (left, right)
    ]
    projections = in_metres(left_projection, right_projection, rectified.baseline)
    pair = calibrated_pair(cameras, rotations, projections, rectified.baseline, size)
    return (rectified,) if pair.is_rectified else (pair, rectified)


def calibrated_pair(
    cameras: list[Camera],
    rotations: list[Matrix],
    projections: tuple[Matrix, Matrix],
    baseline: float,
    size: Size | None,
    rectified_size: Size | None = None,
) -> CameraPair:
    """Two cameras from how each is rectified: the rotations tell how they stand to each other.

    Args:
        cameras: The left and the right camera.
        rotations: Of each into the rectified frame, (3, 3).
        projections: Of the rectified frame to pixels, (3, 4).
        baseline: Distance between the cameras in metres.
        size: Width and height of the raw pictures.
        rectified_size: That of the rectified ones, if it is another one.

    Raises:
        InputError: If a value is impossible.
    """
    left, right = rotations
    return CameraPair(
        left=cameras[0],
        right=cameras[1],
        rotation=right.T @ left,
        translation=right.T @ np.array([-baseline, 0, 0]),
        size=size,
        rectification=Rectification((left, right), projections, rectified_size),
    )


def in_metres(left: Matrix, right: Matrix, baseline: float) -> tuple[Matrix, Matrix]:
    """Projection matrices whose first camera is the left one and whose unit is the metre."""
    left, right = left * [1, 1, 1, 0], right * [1, 1, 1, 0]
    right[0, 3] = -baseline * right[0, 0]
    return left, right


def _tells_raw(info: Entries) -> bool:
    """Whether a camera_info tells how raw pictures are made; a K or R that it does not is 0."""
    known = all(
        not info.keys().isdisjoint(names) for names in (_MATRIX, _DISTORTION, _RECTIFICATION)
    )
    return known and all(
        bool(matrix_of(info, names, (9,)).any()) for names in (_MATRIX, _RECTIFICATION)
    )


def _raw_camera(info: Entries, window: _Window, told: Told) -> Camera:
    matrix = window.apply(matrix_of(info, _MATRIX, (3, 3)))
    distortion = matrix_of(info, _DISTORTION, (-1,))
    return camera_of(matrix, distortion, str(info.get("distortion_model") or "plumb_bob"), told)


class _Window:
    """The part of a sensor that is read out, and its binning.

    Width, height, K and P are of the full sensor by ROS's definition; the picture is
    the region of interest, divided by the binning. Some drivers give K and P of the binned picture.

    Attributes:
        size: Width and height of the pictures; None if unknown.
    """

    def __init__(self, info: Entries) -> None:
        self.binning = [max(number_of(info, f"binning_{axis}", 0), 1) for axis in "xy"]
        roi: Any = info.get("roi") or {}
        if not isinstance(roi, dict):
            raise InputError(f"roi must hold x_offset, y_offset, width and height, got {roi!r}")
        self.offset = [number_of(roi, f"{axis}_offset", 0) for axis in "xy"]
        full = None
        for names in _SIDES:
            if full is None and set(names) <= info.keys():
                full = size_of(*(number_of(info, name) for name in names))
        self.full = full
        part = size_of(number_of(roi, "width", 0), number_of(roi, "height", 0)) or full
        self.size = part and (
            int(part[0] // self.binning[0]),
            int(part[1] // self.binning[1]),
        )

    def apply(self, matrix: Matrix) -> Matrix:
        """A matrix of the full sensor as one of the pictures."""
        result = matrix.copy()
        if self._is_binned(matrix):
            return result
        for axis, (offset, binning) in enumerate(zip(self.offset, self.binning, strict=True)):
            result[axis, 2] -= offset
            result[axis] /= binning
        return result

    def _is_binned(self, matrix: Matrix) -> bool:
        """Whether a matrix is of the binned picture: its principal point is near the middle."""
        if self.full is None or max(self.binning) == 1:
            return False
        place = matrix[:2, 2] / self.full
        binned = np.abs(place - 0.5 / np.array(self.binning)).max()
        return bool(binned < _MAX_DISTANCE and binned < np.abs(place - 0.5).max())
