"""What is unusual in the geometry of two cameras, with the values and the way out."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np

from mobilestereonet.data.rig.cameras import Camera, CameraPair, Matrix, Size
from mobilestereonet.data.rig.description import Geometry
from mobilestereonet.data.sizes import check_untold_size

MIN_USUAL_VIEW_DEG = 4.0
"""Smallest horizontal field of view that is usual."""

MAX_USUAL_VIEW_DEG = 125.0
"""Widest one of a picture with straight lines."""

MAX_USUAL_OFFSET = 0.22
"""Largest distance of a principal point from the middle, per width or height."""

MAX_USUAL_RATIO = 2.2
"""Largest ratio of fx and fy: pictures side by side are often squeezed by 2; and of left and
right."""

USUAL_DISTORTION = (0.25, 2.5)
"""Smallest and largest factor by which distortion moves what is at the side of a picture."""


def doubts(geometry: Geometry, size: Size) -> Iterator[str]:
    """Say what is unusual in the geometry of pictures of a width and height.

    Args:
        geometry: Of raw or of rectified pictures; it is possible, as its own checks have found.
        size: Width and height of the pictures, in px.

    Yields:
        One text for each.

    Raises:
        InputError: If it tells no size, and its principal point that of other pictures.
    """
    if isinstance(geometry, CameraPair):
        cameras = {"left": geometry.left, "right": geometry.right}
        focals = sorted(camera.matrix[0, 0] for camera in cameras.values())
        if focals[1] > MAX_USUAL_RATIO * focals[0]:
            yield (
                f"one camera's focal length is {focals[0]:g} px and the other one's "
                f"{focals[1]:g} px: are both of pictures of one size?"
            )
    else:
        (fx, fy), (cx, cy) = geometry.focal_lengths, geometry.principal_point(*size)
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        cameras = {"left": Camera(matrix, np.zeros(0))}
    for side, camera in cameras.items():
        scale = ""
        if geometry.size is None:
            cx, cy = (float(place) for place in camera.matrix[:2, 2])
            scale = check_untold_size(cx, cy, size)
        yield from [f"the {side} camera: {scale}"] * bool(scale)
        yield from _of_camera(camera, size, side, is_told=bool(scale))


def _of_camera(camera: Camera, size: Size, side: str, *, is_told: bool) -> Iterator[str]:
    (fx, fy), (cx, cy) = np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
    view = math.degrees(2 * math.atan(size[0] / 2 / fx))
    if not MIN_USUAL_VIEW_DEG <= view <= MAX_USUAL_VIEW_DEG and not camera.fisheye:
        yield (
            f"the {side} camera's focal length of {fx:g} px gives pictures of {size[0]} px a view "
            f"of {view:.3g} degrees: is it in pixels, and of pictures of this size?"
        )
    if max(fx, fy) > MAX_USUAL_RATIO * min(fx, fy):
        yield f"the {side} camera's focal lengths are {fx:g} and {fy:g} px: is one of them wrong?"
    offset = max(abs(cx / size[0] - 0.5), abs(cy / size[1] - 0.5))
    if offset > MAX_USUAL_OFFSET and not is_told:
        yield (
            f"the {side} camera's principal point ({cx:g}, {cy:g}) is far from the middle of "
            f"pictures of {size[0]}x{size[1]}: right if they were cropped; otherwise, is it of "
            "pictures of another size?"
        )
    factor = _distortion_at_the_side(camera, size[0] / 2 / fx)
    if not USUAL_DISTORTION[0] <= factor <= USUAL_DISTORTION[1]:
        yield (
            f"the {side} camera's distortion {camera.distortion.tolist()} moves what is at the "
            f"side of the picture to {factor:.2g} of its distance from the middle: are the "
            "coefficients in OpenCV's order and of its model (k1 k2 p1 p2 k3, or --fisheye)?"
        )


def _distortion_at_the_side(camera: Camera, place: float) -> float:
    """Factor by which distortion moves a point to the side of the optical axis.

    Args:
        camera: The camera.
        place: Distance of the picture's side from the middle, in focal lengths: an angle of a
            fisheye lens, the tangent of one of others.
    """
    if not camera.distortion.any():
        return 1.0
    with np.errstate(all="ignore"):  # of absurd coefficients
        if camera.fisheye:
            powers = place ** np.arange(2.0, 10.0, 2.0)
            return float(1 + camera.distortion @ powers)
        point: Matrix = np.array([[[place, 0, 1]]])
        still = np.zeros(3)
        moved, _ = cv2.projectPoints(point, still, still, np.eye(3), camera.distortion)
        return float(moved[0, 0, 0] / place)
