"""``msnet rectify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import UNITS, existing_file, one_of
from mobilestereonet.cli.options import OutputFolder, RightView


def rectify(
    left: Annotated[
        Path, typer.Argument(help="Left view as the camera gave it.", callback=existing_file)
    ],
    right: RightView,
    calib: Annotated[
        list[Path],
        typer.Option(
            help="OpenCV stereo calibration (YAML, XML, JSON): M1 D1 M2 D2 R T. Repeat if it is in "
            "two files.",
            callback=existing_file,
        ),
    ],
    output: OutputFolder,
    unit: Annotated[
        str | None,
        typer.Option(
            help="Unit of T, m or mm: that of the board's squares.", callback=one_of(UNITS)
        ),
    ] = None,
    whole: Annotated[
        bool, typer.Option("--whole", help="Keep all pixels, with black beyond the borders.")
    ] = False,
) -> None:
    """Rectify a pair: left.png, right.png, and calib.txt for `msnet predict --calib`."""
    from mobilestereonet.atomic import check_outputs, make_folder
    from mobilestereonet.data import read_image, write_png
    from mobilestereonet.data.calibration import write_calibration
    from mobilestereonet.data.camera_files import read_rig
    from mobilestereonet.inference.rectify import rectify_pair

    names = ("left.png", "right.png", "calib.txt")
    check_outputs(*(output / name for name in names))
    rig = read_rig(*calib, unit=unit)
    pair = rectify_pair(read_image(left), read_image(right), rig, whole=whole)
    make_folder(output)
    *views, calibration = pair
    for name, view in zip(names, views, strict=False):
        write_png(output / name, view)
        print(output / name)
    height, width = views[0].shape[:2]
    write_calibration(output / "calib.txt", calibration, (width, height))
    print(output / "calib.txt")
