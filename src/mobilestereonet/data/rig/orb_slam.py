"""Settings of ORB-SLAM3: ``Camera1.fx``, ``Camera1.k1``, ``Stereo.T_c1_c2`` ..."""

from __future__ import annotations

from mobilestereonet.data.rig.description import Description, Pose, one_size, pair_of
from mobilestereonet.data.rig.entries import Entries
from mobilestereonet.data.rig.named_numbers import numbered_camera
from mobilestereonet.data.rig.rectified import from_cameras
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.rig.values import matrix_of, number_of
from mobilestereonet.errors import InputError

_MODELS = {"PinHole": "plumb_bob", "Rectified": "none", "KannalaBrandt8": "fisheye"}
"""Our names of the models of ``Camera.type``."""


def is_orb_slam3(entries: Entries) -> bool:
    """Whether entries are settings of ORB-SLAM3."""
    return "Camera1.fx" in entries


def read_orb_slam3(entries: Entries, told: Told) -> Description:
    """Rig from the settings of ORB-SLAM3: raw pictures, or rectified ones, metres.

    ``Stereo.T_c1_c2`` places points of camera 2 in the frame of camera 1.

    Raises:
        InputError: If a value is missing or impossible.
    """
    kind = str(entries.get("Camera.type", ""))
    if kind not in _MODELS:
        raise InputError(f"Camera.type is one of {', '.join(_MODELS)}, got {kind!r}")
    if kind == "Rectified":
        camera, pictures = numbered_camera(_camera(entries, 1, kind), told)
        baseline = told.metres(number_of(entries, "Stereo.b", 0))
        return Description((from_cameras(camera.matrix, camera.matrix, baseline, size=pictures),))
    (left, left_size), (right, right_size) = (
        numbered_camera(_camera(entries, number, kind), told) for number in (1, 2)
    )
    name = "Stereo.T_c1_c2"
    pose = Pose.of_matrix(matrix_of(entries, name, (4, 4)), name).inverse()
    size = one_size(left_size, right_size)
    return Description((pair_of(left, right, pose, told, size=size),))


def _camera(entries: Entries, number: int, kind: str) -> Entries:
    """What is told about one camera, without ``Camera1.`` before the names."""
    prefixes = ("Camera.", f"Camera{number}.")
    own = {
        name.removeprefix(prefix): value
        for prefix in prefixes
        for name, value in entries.items()
        if name.startswith(prefix)
    }
    return own | {"model": _MODELS[kind]}
