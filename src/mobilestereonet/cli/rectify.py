"""``msnet rectify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.calibration import RigFiles
from mobilestereonet.cli.early import existing_file
from mobilestereonet.cli.options import OutputFolder, RightView
from mobilestereonet.errors import InputError


def rectify(
    left: Annotated[
        Path, typer.Argument(help="Left view as the camera gave it.", callback=existing_file)
    ],
    right: RightView,
    output: OutputFolder,
    *,
    files: RigFiles,
    whole: Annotated[
        bool, typer.Option("--whole", help="Keep all pixels, with black beyond the borders.")
    ] = False,
) -> None:
    """Rectify a pair: left.png, right.png, and calib.txt for `msnet predict --rig`."""
    import sys

    if not files.rig:
        raise InputError("--rig FILE is missing: the calibration of the two cameras")

    from mobilestereonet.atomic import check_outputs, make_folder
    from mobilestereonet.data import read_image, write_png
    from mobilestereonet.data.calibration import write_calibration

    names = ("left.png", "right.png", "calib.txt")
    check_outputs(*(output / name for name in names))
    rectifier = files.read(whole=whole)
    assert rectifier is not None
    raw = read_image(left), read_image(right)
    *views, calibration = rectifier(*raw)
    if views[0] is raw[0]:
        print(f"msnet: {rectifier.rig.name}: the views are rectified already", file=sys.stderr)
    make_folder(output)
    for name, view in zip(names, views, strict=False):
        write_png(output / name, view)
        print(output / name)
    height, width = views[0].shape[:2]
    write_calibration(output / "calib.txt", calibration, (width, height))
    print(output / "calib.txt")
