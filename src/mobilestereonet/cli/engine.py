"""The network and its engine as options of a command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

Model: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Network; sgbm, too, where pairs are matched. Default: msnet2d, or what the "
        "weights hold."
    ),
]
Weights: TypeAlias = Annotated[
    Path | None, typer.Option(help="Weights file, ours or the authors'.")
]
Runtime: TypeAlias = Annotated[
    str,
    typer.Option(
        help="Engine: torch, onnxruntime, openvino, or auto (the fastest by the last msnet bench "
        "of this network, else torch)."
    ),
]
Precision: TypeAlias = Annotated[
    str, typer.Option(help="auto (bf16 where the processor has it), fp32, bf16, or fp16 on a GPU.")
]
Threads: TypeAlias = Annotated[
    int | None, typer.Option(help="Threads on a CPU. Default: the engine's choice.")
]
Device: TypeAlias = Annotated[
    str, typer.Option(help="auto (a GPU if PyTorch finds one), cpu, cuda, cuda:1 ...")
]


Refine: TypeAlias = Annotated[
    bool | None,
    typer.Option(
        "--refine/--no-refine",
        help="Mend occlusions and edges by the picture. Default: with our weights, not with the "
        "authors'.",
        show_default=False,
    ),
]


def engine_options(
    model: str | None,
    runtime: str,
    precision: str,
    threads: int | None,
    device: str,
    refine: bool | None = None,
) -> dict[str, Any]:
    """What `StereoMatcher.from_pretrained` takes of these options for a model.

    Raises:
        InputError: If the model is sgbm, which has an engine of its own, and one is chosen.
    """
    from mobilestereonet.errors import InputError

    options = {
        "runtime": runtime,
        "precision": precision,
        "threads": threads,
        "device": device,
        "refine": refine,
    }
    if model != "sgbm":
        return options
    defaults = ("auto", "torch", "fp32", None)  # of one command or the other
    chosen = [f"--{name}" for name, value in options.items() if value not in defaults]
    if chosen:
        raise InputError(f"sgbm runs in OpenCV alone: leave {', '.join(chosen)} out")
    return {}
