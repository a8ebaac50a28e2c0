"""Points as a laser scanner gives them: the .bin files of KITTI."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mobilestereonet.atomic import write_atomically
from mobilestereonet.inference import PointCloud

Pose: TypeAlias = NDArray[np.float64]
"""Rotation and translation from one frame to another, (3, 4), in metres."""

FORWARD_LEFT_UP: Pose = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0]], np.float64)
"""From a camera's frame to a scanner's axes at the same place."""


def write_laser_points(path: Path, cloud: PointCloud, pose: Pose | None) -> None:
    """Write points as KITTI's scanner does, atomically: x forward, y left, z up, reflectance.

    Args:
        path: The file: float32, four numbers per point. The reflectance is 1.
        cloud: Points in the left camera's frame.
        pose: From there to the scanner; if unknown, only the axes change.
    """
    matrix = FORWARD_LEFT_UP if pose is None else pose
    values = np.ones((len(cloud.points), 4), "<f4")
    values[:, :3] = cloud.points @ matrix[:, :3].T + matrix[:, 3]
    write_atomically(path, lambda temporary: temporary.write_bytes(values.tobytes()))
