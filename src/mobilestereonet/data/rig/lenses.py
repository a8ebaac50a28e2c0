"""Lens models by their names in the field, and their distortion coefficients."""

from __future__ import annotations

import re

import numpy as np

from mobilestereonet.data.rig.cameras import FISHEYE_COEFFICIENTS, Camera, Matrix
from mobilestereonet.data.rig.entries import Entries
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.rig.values import number_of
from mobilestereonet.errors import InputError

PINHOLE_MODELS = {
    "plumbbob",
    "rationalpolynomial",
    "radtan",
    "radialtangential",
    "brownconrady",
    "modifiedbrownconrady",
    "thinprism",
    "opencv",
    "perspective",
    "radtan8",
}
"""Names of OpenCV's pinhole model and its parts, in ROS, Kalibr, EuRoC, RealSense, OAK."""

FISHEYE_MODELS = {
    "equidistant",
    "equi",
    "fisheye",
    "kannalabrandt",
    "kannalabrandt4",
    "kannalabrandt8",
    "opencvfisheye",
}
"""Names of the model of `cv2.fisheye`."""

NO_DISTORTION = {"none", "no", "pinhole", ""}
"""Names that say nothing about distortion."""

LENS_NUMBERS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Names of the pinhole model's coefficients in OpenCV's order."""

FISHEYE_NUMBERS = ("k1", "k2", "k3", "k4")
"""Those of `cv2.fisheye`."""


def named_coefficients(entries: Entries, fisheye: bool = False) -> Matrix:
    """Distortion coefficients that are named numbers; 0 for those that are not there.

    Raises:
        InputError: If one is no number.
    """
    names: tuple[str, ...] = FISHEYE_NUMBERS if fisheye else LENS_NUMBERS
    if not fisheye and entries.keys().isdisjoint(LENS_NUMBERS[5:]):
        names = LENS_NUMBERS[:5]
    return np.array([number_of(entries, name, 0) for name in names])


def is_fisheye_model(model: str) -> bool:
    """Whether a name is one of `FISHEYE_MODELS`, however it is written."""
    return _plain(model) in FISHEYE_MODELS


def _plain(model: str) -> str:
    return re.sub(r"[^a-z0-9]", "", model.lower())


def camera_of(matrix: Matrix, distortion: Matrix, model: str, told: Told) -> Camera:
    """A camera from its matrix, its coefficients and the name of their model.

    Args:
        matrix: Camera matrix, (3, 3).
        distortion: Coefficients in the model's order; none are no distortion.
        model: Name of the model; empty if the file tells none.
        told: What the user says.

    Raises:
        InputError: If the model is none that can be rectified, or four coefficients are given and
            nobody says what they are.
    """
    name = _plain(model)
    if name.startswith("inverse") and not distortion.any():
        name = "none"
    if name not in PINHOLE_MODELS | FISHEYE_MODELS | NO_DISTORTION:
        raise InputError(
            f"pictures of a camera with the distortion model {model} cannot be rectified here, "
            "those of pinhole (plumb_bob, radtan) and fisheye lenses (equidistant) can"
        )
    fisheye = told.fisheye
    if name in PINHOLE_MODELS | FISHEYE_MODELS:
        fisheye = name in FISHEYE_MODELS
        if told.fisheye not in (None, fisheye):
            raise InputError(
                f"the file says that its distortion model is {model}: leave out "
                f"--{'fisheye' if told.fisheye else 'pinhole'}"
            )
    if fisheye is None and len(distortion) == FISHEYE_COEFFICIENTS:
        raise InputError(
            f"the file does not tell what its 4 distortion coefficients {distortion.tolist()} are: "
            "say --fisheye (k1 k2 k3 k4 of cv2.fisheye) or --pinhole (k1 k2 p1 p2)"
        )
    if fisheye and not distortion.size:
        distortion = np.zeros(FISHEYE_COEFFICIENTS)
    return Camera(matrix, distortion, bool(fisheye))
