"""Image files: decoded with damage, size, orientation and levels as the file tells them."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from mobilestereonet.data.files import read_bytes
from mobilestereonet.data.images import Array
from mobilestereonet.data.jpeg_files import check_jpeg, cut_frames
from mobilestereonet.data.jpeg_traces import missing_bytes
from mobilestereonet.data.png_files import SIGNATURE, check_png, png_pixels
from mobilestereonet.data.quiet import quiet_decoders
from mobilestereonet.data.tiff_files import check_tiff
from mobilestereonet.errors import InputError

MAX_IMAGE_PIXELS = 178_956_970
"""Largest picture that is decoded: Pillow's limit, above which a header is more likely damaged."""

ORIENTATION_TAG = 0x0112
"""Number of the orientation in EXIF and TIFF."""

_TURNED: dict[int, tuple[str, Callable[[Array], Array]]] = {
    2: ("mirrored", lambda image: image[:, ::-1]),
    3: ("turned by 180 degrees", lambda image: image[::-1, ::-1]),
    4: ("turned upside down and mirrored", lambda image: image[::-1]),
    5: ("turned by 90 degrees and mirrored", lambda image: image.swapaxes(0, 1)),
    6: ("turned by 90 degrees clockwise", lambda image: np.rot90(image, -1)),
    7: ("turned by 90 degrees and mirrored", lambda image: np.rot90(image, 2).swapaxes(0, 1)),
    8: ("turned by 90 degrees anticlockwise", lambda image: np.rot90(image)),
}
"""What each orientation of EXIF asks a viewer to do, in words and in NumPy."""

_PILLOW_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "PPM", "WEBP", "JPEG2000", "GIF")
"""What Pillow may open ("JPEG" is MPO, too): it would hand EPS files to another program."""

_BITS_TAG = 258
_PHOTOMETRIC_TAG = 262
"""Tags of TIFF; a photometric interpretation of 0 is "white is zero"."""

_PNM_MAXIMUM = re.compile(
    rb"P[2356](?:\s+|#[^\n]*\n)+\d+(?:\s+|#[^\n]*\n)+\d+(?:\s+|#[^\n]*\n)+(\d+)"
    rb"|P7\n(?:[^\n]*\n)*?MAXVAL (\d+)"
)


@dataclass(frozen=True, eq=False)
class ImageFileContent:
    """Content of an image file.

    Attributes:
        pixels: RGB image (H, W, 3), upright: uint8, uint16 or float32.
        turned: How the pixels were turned because the file says so, in words; empty if they were
            not.
    """

    pixels: Array
    turned: str = ""


class _Stored(NamedTuple):
    """Levels as a file stores them, in OpenCV's order of channels."""

    levels: Array
    orientation: int = 1
    applied: bool = False  # whether the levels are turned already


def decode_image(path: str | Path) -> Array:
    """Read an image's levels as they are stored: (H, W) or (H, W, C), BGR, the file's own dtype.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no image, a damaged one, or larger than `MAX_IMAGE_PIXELS`.
    """
    return decode_bytes(path, read_bytes(path))


def decode_bytes(name: str | Path, content: bytes) -> Array:
    """Decode an image file's content as `decode_image` does; the errors are the same.

    Args:
        name: What messages call it.
        content: The bytes of the file.
    """
    return _decode(name, content).levels


def read_image(path: str | Path) -> Array:
    """Read an image of any format that OpenCV reads.

    Grey images are repeated to three channels and an alpha channel is dropped. An orientation
    that the file tells (EXIF, TIFF) is applied, as viewers and OpenCV's ``imread`` do.

    Args:
        path: The image file.

    Returns:
        RGB image of shape (H, W, 3) with the file's own dtype: uint8, uint16 or float32. The
        levels of a PGM or PPM go up to 255 or 65535, whatever its own maximum is.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no image, a damaged one, larger than `MAX_IMAGE_PIXELS`, or of
            another dtype.
    """
    return read_image_file(path).pixels


def read_image_file(path: str | Path) -> ImageFileContent:
    """Read an image as `read_image` does, and how it was turned; the errors are the same."""
    return _read(path, read_bytes(path))


def _read(path: str | Path, content: bytes) -> ImageFileContent:
    stored = _decode(path, content)
    image = stored.levels
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        raise InputError(f"{path}: pixels are {image.dtype}, need uint8, uint16 or float32")
    if image.ndim == 2:
        image = image[..., None]
    if image.shape[2] not in (1, 3, 4):
        raise InputError(f"{path}: {image.shape[2]} channels, need 1, 3 or 4")
    image = _full_range(image, content)
    turned, turn = _TURNED.get(stored.orientation, ("", np.asarray))
    if not stored.applied:
        image = turn(image)
    image = image.repeat(3, axis=2) if image.shape[2] == 1 else image[..., 2::-1]
    return ImageFileContent(np.ascontiguousarray(image), turned)


def read_frames(path: str | Path) -> list[Array]:
    """Read both pictures of a stereo camera's MPO file, or the one of any other.

    Returns:
        RGB images as `read_image` gives them: two of one size, left and right, or one.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: As `read_image`.
    """
    content = read_bytes(path)
    image, frames = _open(path, content), [content]
    if image is not None and image.format == "MPO":
        with _damage_reported(path):
            frames = cut_frames(image, content)
    return [_read(path, frame).pixels for frame in frames]


def upright(image: Image.Image) -> tuple[Image.Image, str]:
    """A PIL image as a viewer shows it, and how it was turned, in words."""
    turned, _ = _TURNED.get(_orientation(image.getexif), ("", np.asarray))
    return (ImageOps.exif_transpose(image) if turned else image), turned


def _decode(path: str | Path, content: bytes) -> _Stored:
    if content.startswith(SIGNATURE):
        return _decode_png(path, content)
    image = _open(path, content)
    if image is None:  # a format that OpenCV alone may know
        return _Stored(_decode_by_opencv(path, content))
    orientation = _orientation(image.getexif)
    if image.format == "TIFF":
        return _Stored(_decode_tiff(path, content, image), orientation, applied=True)
    if image.format in ("JPEG", "MPO"):
        _check_jpeg(path, content, image)
    else:
        with _damage_reported(path):
            image.load()
    return _Stored(_decode_by_opencv(path, content), orientation)


def _check_jpeg(path: str | Path, content: bytes, image: Any) -> None:
    with _damage_reported(path):
        grey = check_jpeg(content)
        if grey is None:
            image.load()  # tells whether the file is cut, no more
    if grey is None:
        text = f"a JPEG of {image.mode} with subsampled colours: damage within it is not noticed"
        warnings.warn(f"{path}: {text}", stacklevel=2)
    elif trace := missing_bytes(content, grey, image):
        text = f"{trace}; bytes of the file may be missing: look at it, or copy it again"
        warnings.warn(f"{path}: {text}", stacklevel=2)


def _decode_png(path: str | Path, content: bytes) -> _Stored:
    with _damage_reported(path):
        pixels = png_pixels(content)
        exif = check_png(content)
    if pixels > MAX_IMAGE_PIXELS:
        raise _too_large(path, pixels)

    def read_exif() -> Image.Exif:
        notes = Image.Exif()
        notes.load(exif)
        return notes

    return _Stored(_decode_by_opencv(path, content), _orientation(read_exif))


def _decode_tiff(path: str | Path, content: bytes, image: Any) -> Array:
    """Decode a TIFF: 8 bits by Pillow, which knows that alpha may be multiplied in already."""
    eight_bits = set(image.tag_v2.get(_BITS_TAG, (1,))) == {8}
    inverted = image.tag_v2.get(_PHOTOMETRIC_TAG) == 0
    with _damage_reported(path):
        check_tiff(content, image.tag_v2, image.width * image.height)
        image.load()
    if eight_bits and image.mode in ("L", "RGB", "RGBA"):
        levels = np.asarray(image)
        return levels if levels.ndim == 2 else levels[..., [2, 1, 0, 3][: levels.shape[2]]]
    levels = _decode_by_opencv(path, content)
    return 65535 - levels if inverted and levels.dtype == np.uint16 else levels


def _decode_by_opencv(path: str | Path, content: bytes) -> Array:
    try:
        with quiet_decoders:
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:  # empty, or more pixels than it takes
        image = None
    if image is None:
        raise InputError(
            f"{path}: not an image that OpenCV can read ({len(content)} bytes); "
            "is it damaged, or in another format than its name says?"
        )
    return np.asarray(image)


def _open(path: str | Path, content: bytes) -> Any:
    """The file as Pillow sees it, not decoded yet; None if it does not know the format."""
    try:
        with quiet_decoders:
            return Image.open(io.BytesIO(content), formats=_PILLOW_FORMATS)
    except Image.DecompressionBombError as error:
        pixels = next(iter(re.findall(r"\d+", str(error))), "too many")
        raise _too_large(path, pixels) from None
    except UnidentifiedImageError:
        return None
    except Exception as error:  # whatever a parser makes of any bytes
        raise _damaged(path, error) from None


def _too_large(path: str | Path, pixels: int | str) -> InputError:
    return InputError(
        f"{path}: {pixels} pixels, if its header is right, and at most {MAX_IMAGE_PIXELS} are "
        "decoded: scale it down, or cut it"
    )


def _orientation(read_exif: Callable[[], Image.Exif]) -> int:
    try:
        with quiet_decoders:
            return int(read_exif().get(ORIENTATION_TAG, 1))
    except Exception:  # EXIF that is damaged does not tell any
        return 1


@contextmanager
def _damage_reported(path: str | Path) -> Iterator[None]:
    """Context in which a decoder's error becomes one that names the file."""
    try:
        with quiet_decoders:
            yield
    except Exception as error:  # whatever a decoder makes of any bytes
        raise _damaged(path, error) from None


def _damaged(path: str | Path, reason: object) -> InputError:
    return InputError(
        f"{path}: not an image that is whole: {reason}; copy it again from where it comes from"
    )


def _full_range(image: Array, content: bytes) -> Array:
    """Scale the levels of a PNM whose maximum is another than 255 or 65535."""
    match = _PNM_MAXIMUM.match(content)
    white = 65535 if image.dtype == np.uint16 else 255
    maximum = int(match[1] or match[2]) if match else white
    # OpenCV scales the text forms of 8 bits itself.
    if maximum in (0, white) or (maximum < 255 and content[1:2] in b"23"):
        return image
    return np.rint(image.clip(0, maximum) * (white / maximum)).astype(image.dtype)
