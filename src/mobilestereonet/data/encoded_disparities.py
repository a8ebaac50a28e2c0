"""Disparity files of single data sets: packed in colours, in HDF5 or OpenEXR, or told as depth.

Each reader returns what those of `disparity_files` return: disparity (H, W) float32 in pixels, 0
where unknown, and the mask (H, W) of where it is known.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np

from mobilestereonet.atomic import note_inputs
from mobilestereonet.data.disparity_files import (
    grey_levels,
    known_values,
    positive_values,
    read_numbers,
)
from mobilestereonet.data.files import read_bytes
from mobilestereonet.data.image_files import decode_image
from mobilestereonet.data.images import Array, FloatMap, Mask
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError, needs_extra

_FSD_BASE, _FSD_SCALE = 255, 1000.0
"""Base of the digits red, green, blue, and levels per pixel of disparity."""

_FULL = 65535
"""Level of a 16-bit depth image that stands for its own depth and everything beyond."""


def read_disparity_sintel(path: str | Path) -> tuple[FloatMap, Mask]:
    """Read a disparity of MPI Sintel, packed in an 8-bit RGB image.

    The disparity is ``4 R + G / 2**6 + B / 2**14`` pixels.

    Args:
        path: The PNG file.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no 8-bit colour image.
    """
    red, green, blue = _colours(path, "Sintel")
    return known_values(4 * red + green / 2**6 + blue / 2**14)


def read_disparity_fsd(path: str | Path) -> tuple[FloatMap, Mask]:
    """Read a disparity of FoundationStereo's data set, packed in an 8-bit RGB image.

    The disparity is ``(255**2 R + 255 G + B) / 1000`` pixels; the base is 255 indeed, not 256.

    Args:
        path: The PNG file.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no 8-bit colour image.
    """
    red, green, blue = _colours(path, "FoundationStereo's set")
    return known_values(((red * _FSD_BASE + green) * _FSD_BASE + blue) / _FSD_SCALE)


def _colours(path: str | Path, data_set: str) -> Array:
    """Red, green and blue levels of an 8-bit image, (3, H, W) float64."""
    levels = decode_image(path)
    if levels.dtype != np.uint8 or levels.ndim != 3:
        raise InputError(
            f"{path}: {data_set} packs disparity in an 8-bit RGB image, "
            f"got {levels.dtype} of shape {levels.shape}"
        )
    return np.moveaxis(levels[..., 2::-1].astype(np.float64), 2, 0)


def read_depth_as_disparity(
    path: str | Path, calibration: Calibration, levels_per_metre: float = 1.0
) -> tuple[FloatMap, Mask]:
    """Read a depth map as disparity: focal length times baseline over depth.

    The largest level of a 16-bit image, 65535, stands for everything that is as far or farther,
    above all the sky: its disparity is only known to be small, so it counts as unknown.

    Args:
        path: A grey 16-bit image, or a NumPy array of numbers.
        calibration: The pair's geometry (``doffs`` is 0).
        levels_per_metre: 100 for centimetres, as in Virtual KITTI 2; 1 for metres.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is neither.
    """
    path = Path(path)
    if path.suffix.lower() == ".npy":
        levels = read_numbers(path).astype(np.float64)
    else:
        levels = grey_levels(path, 16).astype(np.float64)
        levels[levels == _FULL] = np.inf
    depth = np.where(levels > 0, levels, np.inf) / levels_per_metre
    return known_values(calibration.focal * calibration.baseline / depth)


def read_disparity_hdf5(path: str | Path, step: int = 1) -> tuple[FloatMap, Mask]:
    """Read the array ``disparity`` of an HDF5 file, such as Spring's ``.dsp5``.

    Args:
        path: The file.
        step: Take every so many rows and columns: 2 for Spring, whose maps have twice the height
            and width of its views while their values are pixels of the views.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If h5py is not installed (the extra ``data``), or the file is damaged or holds
            no such array of shape (H, W).
    """
    with needs_extra("data"):
        import h5py

    content = read_bytes(path)
    try:
        with h5py.File(BytesIO(content), "r") as file:
            values = np.asarray(file["disparity"][::step, ::step], dtype=np.float32)
    except Exception as error:  # whatever a parser makes of any bytes
        raise InputError(f"{path}: no HDF5 file with an array disparity: {error}") from None
    if values.ndim != 2:
        raise InputError(f"{path}: disparity must have shape (H, W), got {values.shape}")
    return positive_values(values)


def read_disparity_exr(path: str | Path) -> tuple[FloatMap, Mask]:
    """Read an OpenEXR image of disparities with one channel, or several that are all the same.

    Args:
        path: The file.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If OpenEXR is not installed (the extra ``data``), or the file is damaged or has
            channels that differ.
    """
    with needs_extra("data"):
        import OpenEXR

    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such file")
    note_inputs(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = [channel.pixels for channel in file.channels().values()]
    except Exception as error:  # whatever a parser makes of any bytes
        raise InputError(f"{path}: not an OpenEXR image that is whole: {error}") from None
    alike = (np.array_equal(channels[0], other, equal_nan=True) for other in channels[1:])
    if not channels or not all(alike):
        raise InputError(
            f"{path}: disparity must be one channel, or several alike; it has {len(channels)}"
        )
    return positive_values(np.asarray(channels[0], dtype=np.float32))
