"""``msnet export``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import EXPORT_PRECISIONS, FORMATS, existing_folder, one_of
from mobilestereonet.cli.engine import Network, NetworkOptions
from mobilestereonet.errors import InputError

_SIZE = (256, 512)


def export(
    format_: Annotated[
        str | None,
        typer.Argument(
            metavar="FORMAT", help="What to write; --list shows them.", callback=one_of(FORMATS)
        ),
    ] = None,
    *,
    model: Network = None,
    options: NetworkOptions,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write. Default: the model's."),
    ] = None,
    height: Annotated[
        int, typer.Option(help="Height of a file of fixed size; others are checked at it.")
    ] = _SIZE[0],
    width: Annotated[
        int, typer.Option(help="Width of a file of fixed size; others are checked at it.")
    ] = _SIZE[1],
    precision: Annotated[
        str | None,
        typer.Option(
            help="fp32, fp16 or int8, as the format has it.", callback=one_of(EXPORT_PRECISIONS)
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="For int8: folder with left/*.png and right/*.png, instead of own scenes.",
            callback=existing_folder,
        ),
    ] = None,
    with_refinement: Annotated[
        bool,
        typer.Option(
            "--with-refinement", help="Refine the disparity inside the file, as msnet predict does."
        ),
    ] = False,
    list_: Annotated[
        bool, typer.Option("--list", help="List the formats and what is installed.")
    ] = False,
) -> None:
    """Export a network to a file for another runtime; it is run and compared with torch first."""
    if list_:
        _print_formats()
        return
    if format_ is None:
        raise InputError("which format? `msnet export --list` shows them")
    options = replace(options, model=model)
    if options.is_standalone:
        raise InputError(f"{model} is no network: it cannot be exported")

    from mobilestereonet.export import export_model, find_format

    found = find_format(format_)
    precision = precision or found.precisions[0]
    found.check(precision)
    name, net = options.open_network()
    default = name if precision == found.precisions[0] else f"{name}-{precision}"
    written = export_model(
        format_,
        net,
        output or Path(default + found.ending),
        model=name,
        embedded=options.is_embedded,
        precision=precision,
        size=(height, width),
        calibration=calibration,
        refine=with_refinement,
    )
    print(f"{name} as {format_}, {precision}: {_sentence(written.versions)}")
    print(f"{written.path}: {written.size / 1e6:.2f} MB")
    if written.mean is None:
        print(f"not run: {found.note}")
        return
    print(
        "on scikit-image's Motorcycle, {} x {} (height x width): ".format(*written.shape)
        + f"{written.mean:.2g} px from torch on average, {written.largest:.2g} px at most"
    )
    print(f"{written.seconds:.3f} s a pair, {written.ratio:.2f} times the time of eager torch")


def _sentence(versions: Mapping[str, str | None]) -> str:
    return ", ".join(f"{name} {version or 'missing'}" for name, version in versions.items())


def _print_formats() -> None:
    from rich.console import Console
    from rich.table import Table

    from mobilestereonet.export import FORMATS

    table = Table("format", "precisions", "size", "packages", "note")
    for name, format_ in FORMATS.items():
        table.add_row(
            name,
            ", ".join(format_.precisions),
            "any" if format_.dynamic else "fixed",
            _sentence({**format_.versions(), **format_.versions(format_.precisions[-1])}),
            format_.note,
        )
    Console().print(table)
    print('what is missing comes with pip install "mobilestereonet[FORMAT]" (and [int8])')
