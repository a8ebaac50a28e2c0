"""What a reader finds in a calibration file."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from mobilestereonet.data.rig.cameras import Camera, CameraPair, Matrix, Size, checked_rotation
from mobilestereonet.data.rig.rectified import from_cameras
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

Geometry: TypeAlias = CameraPair | Calibration
"""Of raw pictures, or of rectified ones."""


class Description(NamedTuple):
    """What a reader finds in a calibration file.

    Attributes:
        geometries: Of raw and of rectified pictures, in order of precedence.
        notes: What was assumed, in words for the user.
    """

    geometries: tuple[Geometry, ...]
    notes: tuple[str, ...] = ()


class Pose(NamedTuple):
    """How points of one camera's frame are placed in another one's: rotation x + translation."""

    rotation: Matrix
    translation: Matrix

    @classmethod
    def of_matrix(cls, matrix: Matrix, name: str) -> Pose:
        """The pose in a homogeneous matrix (4, 4).

        Raises:
            InputError: If its rotation is none.
        """
        if not np.allclose(matrix[3], (0, 0, 0, 1)):
            raise InputError(f"the last row of {name} must be 0 0 0 1, got {matrix[3].tolist()}")
        return cls(checked_rotation(matrix[:3, :3], name), matrix[:3, 3])

    def inverse(self) -> Pose:
        """How points of the other frame are placed in this one."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def after(self, first: Pose) -> Pose:
        """This pose after another one."""
        return Pose(
            self.rotation @ first.rotation, self.rotation @ first.translation + self.translation
        )

    @property
    def is_to_the_left(self) -> bool:
        """Whether the other camera stands to the left of this one."""
        return bool(self.inverse().translation[0] < 0)


def pair_of(
    left: Camera,
    right: Camera,
    pose: Pose,
    told: Told,
    unit: str = "m",
    size: Size | None = None,
) -> Geometry:
    """Geometry of the pictures of two cameras; those of parallel, like ones are rectified as is.

    Args:
        left: The left camera.
        right: The right camera.
        pose: Of the left camera's frame in the right one's, in the format's unit.
        told: What the user says.
        unit: The format's unit.
        size: Width and height of the pictures.

    Raises:
        InputError: If a value is impossible.
    """
    length = float(np.linalg.norm(pose.translation))
    metres = told.metres(length, unit)
    direction = pose.translation / length if length else np.array([-1.0, 0, 0])
    pair = CameraPair(left, right, pose.rotation, direction * metres, size)
    if pair.is_rectified:
        return from_cameras(left.matrix, right.matrix, metres, size=size)
    return pair


def matrix_of_numbers(fx: float, fy: float, cx: float, cy: float) -> Matrix:
    """Camera matrix of focal lengths and principal point in px."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def one_size(left: Size | None, right: Size | None) -> Size | None:
    """The size of both cameras' pictures.

    Raises:
        InputError: If they differ.
    """
    if None not in (left, right) and left != right:
        raise InputError(f"the pictures are {left} (left) and {right} (right), not of one size")
    return left or right


def chosen_two(numbers: list[int], name: str) -> tuple[int, int]:
    """The two cameras that a file has.

    Raises:
        InputError: If it has others.
    """
    if len(numbers) != 2:
        known = " ".join(f"{name}{number}" for number in numbers)
        raise InputError(
            f"the file has {len(numbers)} camera(s), {known}: name the left and the right one, "
            "such as --cameras 0 1"
        )
    return numbers[0], numbers[1]
