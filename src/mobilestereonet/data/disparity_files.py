"""Disparity files: each reader returns the disparity and the mask of where it is known.

How a format marks pixels without ground truth (0, infinity, NaN) ends here: every reader returns
float32 disparities in pixels, 0 where unknown, and a mask that is True where known, both (H, W).
So does its sign: releases and networks differ (a disparity is a flow to the left), so the sign that
most of a file's pixels have is taken for its convention, and the result is positive.
"""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path

import numpy as np

from mobilestereonet.data.files import read_bytes, read_pfm, write_png
from mobilestereonet.data.image_files import decode_image, read_image
from mobilestereonet.data.images import Array, FloatMap, Mask
from mobilestereonet.errors import InputError

KITTI_SCALE = 256.0
"""Grey levels per pixel of disparity in the PNGs of KITTI and of most sets after it."""


def positive_values(disparity: Array) -> tuple[FloatMap, Mask]:
    """Disparity and mask of a file's values, whose convention may be negative ones."""
    known = disparity[np.isfinite(disparity)]
    negative = np.count_nonzero(known < 0) > np.count_nonzero(known > 0)
    return known_values(-disparity if negative else disparity)


def known_values(disparity: Array) -> tuple[FloatMap, Mask]:
    """Disparity and mask of a file's values, known where finite and above 0."""
    valid = np.isfinite(disparity) & (disparity > 0)
    return np.where(valid, disparity, 0).astype(np.float32), valid


def grey_levels(path: str | Path, *allowed_bits: int) -> Array:
    """Levels (H, W) of a grey image, of one of some depths in bits."""
    levels = decode_image(path)
    _check_grey(path, levels, *allowed_bits)
    return levels


def _check_grey(path: str | Path, levels: Array, *allowed_bits: int) -> None:
    if levels.ndim != 2 or levels.dtype not in [np.dtype(f"uint{bits}") for bits in allowed_bits]:
        depths = " or ".join(map(str, allowed_bits))
        raise InputError(
            f"{path}: disparity or depth must be a grey {depths}-bit image, "
            f"got {levels.dtype} of shape {levels.shape}"
        )


def _disparity_of_levels(path: str | Path, levels: Array, scale: float) -> tuple[FloatMap, Mask]:
    _check_scale(path, scale)
    return known_values(levels / np.float32(scale))


def _check_scale(path: str | Path, scale: float) -> None:
    if not 0 < scale < math.inf:
        raise InputError(f"{path}: its scale (levels per pixel) must be positive, got {scale}")


def read_disparity_png(
    path: str | Path, scale: float = KITTI_SCALE, bits: int = 16
) -> tuple[FloatMap, Mask]:
    """Read a grey image whose levels are disparities times ``scale``, 0 where unknown.

    Args:
        path: The PNG (or PGM) file.
        scale: Grey levels per pixel of disparity: 256 for KITTI and DrivingStereo, 1 to 4 for
            the 8-bit maps of Middlebury 2003 to 2006.
        bits: 8 or 16. A file of the other depth is refused: it is not the ground truth but a
            picture of it, or belongs to another data set.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no single-channel image of that depth, or the scale not positive.
    """
    return _disparity_of_levels(path, grey_levels(path, bits), scale)


def write_disparity_png(
    path: str | Path, disparity: Array, valid: Mask | None = None, scale: float = KITTI_SCALE
) -> None:
    """Write disparities as a 16-bit PNG, the form in which KITTI gives and takes them.

    Args:
        path: The file to write.
        disparity: Disparity of shape (H, W) in pixels. What is not finite or not above 0 is
            written as 0, unknown.
        valid: Mask (H, W), False where the disparity is not to be written.
        scale: Grey levels per pixel of disparity.

    Raises:
        InputError: If a disparity is too large for 16 bits.
    """
    values, known = known_values(disparity if valid is None else np.where(valid, disparity, 0))
    levels = np.rint(values * scale)
    if levels.max(initial=0) > 65535:
        raise InputError(
            f"{path}: disparity {values.max():.6g} does not fit 16 bits at scale {scale:g}: "
            f"the largest is {65535 / scale:.6g}; use a smaller scale or a PFM file"
        )
    # A known disparity that rounds to 0 would read as unknown.
    write_png(path, np.where(known, levels.clip(1), 0).astype(np.uint16))


def read_disparity_pfm(path: str | Path) -> tuple[FloatMap, Mask]:
    """Read a PFM of disparities, of either sign; unknown where infinite, NaN or 0.

    Args:
        path: The PFM file.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no PFM, or one with three channels.
    """
    disparity = read_pfm(path)
    if disparity.ndim != 2:
        raise InputError(f"{path}: disparity must be a grey PFM (Pf), this one has three channels")
    return positive_values(disparity)


def read_numbers(path: str | Path) -> Array:
    """Read a NumPy file of real numbers of shape (H, W).

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no such array.
    """
    content = read_bytes(path)
    try:
        values = np.load(BytesIO(content), allow_pickle=False)
    except Exception as error:  # whatever a parser makes of any bytes
        raise InputError(f"{path}: not an array file of NumPy: {error}") from None
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "iuf":
        kind = values.dtype if isinstance(values, np.ndarray) else "several arrays, as in .npz"
        raise InputError(f"{path}: disparity must be an array of numbers, got {kind}")
    if values.ndim != 2:
        raise InputError(f"{path}: disparity must have shape (H, W), got {values.shape}")
    return values


def read_disparity_npy(path: str | Path, scale: float | None = None) -> tuple[FloatMap, Mask]:
    """Read a NumPy array of disparities, of either sign; unknown where infinite, NaN or 0.

    Args:
        path: The ``.npy`` file.
        scale: Levels per pixel of disparity, for integers, which need it.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no array of shape (H, W) of real numbers, or one of integers
            comes without a scale.
    """
    values = read_numbers(path)
    if values.dtype.kind == "f":
        return positive_values(values)
    if scale is None:
        raise InputError(
            f"{path}: disparities as {values.dtype} need their scale (levels per pixel): 256 as in "
            "KITTI, 16 as OpenCV's matchers give them, 1 for whole pixels"
        )
    _check_scale(path, scale)
    return positive_values(values / np.float32(scale))


def read_disparity(path: str | Path, scale: float | None = None) -> tuple[FloatMap, Mask]:
    """Read a PFM, NumPy or grey image file of disparities, by its ending.

    Args:
        path: A ``.pfm``, a ``.npy``, or a grey image; one of floating point (TIFF) holds pixels.
        scale: Levels per pixel of disparity, for files of integers. May be left out for 16-bit
            images, where it is 256.

    Returns:
        Disparity (H, W) float32 in pixels, 0 where unknown, and mask (H, W), True where known.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file does not hold disparities, an 8-bit image or an array of integers
            comes without scale, or the scale is not positive.
    """
    path = Path(path)
    if path.suffix.lower() == ".pfm":
        return read_disparity_pfm(path)
    if path.suffix.lower() == ".npy":
        return read_disparity_npy(path, scale)
    levels = decode_image(path)
    if levels.dtype == np.float32 and levels.ndim == 2:
        return positive_values(levels)
    _check_grey(path, levels, 8, 16)
    if scale is None and levels.dtype == np.uint8:
        raise InputError(f"{path}: an 8-bit disparity image needs its scale (levels per pixel)")
    return _disparity_of_levels(path, levels, KITTI_SCALE if scale is None else scale)


def read_levels(path: str | Path) -> Array:
    """Read the first channel of a mask or label image, (H, W), with the file's own dtype."""
    return np.asarray(read_image(path)[..., 0])
