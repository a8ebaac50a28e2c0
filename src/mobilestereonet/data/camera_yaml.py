"""Camera files in YAML: ROS's camera_info, and what OpenCV's FileStorage writes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mobilestereonet.data.files import read_bytes
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

Matrix = NDArray[np.float64]

_METRES = {"m": 1.0, "mm": 0.001}
WIDEST = 10.0
"""Baseline in metres above which its unit is asked about."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """Reads OpenCV's matrices as well."""


def _matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> Matrix:
    entry = loader.construct_mapping(node, deep=True)
    shape = entry["sizes"] if "sizes" in entry else (entry["rows"], entry["cols"])
    return np.array(entry["data"], dtype=np.float64).reshape(shape)


for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _matrix)


def read_camera_yaml(*paths: str | Path) -> dict[str, Any]:
    """Read one or several files as one mapping; OpenCV's matrices become arrays.

    Args:
        *paths: Files; where two hold one name, the last one counts.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If a file is no YAML mapping.
    """
    entries: dict[str, Any] = {}
    for path in paths:
        lines = read_bytes(path).decode("utf-8", errors="replace").splitlines(keepends=True)
        if lines and lines[0].startswith("%YAML"):  # "%YAML:1.0" is OpenCV's own
            lines = lines[1:]
        try:
            documents = [d for d in yaml.load_all("".join(lines), _Loader) if d is not None]
        except (yaml.YAMLError, ValueError, KeyError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise InputError(f"{path}: not a camera file in YAML: {reason}") from None
        if not documents or not isinstance(documents[0], dict):
            raise InputError(f"{path}: not a camera file in YAML: it has no names with values")
        entries |= documents[0]
    return entries


def is_camera_info(entries: dict[str, Any]) -> bool:
    """Whether the entries are those of ROS's camera_info, as a file or as a printed message."""
    return not {"projection_matrix", "P", "p"}.isdisjoint(entries)


def from_camera_info(entries: dict[str, Any], left: dict[str, Any] | None = None) -> Calibration:
    """Geometry of a pair that ROS calibrated.

    Args:
        entries: The right camera's file: its projection matrix holds the baseline.
        left: The left camera's file. Without it both views have the right one's principal point,
            as `cv2.stereoRectify` sees to by default.

    Raises:
        InputError: If a matrix is missing, or the file is the left camera's.
    """
    right_matrix = _projection(entries)
    if right_matrix[0, 3] == 0:
        raise InputError(
            "its projection matrix has no baseline: it is the left camera's file; give the right "
            "camera's"
        )
    left_matrix = right_matrix * [1, 1, 1, 0] if left is None else _projection(left)
    calibration = from_projections(left_matrix, right_matrix, "m")
    for names in (("image_width", "image_height"), ("width", "height")):  # a file, a message
        if set(names) <= entries.keys():
            width, height = (float(matrix_of(entries, [name], (1,))[0]) for name in names)
            return replace(calibration, size=view_size(width, height) if width or height else None)
    return calibration


def view_size(width: float, height: float) -> tuple[int, int]:
    """Width and height as whole numbers.

    Raises:
        InputError: If one is not finite. `Calibration` refuses what is not positive.
    """
    if not math.isfinite(width + height):
        raise InputError(f"width and height must be finite, got {width} and {height}")
    return round(width), round(height)


def _projection(entries: dict[str, Any]) -> Matrix:
    name = next((n for n in ("projection_matrix", "P", "p") if n in entries), None)
    if name is None:
        raise InputError(f"no projection_matrix in the file, only {', '.join(entries)}")
    value = entries[name]
    try:
        return np.array(value["data"] if isinstance(value, dict) else value, float).reshape(3, 4)
    except (KeyError, ValueError, TypeError):
        raise InputError(f"{name} must hold 12 numbers, got {value!r}") from None


def from_opencv(entries: dict[str, Any], unit: str | None = None) -> Calibration:
    """Geometry of a pair from what `cv2.stereoRectify` gave: P1 and P2, or Q.

    Args:
        entries: The file's entries.
        unit: Unit of the translation, which is the one of the calibration board's squares.

    Raises:
        InputError: If there is neither, or the baseline is implausible in metres and no unit is
            given.
    """
    if {"P1", "P2"} <= entries.keys():
        return from_projections(
            matrix_of(entries, ["P1"], (3, 4)), matrix_of(entries, ["P2"], (3, 4)), unit
        )
    if "Q" not in entries:
        raise InputError(
            f"neither P1 and P2 nor Q of a rectified pair in the file, only {', '.join(entries)}; "
            "`msnet rectify` takes what is not rectified yet"
        )
    q = matrix_of(entries, ["Q"], (4, 4))
    if q[3, 2] == 0:
        raise InputError("Q has no baseline: its entry (3, 2) is 0")
    # Q = [1 0 0 -cx; 0 1 0 -cy; 0 0 0 f; 0 0 1/B (cx' - cx)/B], with the right view's cx'.
    return Calibration(
        focal=float(q[2, 3]),
        baseline=_baseline(float(1 / q[3, 2]), unit),
        doffs=float(q[3, 3] / q[3, 2]),
        cx=float(-q[0, 3]),
        cy=float(-q[1, 3]),
    )


def matrix_of(entries: dict[str, Any], names: Iterable[str], shape: tuple[int, ...]) -> Matrix:
    """The first entry of these names, as an array; -1 in ``shape`` takes any size.

    Raises:
        InputError: If there is none, or it has another size.
    """
    names = list(names)
    name = next((n for n in names if n in entries), None)
    if name is None:
        raise InputError(f"no {' or '.join(names)} in the file, only {', '.join(entries)}")
    try:
        return np.array(entries[name], dtype=np.float64).reshape(shape)
    except (ValueError, TypeError):
        size = " x ".join("n" if n < 0 else str(n) for n in shape)
        raise InputError(f"{name} must hold {size} numbers, got {entries[name]!r}") from None


def from_projections(left: Matrix, right: Matrix, unit: str | None = None) -> Calibration:
    """Geometry of a rectified pair from its projection matrices.

    Args:
        left: Projection matrix of the left view, (3, 4).
        right: That of the right view.
        unit: Unit of the baseline; metres if left out, and it must be plausible then.

    Raises:
        InputError: If the cameras are one above the other, or a value is impossible.
    """
    if abs(right[1, 3] - left[1, 3]) > abs(right[0, 3] - left[0, 3]):
        raise InputError("the cameras are one above the other: only pairs side by side are matched")
    focal = float(left[0, 0])
    # Entry (0, 3) is minus the focal length times the camera's place along the baseline.
    baseline = float(left[0, 3] - right[0, 3]) / focal if focal else 0.0
    return Calibration(
        focal=focal,
        baseline=_baseline(baseline, unit),
        doffs=float(right[0, 2] - left[0, 2]),
        cx=float(left[0, 2]),
        cy=float(left[1, 2]),
    )


def _baseline(value: float, unit: str | None) -> float:
    if unit not in (None, *_METRES):
        raise InputError(f"a unit is one of {', '.join(_METRES)}, got {unit!r}")
    if unit is None and value > WIDEST:
        raise InputError(
            f"a baseline of {value:g} m is implausible and the file names no unit: say mm or m"
        )
    return value * _METRES[unit or "m"]


@dataclass(frozen=True)
class StereoRig:
    """Two calibrated cameras whose views are not rectified.

    Attributes:
        left: Camera matrix of the left camera, (3, 3).
        left_distortion: Its distortion coefficients in OpenCV's order.
        right: Camera matrix of the right camera.
        right_distortion: Its distortion coefficients.
        rotation: From the left camera's frame to the right one's, (3, 3).
        translation: The same, (3,), in metres.
        size: Width and height of the calibrated images, if the file says so.
    """

    left: Matrix
    left_distortion: Matrix
    right: Matrix
    right_distortion: Matrix
    rotation: Matrix
    translation: Matrix
    size: tuple[int, int] | None = None


def read_rig(*paths: str | Path, unit: str | None = None) -> StereoRig:
    """Read what `cv2.stereoCalibrate` gave: FileStorage YAML, one file or several.

    Names are those of OpenCV's samples: ``M1 D1 M2 D2 R T``, also ``K1 K2``, ``cameraMatrix1``,
    ``distCoeffs1`` and so on; ``image_width`` and ``image_height``, or ``imageSize``, if present.

    Args:
        *paths: The file, or the files of intrinsics and extrinsics.
        unit: Unit of ``T``, which is the one of the calibration board's squares; metres if left
            out.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If a value is missing or of another size, or ``T`` is 0 or implausible.
    """
    entries = read_camera_yaml(*paths)
    try:
        translation = matrix_of(entries, ["T"], (3,))
        length = float(np.linalg.norm(translation))
        if not 0 < length < np.inf:
            raise InputError(f"T must not be zero, it is the baseline, got {translation.tolist()}")
        return StereoRig(
            left=matrix_of(entries, ["M1", "K1", "cameraMatrix1"], (3, 3)),
            left_distortion=matrix_of(entries, ["D1", "distCoeffs1"], (-1,)),
            right=matrix_of(entries, ["M2", "K2", "cameraMatrix2"], (3, 3)),
            right_distortion=matrix_of(entries, ["D2", "distCoeffs2"], (-1,)),
            rotation=matrix_of(entries, ["R"], (3, 3)),
            translation=translation * (_baseline(length, unit) / length),
            size=_image_size(entries),
        )
    except InputError as error:
        raise InputError(f"{', '.join(map(str, paths))}: {error}") from None


def _image_size(entries: dict[str, Any]) -> tuple[int, int] | None:
    if {"image_width", "image_height"} <= entries.keys():
        return int(entries["image_width"]), int(entries["image_height"])
    for name in ("imageSize", "image_size"):
        if name in entries:
            width, height = matrix_of(entries, [name], (2,))
            return int(width), int(height)
    return None
