"""Speed of the inference engines with one network on this machine."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.engines.base import Engine
from mobilestereonet.engines.choose import open_engine
from mobilestereonet.engines.devices import torch_device
from mobilestereonet.engines.threads import use_threads
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import Prediction, StereoModel
from mobilestereonet.nets.volume_model import VolumeModel
from mobilestereonet.timing import time_interleaved

EAGER = "eager"
"""Name of the network itself, as PyTorch runs it unaccelerated."""

MAX_ROUNDING_PX = 0.5
"""Mean difference to the network's own disparity that no precision explains."""


@dataclass(frozen=True)
class EngineTime:
    """Measured speed of an engine in one precision.

    Attributes:
        engine: Name of the engine.
        precision: Number format of the computation.
        seconds: Median time of a pair.
        ratio: How many times faster it is than the first engine that was measured.
        difference: Mean difference of its disparity to that of the first engine, in pixels.
    """

    engine: str
    precision: str
    seconds: float
    ratio: float
    difference: float


def benchmark_network(
    net: StereoModel,
    left: Tensor,
    right: Tensor,
    engines: Sequence[tuple[str, str]],
    *,
    device: str | torch.device = "cpu",
    threads: int | None = None,
    repeats: int = 5,
    opening: Callable[[str, str], object] | None = None,
    refused: Callable[[str, str, InputError], object] | None = None,
) -> list[EngineTime]:
    """Time a network in several engines, all in turns.

    Args:
        net: The network.
        left: Left view (1, 3, H, W), RGB in 0..1; H and W are multiples of the network's.
        right: Right view, likewise.
        engines: Names and precisions, as `open_engine` takes them.
        device: See `open_engine`.
        threads: Threads on a CPU; None leaves them to each engine.
        repeats: Timed runs of each engine; one before them is not timed.
        opening: Called with each engine's name and precision before it is made ready, which may
            be a conversion of minutes.
        refused: Called with the name and precision of an engine that cannot run the network, and
            why; it is then left out. By default that is an error.

    Returns:
        "eager" in fp32, then the engines in their order.

    Raises:
        InputError: If an engine cannot run the network, without ``refused``.
    """
    opened: list[Engine] = [EagerNetwork(net, device, threads)]
    for name, precision in engines:
        if opening is not None:
            opening(name, precision)
        try:
            engine = open_engine(name, net, precision=precision, device=device, threads=threads)
            _run(engine, left, right)()  # some convert the network when the first views come
        except InputError as error:
            if refused is None:
                raise
            refused(name, precision, error)
        else:
            opened.append(engine)
    return benchmark_engines(opened, left, right, repeats=repeats)


def benchmark_engines(
    engines: Sequence[Engine], left: Tensor, right: Tensor, *, repeats: int = 5
) -> list[EngineTime]:
    """Time engines in turns, and compare their disparities with the first one's.

    Args:
        engines: The engines.
        left: Left view (1, 3, H, W), RGB in 0..1.
        right: Right view, likewise.
        repeats: Timed runs of each engine; one before them is not timed.
    """
    runs = [_run(engine, left, right) for engine in engines]
    disparities = [run() for run in runs]
    medians = time_interleaved(*runs, repeats=repeats)
    return [
        EngineTime(
            engine.name,
            engine.precision,
            seconds,
            medians[0] / seconds,
            float((disparity - disparities[0]).abs().mean()),
        )
        for engine, seconds, disparity in zip(engines, medians, disparities, strict=True)
    ]


def fastest(times: Sequence[EngineTime]) -> dict[str, EngineTime]:
    """The fastest engine of each precision, without the unaccelerated one and wrong ones."""
    able = [row for row in times if row.engine != EAGER and row.difference < MAX_ROUNDING_PX]
    return {row.precision: row for row in sorted(able, key=lambda row: -row.seconds)}


class EagerNetwork:
    """Engine that runs a network as it is written, in float32: the baseline of a benchmark.

    Args:
        net: The network; it is copied.
        device: See `torch_device`; one that PyTorch does not have stands for the CPU.
        threads: Threads on a CPU; None leaves PyTorch's setting.
    """

    name = EAGER
    precision = "fp32"
    has_confidence = False

    def __init__(
        self, net: StereoModel, device: str | torch.device = "cpu", threads: int | None = None
    ) -> None:
        try:
            self.device = torch_device(device)
        except InputError:
            self.device = torch.device("cpu")
        self.threads = threads
        self.net = copy.deepcopy(net).float().eval().to(self.device)
        self._disparity: Callable[[Tensor, Tensor], Tensor] = self._match
        self.preprocessing = net.preprocessing
        self.size_multiple = net.size_multiple
        self.min_side = net.min_side
        self.max_disparity = net.max_disparity

    def __call__(self, left: Tensor, right: Tensor, confidence: bool = False) -> Prediction:
        """Match a batch of pairs, see `Engine`; without confidence."""
        left, right = left.to(self.device), right.to(self.device)
        with torch.inference_mode(), use_threads(self.threads):
            return Prediction(self._disparity(left, right))

    def compile(self, **options: Any) -> None:
        """Let torch.compile rewrite the network at its first run.

        Args:
            **options: Those of `torch.compile`.
        """
        self._disparity = torch.compile(self._match, **options)

    def _match(self, left: Tensor, right: Tensor) -> Tensor:
        if isinstance(self.net, VolumeModel):
            disparity: Tensor = self.net.regression(self.net.scores(left, right))
        else:
            disparity = self.net(left, right).disparity
        return disparity


def _run(engine: Engine, left: Tensor, right: Tensor) -> Callable[[], Tensor]:
    left, right = (engine.preprocessing(view).to(engine.device) for view in (left, right))
    return lambda: engine(left, right).disparity.cpu()
