"""Pictures and calibrations from ROS messages.

Messages of ROS 1, of ROS 2 and of bags differ in their classes, not in their fields: they are read
by attribute.
"""

from __future__ import annotations

import re
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.image_files import decode_bytes
from mobilestereonet.data.rig import CameraPair, Rig
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

Image = NDArray[Any]

_PATTERNS = ("rggb", "bggr", "gbrg", "grbg")
_PLAIN = {"rgb": (3, None), "bgr": (3, "BGR2RGB"), "rgba": (4, "RGBA2RGB"), "bgra": (4, "BGRA2RGB")}

_ENCODINGS: dict[str, tuple[type, int, str | None]] = {
    "mono8": (np.uint8, 1, None),
    "mono16": (np.uint16, 1, None),
    "8UC1": (np.uint8, 1, None),
    "16UC1": (np.uint16, 1, None),
    "8UC3": (np.uint8, 3, "BGR2RGB"),
    "8UC4": (np.uint8, 4, "BGRA2RGB"),
    **{f"{name}8": (np.uint8, *how) for name, how in _PLAIN.items()},
    **{f"{name}16": (np.uint16, *how) for name, how in _PLAIN.items()},
    **{f"bayer_{p}8": (np.uint8, 1, f"Bayer{p.upper()}2RGB") for p in _PATTERNS},
    **{f"bayer_{p}16": (np.uint16, 1, f"Bayer{p.upper()}2RGB") for p in _PATTERNS},
    **dict.fromkeys(("yuv422", "uyvy"), (np.uint8, 2, "YUV2RGB_UYVY")),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (np.uint8, 2, "YUV2RGB_YUY2")),
}
"""Encodings of sensor_msgs: dtype and channels of a pixel, and OpenCV's conversion to RGB."""

_REPUBLISH = "the node republish of image_transport makes images of it"

VIDEO_PACKETS = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": f"packets of a video: {_REPUBLISH} (from "
    "ffmpeg to raw)",
    "theora_image_transport/msg/Packet": f"packets of a Theora video: {_REPUBLISH} (from theora "
    "to raw)",
    "foxglove_msgs/msg/CompressedVideo": "packets of a video: record the camera's images instead, "
    "or decode it with FFmpeg to a file that `msnet video` takes",
}
"""Messages of videos by their types: what to say of them."""

_SEMI_PLANAR = re.compile(r"nv\d\d", re.IGNORECASE)
_VIDEO_FORMAT = re.compile(r"h\.?26[45]|hevc|av1|vp[89]|theora", re.IGNORECASE)


def check_encoding(message: Any) -> None:
    """Refuse an Image or CompressedImage whose encoding cannot be read, before it is decoded.

    Raises:
        InputError: If it cannot; the message tells what converts it.
    """
    if hasattr(message, "encoding"):
        _known(message.encoding)
    elif _VIDEO_FORMAT.search(message.format):
        raise InputError(
            f"compressed images of format {message.format!r} are packets of a video, which are not "
            "decoded here: record the camera's images instead"
        )


def picture_of(message: Any) -> Image:
    """The picture of a ``sensor_msgs/Image`` or ``sensor_msgs/CompressedImage``.

    Args:
        message: The message. An Image is of one of the encodings mono, rgb, bgr, rgba, bgra and
            bayer with 8 or 16 bits, 8UC1, 8UC3, 8UC4, 16UC1, and YUV 4:2:2.

    Returns:
        (H, W) or (H, W, 3) in RGB order, uint8 or uint16.

    Raises:
        InputError: If it is damaged, or of another encoding.
    """
    check_encoding(message)
    if hasattr(message, "encoding"):
        return _decoded(_pixels(message), message.encoding)
    image = decode_bytes(f"a compressed image ({message.format})", bytes(message.data))
    if image.ndim == 3:
        return _converted(image, "BGR2RGB" if image.shape[2] == 3 else "BGRA2RGB", message.format)
    encoding = message.format.partition(";")[0].strip()  # "bayer_rggb8; png compressed"
    return _decoded(image, encoding) if encoding.startswith("bayer") else image


def _pixels(message: Any) -> Image:
    """The pixels of an Image as they are, (H, W) or (H, W, channels), without the rows' padding."""
    dtype, channels, _ = _known(message.encoding)
    pixel = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    used = message.width * channels * pixel.itemsize
    step, data = message.step or used, np.frombuffer(message.data, np.uint8)
    empty = not used or not message.height
    if step < used or empty or data.size < (message.height - 1) * step + used:
        raise InputError(
            f"a damaged image: {data.size} bytes for {message.width}x{message.height} pixels of "
            f"{message.encoding} in rows of {step} bytes"
        )
    rows = np.lib.stride_tricks.as_strided(data, (message.height, used), (step, 1), writeable=False)
    values: Image = np.ascontiguousarray(rows).view(pixel).astype(dtype)
    return values if channels == 1 else values.reshape(message.height, message.width, channels)


def _known(encoding: str) -> tuple[type, int, str | None]:
    if _SEMI_PLANAR.fullmatch(encoding):
        raise InputError(
            f"images of encoding {encoding!r} cannot be read: the node image_format_converter of "
            "isaac_ros_image_proc makes rgb8 of them"
        )
    if encoding not in _ENCODINGS:
        raise InputError(
            f"images of encoding {encoding!r} cannot be read, only {', '.join(_ENCODINGS)}"
        )
    return _ENCODINGS[encoding]


def _decoded(pixels: Image, encoding: str) -> Image:
    conversion = _known(encoding)[2]
    return pixels if conversion is None else _converted(pixels, conversion, encoding)


def _converted(pixels: Image, conversion: str, encoding: str) -> Image:
    try:
        return np.asarray(cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{conversion}")))
    except cv2.error:  # such as an odd width of YUV 4:2:2, whose pixels come in twos
        height, width = pixels.shape[:2]
        raise InputError(
            f"an image of {width}x{height} pixels, {pixels.dtype}, cannot be one of {encoding}: "
            "is it damaged, or its width odd?"
        ) from None


def rig_of(left: Any, right: Any) -> Rig | None:
    """The rig of two cameras from their ``sensor_msgs/CameraInfo``.

    Returns:
        The rig; None if a camera says that it is not calibrated.

    Raises:
        InputError: If the cameras are not those of a stereo camera, see `Rig.from_camera_info`.
    """
    infos = [_entries(info) for info in (left, right)]
    if any(np.ravel(info["p"])[0] == 0 for info in infos):
        return None
    return Rig.from_camera_info(*infos)


def calibration_of(left: Any, right: Any) -> Calibration | None:
    """Calibration of rectified pictures, see `rig_of`."""
    rig = rig_of(left, right)
    return None if rig is None else rectified_part(rig)


def rectified_part(rig: Rig) -> Calibration:
    """The calibration of a rig's rectified pictures; camera_info always tells it."""
    return next(each for each in rig.geometries if isinstance(each, Calibration))


def raw_part(rig: Rig) -> CameraPair | None:
    """The cameras of a rig's raw pictures; None if these are rectified as they are."""
    return next((each for each in rig.geometries if isinstance(each, CameraPair)), None)


def _entries(info: Any) -> dict[str, Any]:
    """A CameraInfo as names and values; ROS 1 has D, K, R and P in upper case."""
    plain = ("width", "height", "distortion_model", "binning_x", "binning_y")
    matrices = {name: getattr(info, name, getattr(info, name.upper(), None)) for name in "dkrp"}
    window = {name: getattr(info.roi, name) for name in ("x_offset", "y_offset", "width", "height")}
    return {
        **{name: getattr(info, name) for name in plain},
        **{name: np.asarray(matrix, np.float64) for name, matrix in matrices.items()},
        "roi": window,
    }
