"""Results of OpenCV's calibration under the names that scripts give them."""

from __future__ import annotations

import math
import re

import numpy as np

from mobilestereonet.data.rig.camera_info import calibrated_pair, in_metres
from mobilestereonet.data.rig.cameras import (
    Camera,
    CameraPair,
    Matrix,
    Size,
    checked_rotation,
)
from mobilestereonet.data.rig.description import (
    Description,
    Geometry,
    Pose,
    matrix_of_numbers,
    one_size,
    pair_of,
)
from mobilestereonet.data.rig.entries import Entries, flattened
from mobilestereonet.data.rig.lenses import camera_of
from mobilestereonet.data.rig.rectified import from_projections, from_q
from mobilestereonet.data.rig.told import MAX_BASELINE_DIFFERENCE, Told
from mobilestereonet.data.rig.values import listed, matrix_of, number_of, size_of
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

_OF_ONE = {
    "K": r"m|k|mtx|matrix|camera_?mat(rix)?|cam_?(mat(rix)?|mtx)|intrinsics?(_?matrix)?",
    "D": r"d|dist(ortion)?s?(_?coef+(icient)?s?)?|dist_?vec|coeffs",
    "R": r"r|rect(ification)?(_?(matrix|transform|rotation))?",
    "P": r"p|proj(ection)?(_?mat(rix)?|_?mtx)?",
    "W": r"((image|img)_?)?width",
    "H": r"((image|img)_?)?height",
}
"""Quantities of one camera."""

_OF_BOTH = {
    "R": r"r|r12|rot(ation)?(_?mat(rix)?)?|rmat|om",
    "T": r"t|t12|trans(lation)?(_?(vec(tor)?|mat(rix)?))?|tvec",
    "Q": r"q|q_?matrix|disp(arity)?_?to_?depth(_?(map|mat(rix)?))?|reprojection(_?matrix)?",
    "width": r"(image|img)?_?width",
    "height": r"(image|img)?_?height",
    "size": r"((image|img|im|frame|picture|calib(ration)?)_?)?size|resolution",
    "shape": r"((image|img|im|frame|gr[ae]y)_?)?shape",
    "model": r"((camera|lens|distortion)_?)?model|lens",
    "fisheye": r"(is_?)?fisheye",
}
"""Quantities of the pair."""

_SIDE = r"(?P<side>left|right|l|r|[012])"
_CAMERA = r"(cam(era)?|ir|infra(red)?)?"
_NOISE = r"^((stereo|extrinsics?|calib(ration)?|params?|results?|rig)_)+"
_RAW = ("K1", "D1", "K2", "D2", "R", "T")


def read_opencv(entries: Entries, told: Told) -> Description:
    """Rig from what `cv2.stereoCalibrate` and `cv2.stereoRectify` give.

    Their results are found under the names of OpenCV's samples (``M1 D1 M2 D2 R T R1 R2 P1 P2 Q``),
    ``K1 K2``, ``cameraMatrix1``, ``distCoeffs1``, ``mtxL``, ``left_camera_matrix``, entries
    ``left`` and ``right`` that hold one camera each, and so on.

    Raises:
        InputError: If too little is there, or a value is impossible.
    """
    entries = flattened(entries)
    names = find_names(entries)
    size = _size(entries, names)
    raw = None if told.rectified else _raw(entries, names, told, size)
    try:
        rectified = _rectified(entries, names, told, size)
    except InputError:
        if raw is None:
            raise
        rectified = None  # such as what cv2.fisheye.stereoRectify gives for a wide lens
    if rectified is not None and not told.rectified:
        raw = _with_rectification(raw, rectified, entries, names, told)
    geometries = [raw, rectified] if isinstance(raw, CameraPair) else [rectified or raw]
    found = tuple(geometry for geometry in geometries if geometry is not None)
    if found:
        return Description(found)
    missing = [name for name in _RAW if name not in names]
    raise InputError(
        f"neither P1 and P2 nor Q of a rectified pair in the file, nor two cameras: no "
        f"{', '.join(missing)} in the file, only {listed(entries)}"
    )


def find_names(entries: Entries) -> dict[str, str]:
    """Names of the entries by quantity: "K1" or "P2" of one camera, "R", "T" or "Q" of both."""
    sided: list[tuple[str, str, str]] = []
    names: dict[str, str] = {}
    for name in entries:
        plain = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower()
        plain = re.sub(_NOISE, "", re.sub(r"[^a-z0-9]+", "_", plain).strip("_"))
        for quantity, words in _OF_BOTH.items():
            if re.fullmatch(words, plain):
                names.setdefault(quantity, name)
        for quantity, words in _OF_ONE.items():
            patterns = (
                rf"{_CAMERA}_?{_SIDE}_?{_CAMERA}_?({words})",
                rf"({words})_?{_CAMERA}_?{_SIDE}",
            )
            match = next((m for p in patterns if (m := re.fullmatch(p, plain))), None)
            if match and plain != "r12":
                sided.append((quantity, match["side"], name))
                break
    first = "0" if any(side == "0" for _, side, _ in sided) else "1"
    for quantity, side, name in sided:
        names.setdefault(f"{quantity}{1 if side in ('left', 'l', first) else 2}", name)
    return names


def _size(entries: Entries, names: dict[str, str]) -> Size | None:
    if {"width", "height"} <= names.keys():
        return size_of(*(number_of(entries, names[side]) for side in ("width", "height")))
    own = [
        size_of(*(number_of(entries, names[f"{side}{camera}"]) for side in "WH"))
        for camera in (1, 2)
        if {f"W{camera}", f"H{camera}"} <= names.keys()
    ]
    if own:
        return one_size(own[0], own[-1])
    if "size" in names:
        width, height = matrix_of(entries, names["size"], (2,))
        return size_of(width, height)
    if "shape" in names:  # NumPy's: rows first
        shape = matrix_of(entries, names["shape"], (-1,))
        if len(shape) in (2, 3):
            return size_of(shape[1], shape[0])
    return None


def _rectified(
    entries: Entries, names: dict[str, str], told: Told, size: Size | None
) -> Calibration | None:
    if {"P1", "P2"} <= names.keys():
        left, right = (matrix_of(entries, names[name], (3, 4)) for name in ("P1", "P2"))
        return from_projections(left, right, told, size=size)
    if "Q" in names:
        return from_q(matrix_of(entries, names["Q"], (4, 4)), told, size=size)
    return None


def _raw(entries: Entries, names: dict[str, str], told: Told, size: Size | None) -> Geometry | None:
    if set(_RAW) <= names.keys():
        rotation = matrix_of(entries, names["R"], (-1,))
        if rotation.size not in (3, 9):
            raise InputError(f"{names['R']} must hold 3 x 3 numbers, got {rotation.size}")
        shape = (3, 3) if rotation.size == 9 else (3,)
        pose = Pose(
            checked_rotation(rotation.reshape(shape), names["R"]),
            matrix_of(entries, names["T"], (3,)),
        )
        if not pose.translation.any():
            raise InputError(f"{names['T']} must not be zero, it is the baseline, got 0 0 0")
        return pair_of(*_cameras(entries, names, told), pose, told, size=size)
    return None


def _cameras(entries: Entries, names: dict[str, str], told: Told) -> tuple[Camera, Camera]:
    model = str(entries.get(names.get("model", ""), ""))
    if names.get("fisheye") and entries[names["fisheye"]] in (True, 1, "1", "true", "True"):
        model = "fisheye"
    left, right = (
        camera_of(
            _camera_matrix(entries, names[f"K{number}"]),
            matrix_of(entries, names[f"D{number}"], (-1,)),
            model,
            told,
        )
        for number in (1, 2)
    )
    return left, right


def _camera_matrix(entries: Entries, name: str) -> Matrix:
    """A camera matrix, or fx fy cx cy."""
    values = matrix_of(entries, name, (-1,))
    if values.size == 4:
        return matrix_of_numbers(*values)
    return matrix_of(entries, name, (3, 3))


def _with_rectification(
    raw: Geometry | None,
    rectified: Calibration,
    entries: Entries,
    names: dict[str, str],
    told: Told,
) -> Geometry | None:
    """Raw cameras with the file's own rectification, if it has one, and is of these cameras."""
    if not {"R1", "R2", "P1", "P2", "K1", "K2", "D1", "D2"} <= names.keys():
        return raw
    baseline = float(np.linalg.norm(raw.translation)) if isinstance(raw, CameraPair) else None
    if baseline and not math.isclose(baseline, rectified.baseline, rel_tol=MAX_BASELINE_DIFFERENCE):
        raise InputError(
            f"T says that the baseline is {baseline:g} m and P2 says {rectified.baseline:g} m: "
            "are they of one calibration?"
        )
    left, right = (matrix_of(entries, names[name], (3, 4)) for name in ("P1", "P2"))
    return calibrated_pair(
        list(_cameras(entries, names, told)),
        [
            checked_rotation(matrix_of(entries, names[name], (3, 3)), names[name])
            for name in ("R1", "R2")
        ],
        in_metres(left, right, rectified.baseline),
        rectified.baseline,
        rectified.size,
    )
