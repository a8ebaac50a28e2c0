"""``msnet average``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def average(
    weights: Annotated[
        list[Path], typer.Argument(help="Weights files or names of embedded weights.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write, ends in .safetensors.")
    ],
) -> None:
    """Average weights, such as those of several stages of one training."""
    from mobilestereonet.weights import average_weights, save_weights

    save_weights(average_weights(weights), output)
    print(f"{output}: mean of {len(weights)} networks")
