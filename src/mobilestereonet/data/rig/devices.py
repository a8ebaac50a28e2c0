"""Calibration of stereo cameras as their makers store it: ZED, OAK, RealSense."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from mobilestereonet.data.rig.cameras import Camera, Size, checked_rotation
from mobilestereonet.data.rig.description import (
    Description,
    Geometry,
    Pose,
    matrix_of_numbers,
    one_size,
    pair_of,
)
from mobilestereonet.data.rig.entries import Entries
from mobilestereonet.data.rig.lenses import camera_of, named_coefficients
from mobilestereonet.data.rig.rectified import from_cameras
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.rig.values import listed, matrix_of, number_of, size_of
from mobilestereonet.errors import InputError

ZED_SIZES = {
    "4K": (3840, 2160),
    "QHDPLUS": (3200, 1800),
    "2K": (2208, 1242),
    "FHD1200": (1920, 1200),
    "FHD": (1920, 1080),
    "HD": (1280, 720),
    "SVGA": (960, 600),
    "VGA": (672, 376),
}
"""Width and height of the resolutions of ZED cameras."""

_ZED_CAMERA = re.compile(r"LEFT_CAM_(\w+)")
_RECTIFIED = re.compile(r"rectified\.(\d+)\.fx")
_OAK_MODELS = {0: "perspective", 1: "fisheye"}
_OAK_SOCKETS = (1, 2)


def is_zed(entries: Entries) -> bool:
    """Whether entries are sections of a ZED's SN....conf."""
    return any(_ZED_CAMERA.fullmatch(name) for name in entries)


def is_oak(entries: Entries) -> bool:
    """Whether entries are the EEPROM of an OAK camera."""
    return isinstance(entries.get("cameraData"), list)


def is_realsense_table(entries: Entries) -> bool:
    """Whether entries are the calibration table of a RealSense D400."""
    return any(_RECTIFIED.fullmatch(name) for name in entries)


def read_zed(entries: Entries, told: Told) -> Description:
    """Rig from a ZED's SN....conf: raw pictures in each of its resolutions, millimetres.

    Raises:
        InputError: If a value is missing or impossible.
    """
    stereo = entries.get("STEREO", {})
    geometries: list[Geometry] = []
    names = [match[1] for name in entries if (match := _ZED_CAMERA.fullmatch(name))]
    for name in names:
        if name not in ZED_SIZES or f"RIGHT_CAM_{name}" not in entries:
            continue
        left, right = (
            _zed_camera(entries[f"{side}_CAM_{name}"], told) for side in ("LEFT", "RIGHT")
        )
        angles = [number_of(stereo, [f"{axis}_{name}", axis], 0) for axis in ("RX", "CV", "RZ")]
        offsets = [number_of(stereo, [f"T{axis}_{name}", f"T{axis}"], 0) for axis in "YZ"]
        place = np.array([number_of(stereo, "Baseline", 0), *offsets])
        pose = Pose(checked_rotation(np.array(angles), "RX, CV, RZ"), -place)
        geometries.append(pair_of(left, right, pose, told, "mm", ZED_SIZES[name]))
    if not geometries:
        raise InputError(f"no resolution of a ZED camera in the file, only {listed(entries)}")
    return Description(tuple(geometries))


def _zed_camera(section: Entries, told: Told) -> Camera:
    matrix = matrix_of_numbers(*(number_of(section, name) for name in ("fx", "fy", "cx", "cy")))
    return camera_of(matrix, named_coefficients(section), "plumb_bob", told)


def read_oak(entries: Entries, told: Told) -> Description:
    """Rig from the EEPROM of an OAK camera as depthai writes it: raw pictures, centimetres.

    Raises:
        InputError: If a value is missing or impossible.
    """
    cameras = _oak_cameras(entries["cameraData"])
    stereo = entries.get("stereoRectificationData") or {}
    sockets = told.cameras or (
        int(number_of(stereo, "leftCameraSocket", -1)),
        int(number_of(stereo, "rightCameraSocket", -1)),
    )
    if told.cameras is None and not set(sockets) <= cameras.keys():
        sockets = _OAK_SOCKETS
    for socket in sockets:
        if socket not in cameras:
            raise InputError(
                f"no camera on socket {socket}, only on {', '.join(map(str, cameras))}: --cameras "
                "LEFT RIGHT names the two"
            )
    (left_root, left_pose), (right_root, right_pose) = (
        _pose_in_root(cameras, socket) for socket in sockets
    )
    if left_root != right_root:
        raise InputError(f"it does not tell how the cameras {sockets} stand to each other")
    pose = right_pose.inverse().after(left_pose)
    notes: tuple[str, ...] = ()
    if pose.is_to_the_left and told.cameras is None:
        sockets, pose = sockets[::-1], pose.inverse()
        notes = (f"the left camera is on socket {sockets[0]}, the right one on {sockets[1]}",)
    (left, left_size), (right, right_size) = (_oak_camera(cameras[s], told) for s in sockets)
    size = one_size(left_size, right_size)
    return Description((pair_of(left, right, pose, told, "cm", size),), notes)


def _oak_cameras(listed_cameras: Any) -> dict[int, Entries]:
    try:
        return {int(socket): dict(camera) for socket, camera in listed_cameras}
    except (TypeError, ValueError):
        raise InputError("cameraData must be a list of [socket, camera]") from None


def _pose_in_root(cameras: dict[int, Entries], socket: int) -> tuple[int, Pose]:
    """A camera's pose in the frame of the camera at the end of its chain, and that one's socket."""
    pose = Pose(np.eye(3), np.zeros(3))
    seen = {socket}
    while True:
        extrinsics = cameras[socket].get("extrinsics") or {}
        target = int(number_of(extrinsics, "toCameraSocket", -1))
        if target not in cameras or target in seen:
            return socket, pose
        rotation = checked_rotation(
            matrix_of(extrinsics, "rotationMatrix", (3, 3)), f"rotationMatrix of socket {socket}"
        )
        pose = Pose(rotation, matrix_of(extrinsics, "translation", (3,))).after(pose)
        seen.add(target)
        socket = target


def _oak_camera(entries: Entries, told: Told) -> tuple[Camera, Size | None]:
    kind = int(number_of(entries, "cameraType", 0))
    model = _OAK_MODELS.get(kind)
    if model is None:
        raise InputError(f"pictures of a camera of cameraType {kind} cannot be rectified here")
    distortion = matrix_of(entries, "distortionCoeff", (-1,))
    if model == "fisheye":
        distortion = distortion[:4]
    matrix = matrix_of(entries, "intrinsicMatrix", (3, 3))
    size = size_of(number_of(entries, "width", 0), number_of(entries, "height", 0))
    return camera_of(matrix, distortion, model, told), size


def read_realsense_table(entries: Entries, told: Told) -> Description:
    """Rig from the calibration table of a RealSense D400: rectified pictures of several sizes.

    Raises:
        InputError: If a value is missing or impossible.
    """
    baseline = told.metres(abs(number_of(entries, "baseline", 0)), "mm")
    geometries: list[Geometry] = []
    for index in sorted(int(m[1]) for name in entries if (m := _RECTIFIED.fullmatch(name))):
        values = {
            name: number_of(entries, f"rectified.{index}.{name}")
            for name in ("fx", "fy", "ppx", "ppy", "width", "height")
        }
        size = size_of(values["width"], values["height"])
        if size is not None:
            matrix = matrix_of_numbers(*(values[name] for name in ("fx", "fy", "ppx", "ppy")))
            geometries.append(from_cameras(matrix, matrix, baseline, 0.0, size))
    return Description(tuple(geometries))
