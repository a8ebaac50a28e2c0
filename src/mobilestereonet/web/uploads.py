"""Uploads: checked before they are decoded, and copied into a session."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from mobilestereonet.errors import InputError
from mobilestereonet.inference.tiling import MAX_UNTILED_PIXELS
from mobilestereonet.web.sessions import Session

SUFFIXES = {"PNG": ".png", "JPEG": ".jpg", "MPO": ".jpg", "WEBP": ".webp", "BMP": ".bmp"}
"""Formats that are let in (MPO: a JPEG with more pictures behind), and how we name the files."""


@dataclass(frozen=True)
class UploadLimits:
    """Limits of what a visitor may ask of the server.

    Attributes:
        megabytes: Largest upload.
        pixels: Largest picture.
        waiting: Visitors in the queue; one more is sent away.
    """

    megabytes: int = 20
    pixels: int = MAX_UNTILED_PIXELS
    waiting: int = 8

    def __post_init__(self) -> None:
        for name in ("megabytes", "pixels", "waiting"):
            if getattr(self, name) < 1:
                raise InputError(f"limits: {name} must be at least 1, got {getattr(self, name)}")


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
    upload = upload.resolve()
    # gradio puts an upload into a folder of its own, straight below the one of all uploads;
    # what lies deeper is another visitor's.
    if upload.parent.parent != uploads.resolve() or not upload.is_file():
        raise InputError(f"{side} picture: the upload is not there: choose it again")
    try:
        suffix = _check_picture(upload, side, limits)
    except InputError:
        upload.unlink(missing_ok=True)
        raise
    with session.replace(side) as folder:
        return Path(shutil.copyfile(upload, folder / f"{side}{suffix}"))


def _check_picture(path: Path, side: str, limits: UploadLimits) -> str:
    """Check size and format by the first bytes; returns the suffix of the format."""
    if path.stat().st_size > limits.megabytes * 2**20:
        raise InputError(f"{side} picture: the file has more than {limits.megabytes} MB")
    try:
        with Image.open(path, formats=("PNG", "JPEG", "WEBP", "BMP")) as picture:
            (width, height), kind = picture.size, picture.format
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise InputError(f"{side} picture: {_too_large(limits)}") from None
    except (OSError, ValueError):
        raise InputError(f"{side} picture: this is no PNG, JPEG, WebP or BMP picture") from None
    if width * height > limits.pixels:
        raise InputError(f"{side} picture: {width} x {height}, {_too_large(limits)}")
    return SUFFIXES[str(kind)]


def _too_large(limits: UploadLimits) -> str:
    return (
        f"more than {limits.pixels / 1e6:.1f} megapixels: make both pictures smaller (and the "
        "focal length with them)"
    )
