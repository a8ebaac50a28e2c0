"""Uploads: checked before they are decoded, copied into a session, and read from it."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
from PIL import Image

from mobilestereonet.data.image_files import read_frames
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoPair, load_pair
from mobilestereonet.inference.tiling import MAX_UNTILED_PIXELS
from mobilestereonet.web.sessions import Session

SUFFIXES = {"PNG": ".png", "JPEG": ".jpg", "MPO": ".jpg", "WEBP": ".webp", "BMP": ".bmp"}
"""Formats that are let in (MPO: a JPEG with more pictures behind), and how we name the files."""

CALIBRATIONS = (".yaml", ".yml", ".xml", ".json", ".txt", ".conf", ".npz")
"""Endings of calibration files."""

MAX_CALIBRATION_BYTES = 2**20
MAX_DECODED_PIXELS = 64_000_000
"""Pixels above which no picture is decoded; telephones have up to 50 millions mostly."""

_ORIENTATION_TAG = 274
MIN_JOINED_ASPECT = 1.9
"""Width by height of one picture from which on it may show both views, side by side."""


@dataclass(frozen=True)
class UploadLimits:
    """Limits of what a visitor may ask of the server.

    Attributes:
        megabytes: Largest upload.
        pixels: Larger pictures are scaled down to so many pixels.
        waiting: Visitors in the queue; one more is sent away.
    """

    megabytes: int = 20
    pixels: int = MAX_UNTILED_PIXELS
    waiting: int = 8

    def __post_init__(self) -> None:
        for name in ("megabytes", "pixels", "waiting"):
            if getattr(self, name) < 1:
                raise InputError(f"limits: {name} must be at least 1, got {getattr(self, name)}")


def admit_pair(
    files: Sequence[Path], uploads: Path, session: Session, limits: UploadLimits
) -> None:
    """Take what was dropped on the page into a session: both views, one with both, or one.

    Two files are left and right by their names: ``im0 im1``, ``left right``, ``a_L a_R``. One
    alone is the right view if a left one waits for it, unless it shows both.

    Args:
        files: Where the browser says that its uploads are, with their names: not to be trusted.
        uploads: Folder of all uploads, and of the sessions' files.
        session: The visitor's session.
        limits: Largest size that is taken.

    Raises:
        InputError: If there is none, there are more than two, or `admit` refuses one.
    """
    if len(files) > 2:
        raise InputError(f"these are {len(files)} pictures: drop the left and the right one")
    if not files:
        raise InputError("there is no picture: choose one")
    first, *others = sorted(files, key=lambda path: path.name.lower())
    left = session.file("left")
    waits = left is not None and session.file("right") is None and not shows_both(left)
    if others or not waits:
        admit(first, uploads, session, "left", limits)
        session.drop("right")
        for other in others:
            admit(other, uploads, session, "right", limits)
    elif shows_both(admit(first, uploads, session, "right", limits)):
        session.swap("left", "right")
        session.drop("right")


def admit(upload: Path, uploads: Path, session: Session, side: str, limits: UploadLimits) -> Path:
    """Copy an uploaded picture into a session, or delete it. It is not decoded yet.

    A good upload stays until gradio deletes it.

    Args:
        upload: Where the browser says that its upload is: not to be trusted.
        uploads: Folder of all uploads, and of the sessions' files.
        session: The visitor's session.
        side: ``left`` or ``right``.
        limits: Largest size that is taken.

    Returns:
        The file in the session, with a name of ours.

    Raises:
        InputError: If it is no file that was just uploaded, too large, or no picture. A bad
            upload is deleted.
    """
    upload = _uploaded(upload, uploads, f"{side} picture")
    try:
        suffix = _check_picture(upload, side, limits)
    except InputError:
        upload.unlink(missing_ok=True)
        raise
    with session.replace(side) as folder:
        return Path(shutil.copyfile(upload, folder / f"{side}{suffix}"))


def admit_calibration(upload: Path, uploads: Path, session: Session) -> None:
    """Copy an uploaded calibration file into a session's slot ``calibration``, see `admit`."""
    name = "calibration file"
    upload = _uploaded(upload, uploads, name)
    suffix = upload.suffix.lower()
    problem = ""
    if suffix not in CALIBRATIONS:
        problem = f"its name must end with one of {' '.join(CALIBRATIONS)}"
    elif upload.stat().st_size > MAX_CALIBRATION_BYTES:
        problem = f"it has more than {MAX_CALIBRATION_BYTES // 2**20} MB"
    if problem:
        upload.unlink(missing_ok=True)
        raise InputError(f"{name}: {problem}")
    with session.replace("calibration") as folder:
        shutil.copyfile(upload, folder / f"calibration{suffix}")


def _uploaded(upload: Path, uploads: Path, name: str) -> Path:
    upload = upload.resolve()
    # gradio puts an upload into a folder of its own, straight below the one of all uploads;
    # what lies deeper is another visitor's.
    if upload.parent.parent != uploads.resolve() or not upload.is_file():
        raise InputError(f"{name}: the upload is not there: choose it again")
    return upload


def _check_picture(path: Path, side: str, limits: UploadLimits) -> str:
    """Check size and format by the first bytes; returns the suffix of the format."""
    if path.stat().st_size > limits.megabytes * 2**20:
        raise InputError(f"{side} picture: the file has more than {limits.megabytes} MB")
    too_large = f"more than {MAX_DECODED_PIXELS / 1e6:.0f} megapixels: make both pictures smaller"
    try:
        with Image.open(path, formats=("PNG", "JPEG", "WEBP", "BMP")) as picture:
            (width, height), kind = picture.size, picture.format
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise InputError(f"{side} picture: {too_large}") from None
    except (OSError, ValueError):
        raise InputError(f"{side} picture: this is no PNG, JPEG, WebP or BMP picture") from None
    if width * height > MAX_DECODED_PIXELS:
        raise InputError(f"{side} picture: {width} x {height}, {too_large}")
    return SUFFIXES[str(kind)]


def shows_both(picture: Path) -> bool:
    """Whether a picture of a session shows both views by its form: an MPO, or twice as wide."""
    try:
        with Image.open(picture) as image:
            width, height = image.size
            if image.getexif().get(_ORIENTATION_TAG, 1) > 4:
                width, height = height, width
            both = image.format == "MPO" and len(read_frames(picture)) == 2
    except (InputError, OSError, ValueError):
        return False  # damaged: reading tells how
    return both or width >= MIN_JOINED_ASPECT * height


def read_views(session: Session, pixels: int) -> tuple[StereoPair, tuple[int, int]]:
    """Read a session's pair, scaled down if it is large.

    Returns:
        The pair, and the width and height of its views as they were uploaded.

    Raises:
        InputError: If a picture is missing or damaged, or the sizes differ.
    """
    left, right = session.file("left"), session.file("right")
    if left is None:
        raise InputError("there is no left picture (any more): choose one")
    if right is None and not shows_both(left):
        raise InputError("there is no right picture yet: drop it, too")
    try:
        with Image.open(left) as image:
            large = image.size[0] * image.size[1] > pixels
        if large:
            return _read_scaled(left, right, pixels)
        pair = load_pair(left, right)
        return pair, (pair.width, pair.height)
    except (InputError, OSError) as error:
        # Where the server keeps its files is nobody's business.
        text = str(error).replace(str(left), "left picture")
        raise InputError(text.replace(str(right), "right picture")) from None


def _read_scaled(left: Path, right: Path | None, pixels: int) -> tuple[StereoPair, tuple[int, int]]:
    frames = (
        read_frames(left) if right is None else [read_frames(path)[0] for path in (left, right)]
    )
    joined = len(frames) == 1
    height, width = frames[0].shape[:2]
    if joined:
        width //= 2
        frames = [frames[0][:, :width], frames[0][:, width : 2 * width]]
    scale = min(1.0, math.sqrt(pixels / (width * height)))
    size = max(int(scale * width), 1), max(int(scale * height), 1)
    if frames[1].shape == frames[0].shape:  # else they are refused as they are
        frames = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames]
    pair = load_pair(*frames)
    return replace(pair, layout="side-by-side" if joined else ""), (width, height)
