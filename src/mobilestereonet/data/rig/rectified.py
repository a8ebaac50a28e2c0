"""Calibration of a rectified pair from the matrices that describe it."""

from __future__ import annotations

import math

import numpy as np

from mobilestereonet.data.rig.cameras import (
    Matrix,
    Size,
    check_camera_matrix,
    check_focal_lengths,
    check_principal_point,
)
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

MAX_FOCAL_DIFFERENCE = 1e-3
"""Largest relative difference between the focal lengths of two rectified views."""

MAX_ROW_DIFFERENCE_PX = 1.0
"""Largest difference between the principal points' rows of two rectified views."""

_SAME_FOCAL = 1e-6  # relative: what a writer rounds away


def from_projections(
    left: Matrix, right: Matrix, told: Told, unit: str = "m", size: Size | None = None
) -> Calibration:
    """Calibration of a rectified pair from its projection matrices.

    Args:
        left: Projection matrix of the left view, (3, 4). Entry (0, 3) is minus the focal length
            times the camera's place along the baseline.
        right: That of the right view.
        told: What the user says.
        unit: Unit of the format's lengths.
        size: Width and height of the views, if known.

    Raises:
        InputError: If the cameras are one above the other, their views are not rectified, or a
            value is impossible.
    """
    for name, matrix in (("left", left), ("right", right)):
        check_camera_matrix(matrix, f"the {name} projection matrix")
    if abs(right[1, 3] - left[1, 3]) > abs(right[0, 3] - left[0, 3]):
        raise InputError("the cameras are one above the other: only pairs side by side are matched")
    baseline = float(left[0, 3] - right[0, 3]) / float(left[0, 0])
    return from_cameras(left, right, told.metres(baseline, unit), size=size)


def from_cameras(
    left: Matrix,
    right: Matrix,
    baseline: float,
    doffs: float | None = None,
    size: Size | None = None,
) -> Calibration:
    """Calibration from camera or projection matrices, checked to be those of a rectified pair.

    Args:
        left: Matrix of the left view, (3, 3) or (3, 4).
        right: That of the right view.
        baseline: Distance between the cameras, in metres.
        doffs: The right principal point's column less the left one's, where a file tells it.
        size: Width and height of the views, if known.

    Raises:
        InputError: If such views are not rectified, or a value is impossible.
    """
    for name, matrix in (("left", left), ("right", right)):
        check_camera_matrix(matrix, f"the {name} camera's matrix")
    for axis, name in ((0, "horizontal"), (1, "vertical")):
        focals = float(left[axis, axis]), float(right[axis, axis])
        if not math.isclose(*focals, rel_tol=MAX_FOCAL_DIFFERENCE):
            raise InputError(
                f"the {name} focal lengths are {focals[0]:g} px (left) and {focals[1]:g} px "
                "(right): such views are not rectified"
            )
    rows = float(left[1, 2]), float(right[1, 2])
    if abs(rows[0] - rows[1]) > MAX_ROW_DIFFERENCE_PX:
        raise InputError(
            f"the principal points are in rows {rows[0]:g} (left) and {rows[1]:g} (right): such "
            "views are not rectified"
        )
    if size is not None:
        check_focal_lengths(left, size, "left")
    between = float(right[0, 2] - left[0, 2])
    return Calibration(
        focal=float(left[0, 0]),
        baseline=baseline,
        doffs=between if doffs is None else doffs,
        cx=float(left[0, 2]),
        cy=float(left[1, 2]),
        size=size,
        focal_y=other_focal(left[0, 0], left[1, 1]),
    )


def from_q(q: Matrix, told: Told, unit: str = "m", size: Size | None = None) -> Calibration:
    """Calibration from the matrix Q of `cv2.stereoRectify`, (4, 4).

    Q (x, y, d, 1) = (X, Y, Z, W). OpenCV writes 1, 1 and f; fx = f / Q00 and fy = f / Q11 hold for
    any Q, and Q = [1 0 0 -cx; 0 1 0 -cy; 0 0 0 f; 0 0 1/B (cx' - cx)/B] follows.

    Raises:
        InputError: If it is none of a rectified pair, or a value is impossible.
    """
    if not np.isfinite(q).all() or 0 in (q[3, 2], q[0, 0], q[1, 1]):
        raise InputError(
            "Q has no baseline or no focal length: (3, 2), (0, 0) or (1, 1) is 0 or not finite"
        )
    focal, focal_y = float(q[2, 3] / q[0, 0]), float(q[2, 3] / q[1, 1])
    camera = np.array([[focal, 0, -q[0, 3] / q[0, 0]], [0, focal_y, -q[1, 3] / q[1, 1]], [0, 0, 1]])
    baseline = told.metres(float(q[0, 0] / q[3, 2]), unit)
    return from_cameras(camera, camera, baseline, float(q[3, 3] / q[3, 2]), size)


def check_views(calibration: Calibration, size: Size) -> None:
    """Check that a calibration can be of views of a size, if it does not tell another one.

    Raises:
        InputError: If the focal length cannot be of such views; or if it tells no size, and its
            principal point is outside, as it may be of views that were cropped.
    """
    (fx, fy), (cx, cy) = calibration.focal_lengths, calibration.principal_point(*size)
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    check_focal_lengths(matrix, size, "left")
    if calibration.size is None:
        check_principal_point(matrix, size, "left")


def other_focal(fx: float, fy: float) -> float | None:
    """The vertical focal length; None if it is the horizontal one."""
    return None if math.isclose(fx, fy, rel_tol=_SAME_FOCAL) else float(fy)
