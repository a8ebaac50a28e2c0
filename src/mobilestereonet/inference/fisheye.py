"""The rectified picture of two fisheye cameras: how much of their wide view it shows.

`cv2.fisheye.stereoRectify` chooses it by the undistorted corners, which are at infinity or behind
the camera for views of 180 degrees and more. Here the middle keeps its resolution.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from mobilestereonet.data.rig import Camera, CameraPair
from mobilestereonet.data.rig.cameras import Matrix, Rectification, Size
from mobilestereonet.errors import InputError

MAX_HALF_VIEW_DEG = 75.0
"""Largest angle from the optical axis that a rectified picture shows with all that it can."""

_STEP = 1.05
_MAX_STEPS = 40
_BORDER_POINTS = 17


def fisheye_rectification(
    pair: CameraPair, size: Size, rotations: tuple[Matrix, Matrix], *, whole: bool
) -> Rectification:
    """Choose the projection of the rectified pictures of two fisheye cameras.

    Args:
        pair: The cameras.
        size: Width and height of the pictures, in px.
        rotations: Of each camera into the rectified frame, (3, 3).
        whole: True shows all up to `MAX_HALF_VIEW_DEG`, smaller; False keeps the middle's
            resolution, and shows what both pictures have.

    Raises:
        InputError: If the cameras have nothing in common.
    """
    cameras = tuple(zip((pair.left, pair.right), rotations, strict=True))
    middles = [_directions(camera, _middle(size), rotation) for camera, rotation in cameras]
    middle = np.mean(middles, axis=0)[0]
    if whole:
        focal = _widest(cameras, size)
    else:
        focal = float(
            np.mean([camera.matrix[axis, axis] for camera, _ in cameras for axis in (0, 1)])
        )
    for _ in range(_MAX_STEPS):
        centre = (np.array(size) - 1) / 2 - focal * middle
        new = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
        if whole or all(_covers(camera, rotation, new, size) for camera, rotation in cameras):
            break
        focal *= _STEP
    else:
        raise InputError("the two fisheye pictures have nothing in common that can be rectified")
    left = np.hstack([new, np.zeros((3, 1))])
    right = left.copy()
    right[0, 3] = -focal * float(np.linalg.norm(pair.translation))
    return Rectification(rotations, (left, right))


def _middle(size: Size) -> Matrix:
    return (np.array([[size[0], size[1]]], np.float64) - 1) / 2


def _directions(camera: Camera, places: Matrix, rotation: Matrix) -> Matrix:
    """Where the rectified frame's plane z = 1 has what raw pixels (N, 2) show, (N, 2)."""
    points = cv2.fisheye.undistortPoints(
        places[:, None], camera.matrix, camera.distortion, R=rotation, P=np.eye(3)
    )
    return np.asarray(points, np.float64)[:, 0]


def _widest(cameras: tuple[tuple[Camera, Matrix], ...], size: Size) -> float:
    """Focal length at which the picture shows all that lies within `MAX_HALF_VIEW_DEG`."""
    focal = math.inf
    for camera, _ in cameras:
        for axis in (0, 1):
            angle = size[axis] / 2 / float(camera.matrix[axis, axis])
            angle = min(angle, math.radians(MAX_HALF_VIEW_DEG))
            focal = min(focal, size[axis] / 2 / math.tan(angle))
    return focal


def _covers(camera: Camera, rotation: Matrix, new: Matrix, size: Size) -> bool:
    """Whether a raw picture has all that the border of the rectified one shows."""
    width, height = size
    along = np.linspace(0, 1, _BORDER_POINTS)
    x, y = along * (width - 1), along * (height - 1)
    border = np.concatenate(
        [
            np.stack(np.broadcast_arrays(*side), axis=-1)
            for side in ((x, 0.0), (x, height - 1.0), (0.0, y), (width - 1.0, y))
        ]
    )
    rays = np.hstack([border, np.ones((len(border), 1))]) @ np.linalg.inv(new).T @ rotation
    if (rays[:, 2] <= 0).any():
        return False
    rays = rays[:, :2] / rays[:, 2:]
    seen = cv2.fisheye.distortPoints(rays[:, None], camera.matrix, camera.distortion)[:, 0]
    return bool((seen >= 0).all() and (seen <= (width - 1, height - 1)).all())
