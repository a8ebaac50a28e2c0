"""The network and its engine as options of a command."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from mobilestereonet.cli.early import (
    ENGINES,
    PRECISIONS,
    QUALITIES,
    check_network_values,
    check_trained,
    device_name,
    each,
    one_of,
    trained_names,
    weights_file,
)
from mobilestereonet.errors import InputError
from mobilestereonet.settings import parse_assignments

if TYPE_CHECKING:
    from mobilestereonet.inference import StereoMatcher
    from mobilestereonet.nets.model import StereoModel

_SOURCES = (
    "Name of a model (see msnet models), weights file or folder, org/name on the Hugging Face hub"
)
_MAX_THREADS = 1024
"""Threads above which OpenMP may end the process for want of memory."""
_DEFAULT = "Default: what the weights hold, else that of the quality balanced."


def network_values(assignments: list[str] | None) -> dict[str, Any]:
    """Values of a network's config, by name, from assignments such as ``net.estimator=mean``.

    Raises:
        InputError: If one is no assignment, or none of the network's.
    """
    values = parse_assignments(assignments or [])
    for name, value in values.items():
        if not name.startswith("net.") or name == "net.":
            raise InputError(f"--set {name}={value}: write it as net.{name}={value}")
    return {name.removeprefix("net."): value for name, value in values.items()}


Model: TypeAlias = Annotated[
    str | None,
    typer.Option(help=f"{_SOURCES}; sgbm or onnx:FILE. {_DEFAULT}", autocompletion=trained_names),
]
Network: TypeAlias = Annotated[
    str | None, typer.Option(help=f"{_SOURCES}. {_DEFAULT}", autocompletion=trained_names)
]
"""A model that is a network of PyTorch, as an export needs it."""
QualityLevel: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="fast, balanced or best: a network with its weights and settings, in place of --model "
        "and --weights. Default: balanced.",
        callback=one_of(QUALITIES),
    ),
]
Weights: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        help="Weights file of this package, or checkpoint of the authors.", callback=weights_file
    ),
]
NetworkValues: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Set a value of the network's config, such as net.max_disparity=96. Repeat for more.",
        callback=each(lambda option, text: network_values([text]) and None),
    ),
]
Runtime: TypeAlias = Annotated[
    str,
    typer.Option(
        help="Engine: torch, onnxruntime or openvino (`msnet bench` times them on this machine).",
        callback=one_of(ENGINES),
    ),
]
Precision: TypeAlias = Annotated[
    str,
    typer.Option(
        help="fp32, bf16, fp16 (GPU), or auto: bf16 where the processor or GPU has it, else fp32.",
        callback=one_of(PRECISIONS),
    ),
]
Threads: TypeAlias = Annotated[
    int | None,
    typer.Option(
        metavar="<n>",
        min=1,
        max=_MAX_THREADS,
        help="Threads on a CPU. Default: the engine's choice.",
    ),
]
Device: TypeAlias = Annotated[
    str,
    typer.Option(
        help="auto (a GPU if the engine finds one), cpu, cuda, cuda:1, mps; openvino: GPU, NPU.",
        callback=device_name,
    ),
]
Refine: TypeAlias = Annotated[
    bool | None,
    typer.Option(
        "--refine/--no-refine",
        help="Image-guided refinement of occlusions, edges and fractions of a pixel. Default: with "
        "this package's weights, not with the authors'.",
        show_default=False,
    ),
]


MaxDisparity: TypeAlias = Annotated[
    int | None,
    typer.Option(
        metavar="<px>",
        min=16,
        help="Search disparities below this, in px: of 3D networks (a multiple of 32) and sgbm (of "
        "16). Smaller ones take less time, larger ones see nearer things. Default: the model's.",
    ),
]


Scale: TypeAlias = Annotated[
    float | None,
    typer.Option(
        metavar="<part>",
        min=0.25,
        max=1,
        help="Match at this part of height and width; results keep the size of the views. It is "
        "faster and reaches nearer things. Default: the quality's.",
        show_default=False,
    ),
]
Shift: TypeAlias = Annotated[
    int,
    typer.Option(
        metavar="<px>",
        help="Disparity from which the search begins, in px: above 0 for near things alone, below "
        "0 for cameras that converge.",
    ),
]


def cpu_threads(asked: int | None, device: str) -> int | None:
    """Threads on a CPU: those that are asked for, or fewer than all if the machine is busy.

    Args:
        asked: What the user says.
        device: The device as the user says it.
    """
    from mobilestereonet.engines.devices import AUTO, torch_device

    if asked is not None or (device if device != AUTO else torch_device(AUTO).type) != "cpu":
        return asked
    return busy_threads()


@cache
def busy_threads() -> int | None:
    """Threads that fit a busy machine, measured and told once in a process; None if all do."""
    import torch

    from mobilestereonet.engines.threads import fitting_threads

    fitting, most = fitting_threads(), torch.get_num_threads()
    if fitting == most:
        return None
    print(
        f"msnet: machine busy, using {fitting} thread{'s' * (fitting > 1)} (--threads {most} "
        "uses all)",
        file=sys.stderr,
    )
    return fitting


@dataclass(frozen=True)
class NetworkOptions:
    """Options that choose a network, its weights and values of its config.

    Raises:
        FileNotFoundError: If a file that they name is not there.
        InputError: If there is no such network, or a value is none of a network.
    """

    model: Model = None
    weights: Weights = None
    settings: NetworkValues = None

    def __post_init__(self) -> None:
        check_trained(self.model, self.weights)
        if not self.is_standalone:
            check_network_values(self.model, network_values(self.settings))
        if self.is_standalone and self.weights is not None:
            raise InputError(
                f"{self.model} has no weights to read from {self.weights}: leave them out"
            )

    @property
    def is_standalone(self) -> bool:
        """Whether the model is an engine by itself: "sgbm" or "onnx:FILE"."""
        return self.model is not None and (self.model == "sgbm" or self.model.startswith("onnx:"))

    @property
    def config(self) -> dict[str, Any]:
        """Values of the network's config in place of the weights' own."""
        return network_values(self.settings)

    @property
    def is_default(self) -> bool:
        """Whether neither a model nor weights are asked for."""
        return self.model is None and self.weights is None

    @property
    def source(self) -> str | Path:
        """What `load_model` takes: by default `DEFAULT_MODEL`."""
        from mobilestereonet.inference import DEFAULT_MODEL

        return self.weights or self.model or DEFAULT_MODEL

    @property
    def is_embedded(self) -> bool:
        """Whether the weights are those that come with the package."""
        from mobilestereonet.weights import is_embedded

        return self.weights is None and is_embedded(str(self.source))

    def open_network(self) -> tuple[str, StereoModel]:
        """The network with its weights, and its name.

        Raises:
            FileNotFoundError: If there are no such weights.
            InputError: If the file is corrupted, or holds another network than ``model``.
        """
        from mobilestereonet.nets import model_name
        from mobilestereonet.weights import load_model

        model = self.model if self.weights else None
        net = load_model(self.source, model=model, config=self.config)
        if self.weights:
            return model or model_name(net.config), net
        return Path(self.source).name, net


@dataclass(frozen=True)
class MatcherOptions(NetworkOptions):
    """Options that choose a network and the engine that runs it."""

    runtime: Runtime = "torch"
    precision: Precision = "auto"
    threads: Threads = None
    device: Device = "auto"
    refine: Refine = None
    quality: QualityLevel = None
    max_disparity: MaxDisparity = None
    scale: Scale = None
    shift: Shift = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.quality is not None and (self.model or self.weights):
            other = f"--model {self.model}" if self.model else f"--weights {self.weights}"
            raise InputError(
                f"--quality {self.quality} chooses a network and its weights, and so does {other}: "
                "leave one of them out"
            )
        if not self.is_standalone:
            return
        given: dict[str, Any] = {"runtime": self.runtime, "precision": self.precision}
        if self.model == "sgbm":
            given |= {"threads": self.threads, "device": self.device}
        defaults = ("auto", "torch", "fp32", None)  # of one command or the other
        if chosen := [f"--{name}" for name, value in given.items() if value not in defaults]:
            library = "OpenCV" if self.model == "sgbm" else "ONNX Runtime"
            warnings.warn(
                f"{self.model} runs in {library} alone: {', '.join(chosen)} has no effect",
                stacklevel=2,
            )

    @property
    def config(self) -> dict[str, Any]:
        """Values of the network's config, the range of disparities among them."""
        values = super().config
        return (
            values if self.max_disparity is None else values | {"max_disparity": self.max_disparity}
        )

    def open_matcher(self, **options: Any) -> StereoMatcher:
        """The matcher that these options ask for.

        Args:
            **options: Other arguments of `StereoMatcher.from_pretrained`.

        Raises:
            FileNotFoundError: If there is no such weights file.
            InputError: If a value is bad, or the model has no such option.
        """
        from mobilestereonet.inference import StereoMatcher

        options = {"scale": self.scale, "shift": self.shift} | options
        threads = self.threads if self.model == "sgbm" else cpu_threads(self.threads, self.device)
        if not self.is_standalone:
            options |= {"engine": self.runtime, "precision": self.precision}
            options["model"] = self.model if self.weights else None
        return StereoMatcher.from_pretrained(
            None if self.is_default else self.source,
            quality=self.quality,
            threads=threads,
            device=self.device,
            refine=self.refine,
            config=self.config,
            **options,
        )
