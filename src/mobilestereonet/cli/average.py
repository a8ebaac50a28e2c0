"""``msnet average``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import ends_in, network_name, weights_file
from mobilestereonet.cli.options import new_output


def average(
    weights: Annotated[
        list[str],
        typer.Argument(
            help="Weights files, checkpoints or names of embedded weights.", callback=weights_file
        ),
    ],
    output: Annotated[
        Path,
        new_output(
            "average.safetensors",
            "File to write, ends in .safetensors.",
            ends_in([".safetensors"], "weights are"),
        ),
    ],
    model: Annotated[
        str | None,
        typer.Option(help="Their network, where the files do not tell.", callback=network_name),
    ] = None,
    half: Annotated[bool, typer.Option(help="Write half precision, half the size.")] = False,
) -> None:
    """Average weights, such as those of stages of one training."""
    import torch

    from mobilestereonet.atomic import check_outputs
    from mobilestereonet.weights import average_weights, save_weights

    check_outputs(output)
    mean = average_weights(weights, model=model)
    save_weights(mean, output, dtype=torch.float16 if half else None)
    print(f"{output}: mean of {len(weights)} networks")
