"""``msnet data``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.early import assignment, ends_in, existing_folder, one_of
from mobilestereonet.cli.groups import with_options_of_groups
from mobilestereonet.cli.options import AsJson, Split, Textures, new_output
from mobilestereonet.cli.sources import data_sets
from mobilestereonet.errors import InputError
from mobilestereonet.settings import override, parse_assignments

if TYPE_CHECKING:
    from mobilestereonet.data.scanners.registry import DataSetInfo

data = typer.Typer(
    name="data", help="List data sets and look at their pairs.", no_args_is_help=True
)


def list_command(as_json: AsJson = False) -> None:
    """List the data sets: names, splits with their numbers of pairs, options for --set."""
    import json
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from mobilestereonet.data.scanners.registry import list_data_sets

    found = list_data_sets()
    if as_json:
        records = [asdict(info) | {"withheld": sorted(info.withheld)} for info in found]
        print(json.dumps(records, indent=2))
        return
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    for info in found:
        table.add_row(info.name, info.summary)
        options = f"; --set {', '.join(info.options)}" if info.options else ""
        table.add_row("", f"{_splits(info)}{options}", style="dim")
    Console().print(table)
    print("The first split is the default; * has no public ground truth.")
    print("Also procedural, which needs no files: msnet data preview procedural -o scenes.png")


def _splits(info: DataSetInfo) -> str:
    return ", ".join(
        split + ("*" if split in info.withheld else "") + (f" ({count:,})" if count else "")
        for split, count in info.splits.items()
    )


def preview(
    name: Annotated[
        str,
        typer.Argument(
            help="procedural, or a data set of `msnet data list`.",
            callback=one_of(lambda: ["procedural", *data_sets()]),
        ),
    ],
    output: Annotated[
        Path, new_output("preview.png", "PNG file to write.", ends_in([".png"], "pictures are"))
    ],
    root: Annotated[
        Path | None, typer.Option(help="Folder of the data set.", callback=existing_folder)
    ] = None,
    split: Split = None,
    textures: Textures = None,
    count: Annotated[int, typer.Option(min=1, help="Pairs to show.")] = 6,
    seed: Annotated[int, typer.Option(min=0, help="Which scenes, or which frames.")] = 0,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="An option of the data set, such as size=H, or of the scenes, such as "
            "max_disparity=96. Repeat for more.",
            callback=assignment,
        ),
    ] = None,
) -> None:
    """Draw a contact sheet: left, right, disparity and occlusion of some pairs."""
    options = parse_assignments(assignments or [])
    if name != "procedural" and root is None:
        raise InputError(f"data set {name} needs its folder: --root DIR")
    if split is not None:
        if name == "procedural":
            raise InputError(f"procedural scenes have no split {split}: leave --split out")
        options["split"] = split

    import numpy as np

    from mobilestereonet.atomic import check_outputs
    from mobilestereonet.data import open_data_set
    from mobilestereonet.data.files import write_png
    from mobilestereonet.plots import contact_sheet
    from mobilestereonet.scenes import ProceduralScenes
    from mobilestereonet.training.named_recipes import get_recipe

    if root is None or name == "procedural":
        scenes_of_the_recipe = get_recipe("procedural").scenes
        config = override(scenes_of_the_recipe, {"seed": seed, **options}, "scenes")
        scenes = ProceduralScenes(config, textures=textures)
        samples = (scenes[index] for index in range(count))
    else:
        pairs = open_data_set(name, root, **options)
        count = min(count, len(pairs))
        chosen = np.random.default_rng(seed).choice(len(pairs), count, replace=False)
        samples = (pairs[index] for index in sorted(chosen.tolist()))
    check_outputs(output)
    write_png(output, contact_sheet(samples))
    print(f"{output}: {count} pair{'s' if count > 1 else ''} of {name}")


data.command("list", epilog="Example: msnet data list")(with_options_of_groups(list_command))
data.command(epilog="Example: msnet data preview procedural --count 4")(
    with_options_of_groups(preview)
)
