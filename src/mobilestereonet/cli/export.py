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
_PAGE = "web"

_PAGE_MODEL = "msnet2d"
"""Its 2D convolutions are what browsers run fastest."""


def export(
    format_: Annotated[
        str | None,
        typer.Argument(
            metavar="FORMAT",
            help="What to write; --list shows them. web: a page without a server.",
            callback=one_of((*FORMATS, _PAGE)),
        ),
    ] = None,
    folder: Annotated[
        Path | None, typer.Argument(metavar="DIR", help="For web: the folder to write.")
    ] = None,
    *,
    model: Network = None,
    options: NetworkOptions,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write. Default: the model's."),
    ] = None,
    height: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Height of a file of fixed size; others are checked at it. Default: 256; "
            "web: 320.",
        ),
    ] = None,
    width: Annotated[
        int | None, typer.Option(min=1, help="Width, likewise. Default: 512; web: 448.")
    ] = None,
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
    runtime_dir: Annotated[
        Path | None,
        typer.Option(
            help="For web: npm's folder node_modules with onnxruntime-web and three.",
            callback=existing_folder,
        ),
    ] = None,
    list_: Annotated[
        bool, typer.Option("--list", help="List the formats and what is installed.")
    ] = False,
) -> None:
    """Write a network for another runtime: ONNX, OpenVINO, a web page.

    The file is run, and compared with PyTorch, first.
    """
    if list_:
        _print_formats()
        return
    if format_ is None:
        raise InputError("which format? `msnet export --list` shows them")
    options = replace(options, model=model)
    if options.is_standalone:
        raise InputError(f"{model} is no network: it cannot be exported")

    if format_ == _PAGE:
        if output is not None or calibration is not None:
            option = "--calibration" if output is None else "--output"
            raise InputError(f"{option} is not for web, which writes a folder: leave it out")
        _export_page(options, folder, runtime_dir, precision or "fp32", height, width)
        return
    if folder is not None or runtime_dir is not None:
        given = "--runtime-dir" if folder is None else str(folder)
        raise InputError(f"{given} is for web: the file that {format_} writes is named by --output")

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
        size=(height or _SIZE[0], width or _SIZE[1]),
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


def _export_page(
    options: NetworkOptions,
    folder: Path | None,
    runtime: Path | None,
    precision: str,
    height: int | None,
    width: int | None,
) -> None:
    """Write the page, by default with `_PAGE_MODEL`."""
    if folder is None or runtime is None:
        missing = "DIR, the folder to write" if folder is None else "--runtime-dir node_modules"
        raise InputError(f"web needs {missing}: msnet export web DIR --runtime-dir node_modules")

    from mobilestereonet.export.web import PAGE_SIZE, export_page

    if options.is_default:
        options = replace(options, model=_PAGE_MODEL)
    name, net = options.open_network()
    written = export_page(
        net,
        folder,
        runtime=runtime,
        model=name,
        embedded=options.is_embedded,
        precision=precision,
        size=(height or PAGE_SIZE[0], width or PAGE_SIZE[1]),
    )
    print(f"{folder}: {name}, {written.mean:.2g} px from torch on average")
    print(f"try it: python -m http.server -d {folder}, then http://localhost:8000")


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
