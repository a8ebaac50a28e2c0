"""Depth in metres and point clouds from disparity maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.disparity_files import KITTI_SCALE
from mobilestereonet.data.images import FloatMap, Mask, Picture
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

MIN_DISPARITY_PX = 1 / KITTI_SCALE
"""Smallest disparity that gives a depth: the step of KITTI's files."""

MAX_DISPARITY_GRADIENT = 1.0
"""Pixels of disparity per pixel: a steeper surface is hidden from the right camera."""

POINT_FORMATS = (".ply", ".glb")


def depth_from_disparity(disparity: FloatMap, valid: Mask, calibration: Calibration) -> FloatMap:
    """Depth along the optical axis: focal * baseline / (disparity + doffs).

    Args:
        disparity: (H, W), in pixels of the left view.
        valid: (H, W), False where the disparity is not known.
        calibration: Geometry of the pair, for this size.

    Returns:
        (H, W) float32 in metres. Never NaN or infinite: 0 where it is not known, which is where
        ``valid`` is False, the disparity (plus ``doffs``) is below 1/256 px, or float32 ends.

    Raises:
        InputError: If the calibration is known to be of another size.
    """
    height, width = disparity.shape
    calibration.require_size(width, height)
    shifted = disparity + np.float32(calibration.doffs)
    known = valid & (shifted >= MIN_DISPARITY_PX)
    with np.errstate(over="ignore"):
        depth = calibration.focal * calibration.baseline / np.where(known, shifted, 1)
        depth = depth.astype(np.float32)
    return np.where(known & np.isfinite(depth), depth, np.float32(0))


def depth_edges(disparity: FloatMap, valid: Mask) -> Mask:
    """Mask of depth edges, where a network's disparity lies between two surfaces.

    Args:
        disparity: (H, W), in px.
        valid: (H, W), False where the disparity is not known.

    Returns:
        (H, W), True on both sides of each step above `MAX_DISPARITY_GRADIENT` between neighbours
        in a row or a column.
    """
    known = np.where(valid, disparity, np.nan)  # a step to the unknown is none
    down = np.abs(np.diff(known, axis=0)) > MAX_DISPARITY_GRADIENT
    right = np.abs(np.diff(known, axis=1)) > MAX_DISPARITY_GRADIENT
    edges = np.zeros(disparity.shape, dtype=bool)
    edges[1:] |= down
    edges[:-1] |= down
    edges[:, 1:] |= right
    edges[:, :-1] |= right
    return edges


@dataclass(frozen=True)
class PointCloud:
    """Coloured point cloud in the left camera's frame: x to the right, y down, z forward.

    Attributes:
        points: (N, 3) float32, in metres.
        colours: (N, 3) uint8, RGB.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8]

    def save(self, path: str | Path) -> None:
        """Write the points atomically.

        Args:
            path: ``.ply``, in the camera's frame; or ``.glb``, with y up and z backward, as that
                format has it, so that viewers show the cloud upright and from the camera.

        Raises:
            InputError: If the ending is another one, or there is no point.
        """
        import trimesh  # its import is slow

        path = check_points_file(path)
        if not len(self.points):
            raise InputError(
                f"{path}: no point to write: is all depth unknown or beyond the limit?"
            )
        upright = path.suffix.lower() == ".glb"
        points = self.points * np.array([1, -1, -1], np.float32) if upright else self.points
        cloud = trimesh.PointCloud(points, colors=self.colours)  # type: ignore[no-untyped-call]
        kind = path.suffix.lower().lstrip(".")
        content = cloud.export(file_type=kind)  # type: ignore[no-untyped-call]
        write_atomically(path, lambda temporary: temporary.write_bytes(content))


def check_points_file(path: str | Path) -> Path:
    """Check that points can be written in the format that a path's ending names.

    Raises:
        InputError: If they can't.
    """
    path = Path(path)
    if path.suffix.lower() not in POINT_FORMATS:
        raise InputError(f"{path}: points are written as {' or '.join(POINT_FORMATS)}")
    return path


def point_map(depth: FloatMap, calibration: Calibration) -> FloatMap:
    """Point of each pixel in the left camera's frame.

    Args:
        depth: (H, W) in metres, 0 where it is not known.
        calibration: Geometry of the pair. The principal point is the middle of the picture if it
            is not known.

    Returns:
        (H, W, 3) float32 in metres; NaN where the depth is not known.
    """
    height, width = depth.shape
    cx, cy = calibration.principal_point(width, height)
    fx, fy = calibration.focal_lengths
    z = np.where(depth > 0, depth, np.float32(np.nan))
    rows, columns = np.mgrid[:height, :width]
    x, y = (columns - cx) * z / fx, (rows - cy) * z / fy
    return np.stack((x, y, z), axis=-1).astype(np.float32)


def point_cloud(depth: FloatMap, colours: Picture, calibration: Calibration) -> PointCloud:
    """Points of a depth map in the left camera's frame.

    Args:
        depth: (H, W) in metres, 0 where there is no point.
        colours: (H, W, 3) uint8 RGB.
        calibration: See `point_map`.

    Returns:
        One point per pixel with a depth, row by row.
    """
    known = depth > 0
    return PointCloud(points=point_map(depth, calibration)[known], colours=colours[known])
