"""JPEG files with missing bytes: how many are refused, told or not noticed, and false alarms.

    python benchmarks/jpeg_holes.py FOLDER ... [--holes 600] [--photos 12] [--qualities 75 85 95]

Folders hold pictures, in any depth. Holes of 20 to 400 bytes (cut out, zeros, random bytes) are
made in some of the first folder's, as Pillow writes them without and with subsampled colours.
False alarms are counted on all pictures: JPEG files as they are, and each as OpenCV writes it at
several qualities.
"""

from __future__ import annotations

import argparse
import io
import warnings
from collections import Counter
from itertools import chain, cycle, product
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from PIL import Image

from mobilestereonet import InputError
from mobilestereonet.data import read_image

ENDINGS = (".jpg", ".jpeg", ".png", ".ppm")
WHOLE_QUALITIES = (10, 25, 40, 60, 80)
HOLE_BYTES = (20, 400)
HEADER_BYTES = 1000


def ask(path: Path, content: bytes) -> str:
    """What reading a file of this content says."""
    path.write_bytes(content)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            read_image(path)
        except InputError:
            return "refused"
    return "told" if told else "read"


def encode(picture: Image.Image, quality: int, subsampling: str) -> bytes:
    """A picture as Pillow writes it."""
    stream = io.BytesIO()
    picture.convert("RGB").save(stream, "JPEG", quality=quality, subsampling=subsampling)
    return stream.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--holes", type=int, default=600)
    parser.add_argument("--photos", type=int, default=12)
    parser.add_argument("--qualities", type=int, nargs="+", default=(75, 85, 95))
    args = parser.parse_args()
    files = [
        sorted(path for path in folder.rglob("*") if path.suffix.lower() in ENDINGS)
        for folder in args.folders
    ]
    with TemporaryDirectory() as folder:
        count(files, Path(folder) / "picture.jpg", args.holes, args.photos, args.qualities)


def count(
    files: list[list[Path]], path: Path, number: int, photos: int, qualities: list[int]
) -> None:
    """Read whole and damaged files as ``path``, and print how many were refused, told, or read."""
    whole: Counter[str] = Counter()
    for file in chain.from_iterable(files):
        if file.suffix.lower() in ENDINGS[:2]:
            whole[ask(path, file.read_bytes())] += 1
        picture = cv2.imread(str(file))
        for quality in WHOLE_QUALITIES:
            written = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            whole[ask(path, written.tobytes())] += 1
    rng = np.random.default_rng(0)
    holes: Counter[str] = Counter()
    chosen = files[0][:: max(1, len(files[0]) // photos)][:photos]
    cases = cycle(product(chosen, qualities, ("4:4:4", "4:2:0"), ("cut", "zeros", "random")))
    for _, (file, quality, subsampling, kind) in zip(range(number), cases, strict=False):
        content = encode(Image.open(file), quality, subsampling)
        size = int(rng.integers(*HOLE_BYTES))
        start = int(rng.integers(HEADER_BYTES, len(content) - size))
        random = rng.integers(0, 256, size, np.uint8).tobytes()
        filling = {"cut": b"", "zeros": bytes(size), "random": random}[kind]
        holes[ask(path, content[:start] + filling + content[start + size :])] += 1
    print(f"{sum(whole.values())} whole files:", dict(whole))
    print(f"{sum(holes.values())} with a hole:", dict(holes))


if __name__ == "__main__":
    main()
