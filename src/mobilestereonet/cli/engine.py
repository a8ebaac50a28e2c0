"""The network and its engine as options of a command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

if TYPE_CHECKING:
    from mobilestereonet.inference import StereoMatcher
    from mobilestereonet.nets.model import StereoModel

_SOURCES = (
    "Name of a model (see msnet models), weights file or folder, org/name on the Hugging Face hub"
)
_DEFAULT = "Default: msnet3d, or what the weights hold; msnet2d is the faster one."

Model: TypeAlias = Annotated[
    str | None, typer.Option(help=f"{_SOURCES}; sgbm or onnx:FILE. {_DEFAULT}")
]
Network: TypeAlias = Annotated[str | None, typer.Option(help=f"{_SOURCES}. {_DEFAULT}")]
"""A model that is a network of PyTorch, as an export needs it."""
Weights: TypeAlias = Annotated[
    Path | None, typer.Option(help="Weights file of this package, or checkpoint of the authors.")
]
Runtime: TypeAlias = Annotated[
    str,
    typer.Option(
        help="Engine: torch, onnxruntime or openvino (`msnet bench` times them on this machine)."
    ),
]
Precision: TypeAlias = Annotated[
    str,
    typer.Option(
        help="fp32, bf16, fp16 (GPU), or auto: bf16 where the processor or GPU has it, else fp32."
    ),
]
Threads: TypeAlias = Annotated[
    int | None, typer.Option(help="Threads on a CPU. Default: the engine's choice.")
]
Device: TypeAlias = Annotated[
    str,
    typer.Option(
        help="auto (a GPU if the engine finds one), cpu, cuda, cuda:1, mps; with openvino GPU, NPU."
    ),
]


Refine: TypeAlias = Annotated[
    bool | None,
    typer.Option(
        "--refine/--no-refine",
        help="Image-guided refinement of occlusions and edges. Default: with this package's "
        "weights, not with the authors'.",
        show_default=False,
    ),
]


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


def network_values(settings: list[str] | None) -> dict[str, Any]:
    """Values of a network's config from assignments such as ``net.estimator=mean``.

    Raises:
        InputError: If one is no assignment, or none of the network's.
    """
    from mobilestereonet.errors import InputError
    from mobilestereonet.settings import parse_assignments

    values = parse_assignments(settings or [])
    for name, value in values.items():
        if not name.startswith("net.") or name == "net.":
            raise InputError(f"--set {name}={value}: write it as net.{name}={value}")
    return {name.removeprefix("net."): value for name, value in values.items()}


def open_matcher(
    model: str | None,
    weights: Path | None,
    runtime: str,
    precision: str,
    threads: int | None,
    device: str,
    refine: bool | None = None,
    **options: Any,
) -> StereoMatcher:
    """Make the matcher that these options of a command ask for.

    Args:
        model: Model by name, file, folder or "org/name"; by default `DEFAULT_MODEL`, or what
            ``weights`` holds.
        weights: Weights file; ``model`` is then the name of its network.
        runtime: Name of the engine.
        precision: See `StereoMatcher`.
        threads: Likewise.
        device: Likewise.
        refine: Likewise.
        **options: Other arguments of `StereoMatcher.from_pretrained`.

    Raises:
        FileNotFoundError: If there is no such weights file.
        InputError: If a value is bad, or the model runs in an engine of its own and an engine is
            chosen.
    """
    from mobilestereonet.engines.choose import is_standalone
    from mobilestereonet.errors import InputError
    from mobilestereonet.inference import DEFAULT_MODEL, StereoMatcher

    if model is not None and is_standalone(model):
        if weights is not None:
            raise InputError(f"{model} has no weights to read from {weights}: leave them out")
        given: dict[str, Any] = {"runtime": runtime, "precision": precision}
        if model == "sgbm":
            given |= {"threads": threads, "device": device}
        defaults = ("auto", "torch", "fp32", None)  # of one command or the other
        if chosen := [f"--{name}" for name, value in given.items() if value not in defaults]:
            library = "OpenCV" if model == "sgbm" else "ONNX Runtime"
            raise InputError(f"{model} runs in {library} alone: leave {', '.join(chosen)} out")
        return StereoMatcher.from_pretrained(
            model, threads=threads, device=device, refine=refine, **options
        )
    return StereoMatcher.from_pretrained(
        weights or model or DEFAULT_MODEL,
        model=model if weights else None,
        engine=runtime,
        precision=precision,
        threads=threads,
        device=device,
        refine=refine,
        **options,
    )
