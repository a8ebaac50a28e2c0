"""``msnet data``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import assignment, data_sets, existing_folder, one_of
from mobilestereonet.cli.options import Textures
from mobilestereonet.errors import InputError
from mobilestereonet.settings import override, parse_assignments

data = typer.Typer(name="data", help="Look at data sets.", no_args_is_help=True)


@data.command()
def preview(
    name: Annotated[
        str,
        typer.Argument(
            help="procedural, or a data set such as kitti2015.",
            callback=one_of(lambda: ["procedural", *data_sets()]),
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="PNG file to write.")],
    root: Annotated[
        Path | None, typer.Option(help="Folder of the data set.", callback=existing_folder)
    ] = None,
    textures: Textures = None,
    count: Annotated[int, typer.Option(min=1, help="Pairs to show.")] = 6,
    seed: Annotated[int, typer.Option(min=0, help="Which scenes, or which frames.")] = 0,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="An option of the data set, such as split=val, or of the scenes, such as "
            "max_disparity=96. Repeat for more.",
            callback=assignment,
        ),
    ] = None,
) -> None:
    """Draw a contact sheet: left, right, disparity and occlusion of some pairs."""
    options = parse_assignments(assignments or [])
    if name != "procedural" and root is None:
        raise InputError(f"data set {name} needs its folder: --root DIR")

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
