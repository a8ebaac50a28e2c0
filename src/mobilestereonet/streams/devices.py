"""Stereo cameras with their makers' libraries: RealSense, OAK, ZED; calibrated in the factory."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from typing import Any

import numpy as np

from mobilestereonet.data.images import Array
from mobilestereonet.data.rig import Camera, CameraPair, Rig
from mobilestereonet.data.rig.cameras import FISHEYE_COEFFICIENTS
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.inference import Rectifier
from mobilestereonet.streams.overlap import latest_only
from mobilestereonet.streams.stream import StereoFrame, Stream, make_frame

REALSENSE_SIZE = (848, 480)
OAK_SIZE = (640, 400)
FRAMES_PER_SECOND = 30

_NO_ZED = (
    "pyzed is not installed: it comes with Stereolabs' ZED SDK, not from a package index. The "
    "SDK's installer leaves get_python_api.py in its folder (/usr/local/zed; on Windows "
    "C:\\Program Files (x86)\\ZED SDK): run that with this Python"
)


def is_device(source: str) -> bool:
    """Whether a source is a camera of these makers: ``realsense:``, ``oak:`` or ``zed:``."""
    return source.partition(":")[0] in _OPENERS and ":" in source


def open_device(source: str) -> Stream:
    """Open a camera; frames that come while another one is matched are dropped.

    Args:
        source: ``realsense:``, ``oak:`` or ``zed:``; what follows is the serial number or the
            address of one of several.

    Raises:
        InputError: If the maker's library is not installed, or there is no such camera.
    """
    maker, _, serial = source.partition(":")
    try:
        return _OPENERS[maker](serial)
    except RuntimeError as error:  # of all three libraries
        raise InputError(f"{source}: this camera cannot be opened: {error}") from error


def _open_realsense(serial: str) -> Stream:
    """The two infrared cameras, whose pictures are rectified, without the pattern of dots."""
    with needs_extra("realsense"):
        import pyrealsense2
    rs: Any = pyrealsense2
    pipeline, config = rs.pipeline(), rs.config()
    if serial:
        config.enable_device(serial)
    for index in (1, 2):  # left and right
        config.enable_stream(
            rs.stream.infrared, index, *REALSENSE_SIZE, rs.format.y8, FRAMES_PER_SECOND
        )
    profile = pipeline.start(config)
    with _stopped_on_error(pipeline.stop):
        sensor = profile.get_device().first_depth_sensor()
        if sensor.supports(rs.option.emitter_enabled):
            sensor.set_option(rs.option.emitter_enabled, 0)
        left, right = (
            profile.get_stream(rs.stream.infrared, index).as_video_stream_profile()
            for index in (1, 2)
        )
        calibration = realsense_calibration(left.get_intrinsics(), left.get_extrinsics_to(right))

    def take() -> list[Array]:
        frames = pipeline.wait_for_frames()
        return [np.array(frames.get_infrared_frame(index).get_data()) for index in (1, 2)]

    return _live("realsense", take, pipeline.stop, calibration)


def realsense_calibration(intrinsics: Any, extrinsics: Any) -> Calibration:
    """Calibration of the infrared pair.

    Args:
        intrinsics: The left camera's ``rs.intrinsics``.
        extrinsics: ``rs.extrinsics`` from the left to the right camera, in metres.
    """
    return Calibration(
        focal=intrinsics.fx,
        baseline=-extrinsics.translation[0],
        cx=intrinsics.ppx,
        cy=intrinsics.ppy,
        size=(intrinsics.width, intrinsics.height),
        focal_y=None if intrinsics.fy == intrinsics.fx else intrinsics.fy,
    )


def _open_oak(address: str) -> Stream:
    """The left and the right camera, rectified here by the factory's calibration."""
    with needs_extra("oak"):
        import depthai
    dai: Any = depthai
    device = dai.Device(dai.DeviceInfo(address)) if address else dai.Device()
    pipeline = dai.Pipeline(device)
    sockets = dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C
    together = pipeline.create(dai.node.Sync)
    for name, socket in zip(("left", "right"), sockets, strict=True):
        camera = pipeline.create(dai.node.Camera).build(socket)
        output = camera.requestOutput(OAK_SIZE, dai.ImgFrame.Type.GRAY8, fps=FRAMES_PER_SECOND)
        output.link(together.inputs[name])
    queue = together.out.createOutputQueue(maxSize=1, blocking=False)
    rectify = Rectifier(oak_rig(device.readCalibration(), sockets, OAK_SIZE))
    calibration = rectify.calibration(OAK_SIZE)
    with _stopped_on_error(pipeline.stop):  # a start may fail half-way
        pipeline.start()

    def take() -> list[Array]:
        group = queue.get()
        left, right, _ = rectify(group["left"].getCvFrame(), group["right"].getCvFrame())
        return [left, right]

    return _live("oak", take, pipeline.stop, calibration)


def _open_zed(serial: str) -> Stream:
    """Both cameras, rectified by the maker's library; its own depth is not computed."""
    try:
        from pyzed import sl
    except ModuleNotFoundError:
        raise InputError(_NO_ZED) from None
    wanted = sl.InitParameters()
    wanted.depth_mode = sl.DEPTH_MODE.NONE
    wanted.coordinate_units = sl.UNIT.METER
    wanted.sdk_verbose = 0
    if serial:
        if not serial.isdecimal():
            raise InputError(f"zed:{serial}: the serial number of a ZED is digits alone")
        wanted.set_from_serial_number(int(serial))
    camera = sl.Camera()
    _check_zed(sl, camera.open(wanted))
    with _stopped_on_error(camera.close):
        configuration = camera.get_camera_information().camera_configuration
        calibration = zed_calibration(configuration.calibration_parameters)
    picture = sl.Mat()

    def take() -> list[Array]:
        _check_zed(sl, camera.grab())
        taken = []
        for view in (sl.VIEW.LEFT, sl.VIEW.RIGHT):  # rectified, BGRA
            _check_zed(sl, camera.retrieve_image(picture, view))
            taken.append(np.ascontiguousarray(picture.get_data()[..., 2::-1]))
        return taken

    return _live("zed", take, camera.close, calibration)


def _check_zed(sl: Any, status: Any) -> None:
    if status != sl.ERROR_CODE.SUCCESS:
        raise RuntimeError(str(status))


def zed_calibration(parameters: Any) -> Calibration:
    """Calibration of the rectified pictures.

    Args:
        parameters: ``sl.CalibrationParameters``, in metres.
    """
    left, right = parameters.left_cam, parameters.right_cam
    return Calibration(
        focal=left.fx,
        baseline=parameters.get_camera_baseline(),
        doffs=right.cx - left.cx,
        cx=left.cx,
        cy=left.cy,
        size=(left.image_size.width, left.image_size.height),
        focal_y=None if left.fy == left.fx else left.fy,
    )


@contextmanager
def _stopped_on_error(stop: Callable[[], object]) -> Iterator[None]:
    """Context whose errors leave no camera running."""
    try:
        yield
    except BaseException:
        with suppress(RuntimeError):
            stop()
        raise


def oak_rig(handler: Any, sockets: Sequence[Any], size: tuple[int, int]) -> Rig:
    """The rig of the raw cameras.

    Args:
        handler: ``dai.CalibrationHandler``; its translations are in centimetres.
        sockets: The left and the right camera's.
        size: Width and height of their pictures.

    Raises:
        InputError: If a lens is neither a pinhole nor a fisheye one, or a value is impossible.
    """
    left, right = (_oak_camera(handler, socket, size) for socket in sockets)
    pose = np.array(handler.getCameraExtrinsics(*sockets))
    return Rig((CameraPair(left, right, pose[:3, :3], pose[:3, 3] / 100, size),), "oak")


def _oak_camera(handler: Any, socket: Any, size: tuple[int, int]) -> Camera:
    model = handler.getDistortionModel(socket).name
    if model not in ("Perspective", "Fisheye"):
        raise InputError(
            f"the camera on socket {socket} has a lens of the model {model}: its pictures cannot "
            "be rectified here, those of Perspective and Fisheye can"
        )
    matrix = np.array(handler.getCameraIntrinsics(socket, *size))
    distortion = np.array(handler.getDistortionCoefficients(socket))
    fisheye = model == "Fisheye"
    return Camera(matrix, distortion[:FISHEYE_COEFFICIENTS] if fisheye else distortion, fisheye)


def _live(
    maker: str,
    take: Callable[[], list[Array]],
    stop: Callable[[], object],
    calibration: Calibration,
) -> Stream:
    def frames() -> Generator[StereoFrame]:
        started = time.monotonic()
        try:
            for index in count():
                try:
                    pictures = take()
                except RuntimeError as error:  # of all three libraries
                    warnings.warn(
                        f"{maker}: gave no more pictures after {index} frames ({error}); was the "
                        "camera unplugged?",
                        stacklevel=2,
                    )
                    return
                yield make_frame(index, time.monotonic() - started, pictures)
        finally:
            with suppress(RuntimeError):  # it is gone
                stop()

    return Stream(latest_only(frames()), None, live=True, calibration=calibration)


_OPENERS: dict[str, Callable[[str], Stream]] = {
    "realsense": _open_realsense,
    "oak": _open_oak,
    "zed": _open_zed,
}
