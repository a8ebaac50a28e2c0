"""How fast each engine runs a network on this machine."""

from __future__ import annotations

import copy
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from mobilestereonet.engines.choose import CONVERTED, open_runtime
from mobilestereonet.engines.scores import use_threads
from mobilestereonet.engines.torch import has_bfloat16
from mobilestereonet.nets import StereoModel

_EAGER = "eager"
_WRONG = 0.5
"""Mean difference in px that no precision explains."""


@dataclass(frozen=True)
class EngineTime:
    """One engine in one precision.

    Attributes:
        engine: Its name; "eager" is the network itself, as PyTorch runs it unaccelerated.
        precision: What it computes in.
        seconds: Median time of a pair.
        ratio: How many times faster it is than "eager" in fp32.
        difference: Mean difference of its disparity to that of "eager", in px.
    """

    engine: str
    precision: str
    seconds: float
    ratio: float
    difference: float


def installed_engines(device: str) -> list[tuple[str, str]]:
    """Engines and precisions that can be had on a device."""
    if torch.device(device).type != "cpu":
        return [("torch", precision) for precision in ("fp32", "bf16", "fp16")]
    engines = [("torch", "fp32")] + [("torch", "bf16")] * has_bfloat16()
    for engine in CONVERTED.values():
        if engine.installed():
            engines += [(engine.name, precision) for precision in engine.precisions]
    return engines


def compare_engines(
    net: StereoModel,
    left: Tensor,
    right: Tensor,
    engines: Sequence[tuple[str, str]],
    *,
    device: str = "cpu",
    threads: int | None = None,
    repeats: int = 5,
    opening: Callable[[str, str], object] | None = None,
) -> list[EngineTime]:
    """Time engines in turns, so that whatever else the machine does meets all of them.

    Args:
        net: The network, in eval mode.
        left: Left view (1, 3, H, W), normalised; H and W are multiples of 16.
        right: Right view, likewise.
        engines: Names and precisions, as `open_runtime` takes them.
        device: Where PyTorch runs, see `open_runtime`.
        threads: Threads on a CPU; None leaves it to each engine.
        repeats: Timed runs of each; one before them is not timed.
        opening: Is told each engine's name and precision before that one is made ready, which may
            be a conversion of minutes.

    Returns:
        "eager" in fp32, then the engines in their order.
    """
    left, right = left.to(device), right.to(device)
    runs: list[Callable[[], Tensor]] = [_eager(net, left, right, threads)]
    for name, precision in engines:
        if opening is not None:
            opening(name, precision)
        engine = open_runtime(name, net, precision=precision, device=device, threads=threads)
        runs.append(lambda engine=engine: engine(left, right).cpu())  # type: ignore[misc]
    disparities = [run() for run in runs]
    medians = times_in_turns(*runs, repeats=repeats)
    return [
        EngineTime(*name, median, medians[0] / median, float((found - disparities[0]).abs().mean()))
        for name, median, found in zip(
            [(_EAGER, "fp32"), *engines], medians, disparities, strict=True
        )
    ]


def fastest(times: Sequence[EngineTime]) -> dict[str, str]:
    """The fastest engine of each precision, without the unaccelerated one and wrong ones."""
    right = [row for row in times if row.engine != _EAGER and row.difference < _WRONG]
    return {row.precision: row.engine for row in sorted(right, key=lambda row: -row.seconds)}


def times_in_turns(*functions: Callable[[], object], repeats: int) -> list[float]:
    """Median seconds of each function, all run in turns."""
    seconds: list[list[float]] = [[] for _ in functions]
    for _ in range(repeats):
        for times, function in zip(seconds, functions, strict=True):
            started = time.perf_counter()
            function()
            times.append(time.perf_counter() - started)
    return [statistics.median(times) for times in seconds]


def _eager(
    net: StereoModel, left: Tensor, right: Tensor, threads: int | None
) -> Callable[[], Tensor]:
    net = copy.deepcopy(net).to(left.device)

    def run() -> Tensor:
        with torch.inference_mode(), use_threads(threads):
            disparity: Tensor = net(left, right).disparity
        return disparity.cpu()

    return run
