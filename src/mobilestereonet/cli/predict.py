"""``msnet predict``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def predict(
    left: Annotated[Path, typer.Argument(help="Left view of a rectified pair.")],
    right: Annotated[Path, typer.Argument(help="Right view, of the same size.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")],
    model: Annotated[
        str | None,
        typer.Option(help="Network, or sgbm. Default: msnet2d, or what the weights hold."),
    ] = None,
    weights: Annotated[
        Path | None, typer.Option(help="Weights file, ours or the authors'.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the facts as JSON.")] = False,
) -> None:
    """Match a pair: disparity as 16-bit PNG (x 256, as KITTI), PFM and NPY, and a picture."""
    import json

    from mobilestereonet.atomic import make_folder
    from mobilestereonet.inference import StereoMatcher, load_pair

    pair = load_pair(left, right)
    matcher = StereoMatcher.from_pretrained(model, weights=weights)
    make_folder(output)
    result = matcher(*pair)
    files = {kind: str(path) for kind, path in result.save(output, left.stem).items()}
    if as_json:
        print(json.dumps({**result.facts, "files": files}, indent=2))
        return
    print("{model} on {runtime}, {width}x{height}: {seconds:.2f} s".format(**result.facts))
    for path in files.values():
        print(path)
