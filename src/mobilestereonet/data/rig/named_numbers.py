"""Calibration of two cameras as named numbers (``fx``, ``cx``, ``k1`` ...), as librealsense's."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from mobilestereonet.data.rig.cameras import Camera, Matrix, Size, checked_rotation
from mobilestereonet.data.rig.description import (
    Description,
    Pose,
    matrix_of_numbers,
    one_size,
    pair_of,
)
from mobilestereonet.data.rig.entries import Entries, flattened
from mobilestereonet.data.rig.lenses import (
    FISHEYE_NUMBERS,
    LENS_NUMBERS,
    camera_of,
    is_fisheye_model,
    named_coefficients,
)
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.rig.values import listed, matrix_of, number_of, numbers, size_of
from mobilestereonet.errors import InputError

_LEFT = re.compile(r"left|(infra(red)?|ir|cam(era)?)_?1$|_l$", re.IGNORECASE)
_RIGHT = re.compile(r"right|(infra(red)?|ir|cam(era)?)_?2$|_r$", re.IGNORECASE)
_COEFFICIENTS = re.compile(r"(?!.*model)(.*(distort|coeff?)|(.*_)?(d|dist)(_?[12lr]|_vec)?$)")
"""Name, in lower case, of an entry that holds the distortion coefficients."""

_MODEL = re.compile(r"model(_type)?|dist.*_model")
_LENS_NUMBER = re.compile(rf"(?:.*_)?({'|'.join(LENS_NUMBERS)})")


def find_intrinsics(entries: Entries, name: str = "") -> dict[str, Entries]:
    """Entries about one camera each, whose matrix is named numbers (``fx``, ``ppx`` or ``cx`` ...).

    What stands beside the matrix of the only camera of some entries belongs to that camera.

    Returns:
        Entries by their place, such as ``left/intrinsics``.
    """
    if _has_matrix(entries):
        return {name: entries}
    found: dict[str, Entries] = {}
    for key, value in entries.items():
        if isinstance(value, dict):
            found |= find_intrinsics(value, f"{name}/{key}".lstrip("/"))
    return dict.fromkeys(found, entries) if len(found) == 1 else found


def _has_matrix(entries: Entries) -> bool:
    return "fx" in entries and not entries.keys().isdisjoint(("ppx", "cx"))


def read_intrinsics(entries: Entries, told: Told) -> Description:
    """Rig from the intrinsics of two cameras as named numbers, as librealsense has them.

    The cameras are ``left`` and ``right``, or ``infrared1`` and ``infrared2``; ``extrinsics`` has
    ``rotation`` (column by column) and ``translation``, or ``baseline`` is a number. One camera
    alone stands for both if its lens does not distort.

    Raises:
        InputError: If a value is missing or impossible, or distortion coefficients are there that
            belong to no camera.
    """
    found = find_intrinsics(entries)
    _check_all_used(entries, list(found.values()))
    left, right = ([one for name, one in found.items() if _side(name) == side] for side in (0, 1))
    alone = len(found) == 1 and not right
    if alone:
        left = right = list(found.values())
    if len(left) != 1 or len(right) != 1:
        raise InputError(
            f"which cameras are left and right? It has {listed(found)}: call them left and right"
        )
    cameras = [numbered_camera(one[0], told) for one in (left, right)]
    if alone and cameras[0][0].distorts:
        raise InputError(
            "it tells about one camera alone, whose lens distorts: to rectify its pictures, give "
            "a file that has the left and the right camera and how they stand to each other"
        )
    pose = _extrinsics(entries)
    if pose.is_to_the_left:  # infrared 1 is the left one: it is the way from right to left
        pose = pose.inverse()
    size = one_size(cameras[0][1], cameras[1][1])
    return Description((pair_of(cameras[0][0], cameras[1][0], pose, told, "m", size),))


def _side(place: str) -> int | None:
    """0 or 1 for the left or the right camera, by the innermost name that tells."""
    for name in reversed(place.split("/")):
        for side, words in enumerate((_LEFT, _RIGHT)):
            if words.search(name):
                return side
    return None


def _check_all_used(entries: Entries, cameras: list[Entries]) -> None:
    """Refuse distortion coefficients outside of the cameras' entries."""
    unused = flattened(_without(entries, cameras))
    for name, coefficients in _coefficients(unused).items():
        if coefficients.any():
            raise InputError(
                f"{name} belongs to no camera: write each camera's distortion coefficients beside "
                "its fx, fy, cx and cy"
            )


def _without(entries: Entries, cameras: list[Entries]) -> Entries:
    if any(entries is camera for camera in cameras):
        return {}
    return {
        name: _without(value, cameras) if isinstance(value, dict) else value
        for name, value in entries.items()
    }


def _coefficients(values: Entries) -> dict[str, Matrix]:
    """Entries that hold distortion coefficients, or one of them, by their names."""
    found: dict[str, Matrix] = {}
    for name, value in values.items():
        if _LENS_NUMBER.fullmatch(name) or _COEFFICIENTS.match(name.lower()):
            try:
                found[name] = numbers(value)
            except (ValueError, TypeError):  # such as a name of a model
                if _LENS_NUMBER.fullmatch(name):
                    raise InputError(f"{name} must be a number, got {value!r}") from None
    return found


def numbered_camera(entries: Entries, told: Told) -> tuple[Camera, Size | None]:
    """One camera from named numbers, and the size of its pictures if it tells.

    Raises:
        InputError: If a value is missing or impossible.
    """
    values = flattened(entries)
    prefix = next(name for name in values if re.fullmatch("(.*_)?fx", name))[:-2]
    own = {name.removeprefix(prefix): value for name, value in values.items()}
    matrix = matrix_of_numbers(
        number_of(own, "fx"),
        number_of(own, "fy"),
        number_of(own, ("ppx", "cx")),
        number_of(own, ("ppy", "cy")),
    )
    model = next((str(own[name]) for name in own if _MODEL.fullmatch(name)), "")
    sides = (("width", "image_width"), ("height", "image_height"))
    size = size_of(*(number_of(own, names, 0) for names in sides))
    distortion, model = _lens(own, model.rpartition(".")[2], told)
    return camera_of(matrix, distortion, model, told), size


def _lens(values: Entries, model: str, told: Told) -> tuple[Matrix, str]:
    """The distortion coefficients of one camera, and the name of their model."""
    found = _coefficients(values)
    named = {m[1]: values[name] for name in found if (m := _LENS_NUMBER.fullmatch(name))}
    arrays = {name: found[name] for name in found if not _LENS_NUMBER.fullmatch(name)}
    if len(found) != len(named) + len(arrays) or len(arrays) + bool(named) > 1:
        raise InputError(
            f"which distortion coefficients are the camera's? It has {listed(found)}: leave one"
        )
    fisheye = is_fisheye_model(model) or (not model and bool(told.fisheye))
    if arrays:
        (distortion,) = arrays.values()
        # The fifth one of librealsense's fisheye lenses is unused.
        return distortion[:4] if len(distortion) == 5 and fisheye else distortion, model
    if not named:
        return np.zeros(0), model
    if named.keys() == set(FISHEYE_NUMBERS) and not model and told.fisheye is not False:
        return named_coefficients(named, fisheye=True), model  # nobody says what they are
    others = [name for name in named if name not in FISHEYE_NUMBERS]
    if fisheye and others:
        raise InputError(f"a fisheye lens has {', '.join(FISHEYE_NUMBERS)}, not {listed(others)}")
    return named_coefficients(named, fisheye), model or ("fisheye" if fisheye else "plumb_bob")


def _extrinsics(entries: Entries) -> Pose:
    """The pose of one camera in the other one's frame; the baseline alone if that is all."""
    for name, value in entries.items():
        if isinstance(value, dict) and {"rotation", "translation"} <= value.keys():
            rotation = _column_by_column(value["rotation"], name)
            translation = matrix_of(value, "translation", (3,))
            return Pose(rotation, translation)
    baseline = abs(number_of(entries, ("baseline", "stereo_baseline"), 0))
    return Pose(np.eye(3), np.array([-baseline, 0, 0]))


def _column_by_column(value: Any, name: str) -> Matrix:
    nested = isinstance(value, list) and len(value) == 3
    rotation = matrix_of({f"rotation of {name}": value}, f"rotation of {name}", (3, 3))
    return checked_rotation(rotation if nested else rotation.T, f"rotation of {name}")
