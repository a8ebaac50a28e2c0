"""Uploads: checked before they are decoded, copied into a session, and read from it."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
from PIL import Image

from mobilestereonet.data.files import write_png
from mobilestereonet.data.image_files import read_frames
from mobilestereonet.data.images import Array
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoPair, load_pair
from mobilestereonet.inference.first_look import first_look, require_two_views
from mobilestereonet.inference.tiling import MAX_UNTILED_PIXELS
from mobilestereonet.web.sessions import Session

SUFFIXES = {"PNG": ".png", "JPEG": ".jpg", "MPO": ".jpg", "WEBP": ".webp", "BMP": ".bmp"}
"""Formats that are let in (MPO: a JPEG with more pictures behind), and how we name the files."""

CALIBRATIONS = (".yaml", ".yml", ".xml", ".json", ".txt", ".conf", ".npz")
"""Endings of calibration files."""

MAX_CALIBRATION_BYTES = 2**20
MAX_DECODED_PIXELS = 64_000_000
"""Pixels above which no picture is decoded; telephones have up to 50 millions mostly."""

MIN_JOINED_ASPECT = 1.9
"""Width by height of one picture from which on it may show both views, side by side."""

SIDES = ("left", "right")
"""Slots of a session's pair."""

_PILLOW_FORMATS = ("PNG", "JPEG", "WEBP", "BMP")


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
    with both views is split into them. Another one joins the view that waits for it; where none
    does, it is the left one of a new pair. What is refused changes nothing. A picture that is kept
    as it is is not decoded yet, and a good upload stays until gradio deletes it.

    Args:
        files: Where the browser says that its uploads are, with their names: not to be trusted.
        uploads: Folder of all uploads, and of the sessions' files.
        session: The visitor's session.
        limits: Largest size that is taken.

    Raises:
        InputError: If there is none, there are more than two, or one is no file that was just
            uploaded, too large, or no picture. A bad upload is deleted.
    """
    if len(files) > 2:
        raise InputError(f"these are {len(files)} pictures: drop the left and the right one")
    if not files:
        raise InputError("there is no picture: choose one")
    if len(files) == 2:
        ordered = sorted(files, key=lambda path: path.name.lower())
        checked = [
            (side, *_checked(file, uploads, side, limits))
            for side, file in zip(SIDES, ordered, strict=True)
        ]
        for side, upload, suffix in checked:  # not before both are good
            _keep(upload, session, side, suffix)
        return
    held = [side for side in SIDES if session.holds(side)]
    side = "right" if held == ["left"] else "left"
    upload, suffix = _checked(files[0], uploads, side, limits)
    views = both_views(upload)
    for place, view in zip(SIDES, views, strict=False):
        with session.replace(place) as folder:
            write_png(folder / f"{place}.png", view)
    if not views:
        _keep(upload, session, side, suffix)
        if len(held) == 2:
            session.drop("right")


def _checked(upload: Path, uploads: Path, side: str, limits: UploadLimits) -> tuple[Path, str]:
    """A good upload and the suffix of its format; a bad one is deleted."""
    upload = _uploaded(upload, uploads, f"{side} picture")
    try:
        return upload, _check_picture(upload, side, limits)
    except InputError:
        upload.unlink(missing_ok=True)
        raise


def _keep(upload: Path, session: Session, side: str, suffix: str) -> None:
    """Copy a good upload into a session, with a name of ours."""
    with session.replace(side) as folder:
        shutil.copyfile(upload, folder / f"{side}{suffix}")


def admit_calibration(upload: Path, uploads: Path, session: Session) -> None:
    """Copy an uploaded calibration file into a session's slot ``calibration``, see `admit_pair`."""
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
        with Image.open(path, formats=_PILLOW_FORMATS) as picture:
            (width, height), kind = picture.size, picture.format
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise InputError(f"{side} picture: {too_large}") from None
    except (OSError, ValueError):
        raise InputError(f"{side} picture: this is no PNG, JPEG, WebP or BMP picture") from None
    if width * height > MAX_DECODED_PIXELS:
        raise InputError(f"{side} picture: {width} x {height}, {too_large}")
    return SUFFIXES[str(kind)]


def both_views(picture: Path) -> list[Array]:
    """The left and the right view, if a picture shows both: an MPO, or side by side; else none.

    Whether the halves of a wide picture are two views of one scene tells the first look.
    """
    try:
        with Image.open(picture, formats=_PILLOW_FORMATS) as image:
            if image.format != "MPO" and not _is_wide(max(image.size), min(image.size)):
                return []
        frames = read_frames(picture)
        if len(frames) == 2:
            return frames
        (both,), (height, width) = frames, frames[0].shape[:2]
        if not _is_wide(width, height):
            return []
        views = [both[:, : width // 2], both[:, width // 2 : width // 2 * 2]]
        pair = _load_scaled(views, MAX_UNTILED_PIXELS)
        arrangement, findings = first_look(replace(pair, layout="side-by-side"))
        require_two_views(findings)
    except (InputError, OSError, ValueError):
        return []  # one view, or damaged: reading tells how
    if arrangement.top_bottom:
        return [both[: height // 2], both[height // 2 : height // 2 * 2]]
    return views


def _is_wide(width: int, height: int) -> bool:
    return width >= MIN_JOINED_ASPECT * height


def read_views(session: Session, pixels: int) -> tuple[StereoPair, tuple[int, int]]:
    """Read a session's pair, scaled down if it is large.

    Returns:
        The pair, and the width and height of its views as they were uploaded.

    Raises:
        InputError: If a picture is missing or damaged, or the sizes differ.
    """
    left, right = session.file("left"), session.file("right")
    waiting = left or right
    if waiting is None:
        raise InputError("there is no left picture (any more): choose one")
    if left is None or right is None:
        raise InputError(_missing(waiting, "right" if right is None else "left"))
    try:
        with Image.open(left) as image:
            large = image.size[0] * image.size[1] > pixels
        if large:
            frames = [read_frames(path)[0] for path in (left, right)]
            height, width = frames[0].shape[:2]
            return _load_scaled(frames, pixels), (width, height)
        pair = load_pair(left, right)
        return pair, (pair.width, pair.height)
    except (InputError, OSError) as error:
        # Where the server keeps its files is nobody's business.
        text = str(error).replace(str(left), "left picture")
        raise InputError(text.replace(str(right), "right picture")) from None


def _missing(waiting: Path, side: str) -> str:
    text = f"there is no {side} picture yet: drop it, too"
    with suppress(OSError), Image.open(waiting) as image:
        if _is_wide(*image.size):
            text += " (the halves of this one are not two views of one scene)"
    return text


def _load_scaled(frames: list[Array], pixels: int) -> StereoPair:
    height, width = frames[0].shape[:2]
    scale = min(1.0, math.sqrt(pixels / (width * height)))
    size = max(int(scale * width), 1), max(int(scale * height), 1)
    if frames[1].shape == frames[0].shape:  # else they are refused as they are
        frames = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames]
    return load_pair(*frames)
