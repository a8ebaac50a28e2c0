"""Camera files as named values: OpenCV's FileStorage (YAML, XML, JSON), and ROS's YAML."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mobilestereonet.data.files import read_bytes
from mobilestereonet.errors import InputError

Matrix = NDArray[np.float64]

MAX_PLAUSIBLE_BASELINE_M = 10.0
"""Baseline above which a file must name its unit: it is more likely in millimetres."""

_METRES = {"m": 1.0, "mm": 0.001}


def is_opencv_file(text: str) -> bool:
    """Whether a text is one that OpenCV's FileStorage writes."""
    return text.startswith(("%YAML", "<?xml", "{")) or "!!opencv-" in text


def read_camera_file(path: str | Path) -> dict[str, Any]:
    """Read a camera file as names with values; OpenCV's matrices become arrays.

    Args:
        path: A file of OpenCV's FileStorage, or a YAML file. Of several YAML documents, such as
            messages that ROS printed, the first counts.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If it is neither.
    """
    text = read_bytes(path).decode("utf-8", errors="replace")
    try:
        if is_opencv_file(text):
            return _read_opencv(text)
        documents = [entry for entry in yaml.safe_load_all(text) if entry is not None]
    except (yaml.YAMLError, cv2.error, SystemError) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise InputError(f"{path}: not a camera file: {reason}") from None
    if not documents or not isinstance(documents[0], dict):
        raise InputError(f"{path}: not a camera file: it has no names with values")
    return documents[0]


def _read_opencv(text: str) -> dict[str, Any]:
    if not text.startswith(("%YAML", "<?xml", "{")):
        text = "%YAML:1.0\n---\n" + text.removeprefix("---\n")
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    root = storage.root()
    return {name: _node_value(root.getNode(name)) for name in root.keys()}  # noqa: SIM118


def _node_value(node: cv2.FileNode) -> Any:
    if node.isMap():
        names = node.keys()
        if "dt" in names:
            return node.mat()
        return {name: _node_value(node.getNode(name)) for name in names}
    if node.isSeq():
        return [_node_value(node.at(index)) for index in range(node.size())]
    if node.isString():
        return node.string()
    return node.real()


def matrix_of(entries: dict[str, Any], names: Iterable[str], shape: tuple[int, ...]) -> Matrix:
    """Look up an entry under one of several names, as an array.

    Args:
        entries: A camera file's names and values. A matrix is an array, a list, or a mapping whose
            ``data`` is a list.
        names: Names that the entry may have, in order of precedence.
        shape: Shape of the result; -1 takes any size.

    Raises:
        InputError: If there is none, or it has another size.
    """
    names = list(names)
    name = next((n for n in names if n in entries), None)
    if name is None:
        raise InputError(f"no {' or '.join(names)} in the file, only {', '.join(entries)}")
    value = entries[name]
    try:
        values = value["data"] if isinstance(value, dict) else value
        return np.array(values, dtype=np.float64).reshape(shape)
    except (KeyError, ValueError, TypeError):
        size = " x ".join("n" if n < 0 else str(n) for n in shape)
        raise InputError(f"{name} must hold {size} numbers, got {value!r}") from None


def baseline_in_metres(value: float, unit: str | None) -> float:
    """Convert a baseline to metres.

    Args:
        value: The baseline in ``unit``.
        unit: "m" or "mm"; None if nobody knows, which is taken for metres if plausible.

    Raises:
        InputError: If the unit is another one, or unknown and the baseline implausible in metres.
    """
    if unit not in (None, *_METRES):
        raise InputError(f"a unit is one of {', '.join(_METRES)}, got {unit!r}")
    if unit is None and value > MAX_PLAUSIBLE_BASELINE_M:
        raise InputError(
            f"a baseline of {value:g} m is implausible and the file names no unit: say mm or m"
        )
    return value * _METRES[unit or "m"]


@dataclass(frozen=True)
class StereoRig:
    """Calibration of two cameras whose views are not rectified.

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
    """Read the results of `cv2.stereoCalibrate` from a file of OpenCV's FileStorage, or several.

    Names are those of OpenCV's samples: ``M1 D1 M2 D2 R T``, also ``K1 K2``, ``cameraMatrix1``,
    ``distCoeffs1`` and so on; ``image_width`` and ``image_height``, or ``imageSize``, if present.

    Args:
        *paths: The file, or the files of intrinsics and extrinsics; where two hold one name, the
            last one counts.
        unit: Unit of ``T``, which is the one of the calibration board's squares; metres if left
            out.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If a value is missing or of another size, or ``T`` is 0 or implausible.
    """
    entries: dict[str, Any] = {}
    for path in paths:
        entries |= read_camera_file(path)
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
            translation=translation * (baseline_in_metres(length, unit) / length),
            size=_image_size(entries),
        )
    except InputError as error:
        raise InputError(f"{', '.join(map(str, paths))}: {error}") from None


def _image_size(entries: dict[str, Any]) -> tuple[int, int] | None:
    if {"image_width", "image_height"} <= entries.keys():
        try:
            return int(entries["image_width"]), int(entries["image_height"])
        except (TypeError, ValueError):
            sizes = f"{entries['image_width']!r} and {entries['image_height']!r}"
            raise InputError(f"image_width and image_height must be numbers, got {sizes}") from None
    for name in ("imageSize", "image_size"):
        if name in entries:
            width, height = matrix_of(entries, [name], (2,))
            return int(width), int(height)
    return None
