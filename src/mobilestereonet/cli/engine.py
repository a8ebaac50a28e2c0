"""The network and its engine as options of a command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

if TYPE_CHECKING:
    from mobilestereonet.nets.model import StereoModel

Model: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Network; sgbm and onnx:FILE, too, where pairs are matched. Default: msnet2d, or "
        "what the weights hold."
    ),
]
Weights: TypeAlias = Annotated[
    Path | None, typer.Option(help="Weights file, ours or the authors'.")
]
Runtime: TypeAlias = Annotated[
    str,
    typer.Option(
        help="Engine: torch, onnxruntime or openvino; msnet bench tells which one is the fastest."
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
        InputError: If the model runs in an engine of its own, and another one is chosen.
    """
    from mobilestereonet.engines.choose import is_standalone
    from mobilestereonet.errors import InputError

    options = {
        "runtime": runtime,
        "precision": precision,
        "threads": threads,
        "device": device,
        "refine": refine,
    }
    if not is_standalone(model):
        return options
    kept = {} if model == "sgbm" else {"threads": threads, "device": device, "refine": refine}
    defaults = ("auto", "torch", "fp32", None)  # of one command or the other
    chosen = [
        f"--{name}" for name, value in options.items() if value not in defaults and name not in kept
    ]
    if chosen:
        library = "OpenCV" if model == "sgbm" else "ONNX Runtime"
        raise InputError(f"{model} runs in {library} alone: leave {', '.join(chosen)} out")
    return kept


def open_network(model: str | None, weights: Path | None) -> tuple[str, StereoModel]:
    """Network with trained weights that these options of a command ask for, and its name.

    Args:
        model: Model by name, file, folder or "org/name"; by default `DEFAULT_MODEL`, or what
            ``weights`` holds.
        weights: Weights file; ``model`` is then the name of its network.

    Raises:
        FileNotFoundError: If there are no such weights.
        InputError: If the file is corrupted, or holds another network than ``model``.
    """
    from mobilestereonet.inference import DEFAULT_MODEL
    from mobilestereonet.nets import model_name
    from mobilestereonet.weights import load_model

    if weights is None:
        model = model or DEFAULT_MODEL
        return Path(model).name, load_model(model)
    net = load_model(weights, model=model)
    return model or model_name(net.config), net
