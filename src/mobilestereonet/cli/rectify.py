"""``msnet rectify``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.calibration import RigFiles
from mobilestereonet.cli.early import existing_source
from mobilestereonet.cli.options import new_output
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.data.images import Array


def rectify(
    left: Annotated[
        str,
        typer.Argument(
            help="Left view as the camera gave it: an image, a folder or pattern of images, or a "
            "video; alone, a side-by-side video.",
            callback=existing_source,
        ),
    ],
    right: Annotated[
        str | None, typer.Argument(help="The right view, likewise.", callback=existing_source)
    ] = None,
    *,
    output: Annotated[Path, new_output("rectified", "Folder to write to.")],
    files: RigFiles,
    whole: Annotated[
        bool, typer.Option("--whole", help="Keep all pixels, with black beyond the borders.")
    ] = False,
) -> None:
    """Rectify a pair, folders or videos by the cameras' calibration.

    A pair gives left.png, right.png, and calib.txt for `msnet predict --rig`. Of folders and videos
    the pairs go to the folders left and right. Exit code 1: some failed.
    """
    import sys

    if not files.rig:
        raise InputError("--rig FILE is missing: the calibration of the two cameras")

    from mobilestereonet.atomic import check_outputs, make_folder
    from mobilestereonet.data import write_png
    from mobilestereonet.data.calibration import write_calibration

    check_outputs(*(output / name for name in ("left.png", "right.png", "calib.txt")))
    rectifier = files.read(whole=whole)
    assert rectifier is not None
    calibration, failed = None, 0
    for name, views in _pairs(left, right):
        try:
            if isinstance(views, str):
                raise InputError(views)
            *rectified, calibration = rectifier(*views)
        except InputError as error:
            if not name:
                raise
            failed += 1
            print(f"msnet: {name} skipped: {error}", file=sys.stderr)
            continue
        if rectified[0] is views[0] and not name:
            print(f"msnet: {rectifier.rig.name}: the views are rectified already", file=sys.stderr)
        for side, view in zip(("left", "right"), rectified, strict=True):
            path = output / (f"{side}/{name}.png" if name else f"{side}.png")
            make_folder(path.parent)
            write_png(path, view)
            print(path)
    if calibration is None:
        raise InputError("no pair could be rectified")
    assert calibration.size is not None
    write_calibration(output / "calib.txt", calibration, calibration.size)
    print(output / "calib.txt")
    if failed:
        sys.exit(1)


def _pairs(left: str, right: str | None) -> Iterator[tuple[str, tuple[Array, Array] | str]]:
    """Pairs of pictures by their names, or what is wrong with one; a single pair has no name."""
    import cv2

    from mobilestereonet.atomic import note_inputs
    from mobilestereonet.data import read_image
    from mobilestereonet.streams import find_pairs, open_stream

    sources = [Path(source) for source in (left, right) if source is not None]
    if right is not None and all(p.is_file() and cv2.haveImageReader(str(p)) for p in sources):
        yield "", (read_image(left), read_image(right))
    elif right is not None and not any(path.is_file() or "://" in str(path) for path in sources):
        pairs = find_pairs(left, right)
        note_inputs(*(path for pair in pairs for path in (pair.left, pair.right)))
        for pair in pairs:
            try:
                yield pair.name, (read_image(pair.left), read_image(pair.right))
            except (InputError, OSError) as error:
                yield pair.name, str(error)
    else:
        for frame in open_stream(left, right).frames:
            if frame.pair is None:
                yield frame.name, frame.problem
            else:
                yield frame.name, (frame.pair.left_image, frame.pair.right_image)
