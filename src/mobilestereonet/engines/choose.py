"""Which engine runs a network."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch

from mobilestereonet.atomic import write_atomically
from mobilestereonet.engines.base import ConfidentRuntime
from mobilestereonet.engines.converted import ConvertedRuntime, user_cache
from mobilestereonet.engines.onnxruntime import ONNXRuntime
from mobilestereonet.engines.openvino import OpenVINORuntime
from mobilestereonet.engines.torch import TorchRuntime, has_bfloat16
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel

AUTO = "auto"

CONVERTED: dict[str, type[ConvertedRuntime]] = {
    runtime.name: runtime for runtime in (ONNXRuntime, OpenVINORuntime)
}
"""The engines that convert a network first, by their names."""

RUNTIMES = (AUTO, TorchRuntime.name, *CONVERTED)
"""Names that `open_runtime` takes."""


def open_runtime(
    name: str,
    net: StereoModel,
    *,
    precision: str = AUTO,
    threads: int | None = None,
    device: str = AUTO,
    cache: str | Path | None = None,
) -> ConfidentRuntime:
    """Make a network ready in an engine.

    Args:
        name: One of `RUNTIMES`. "auto" is the fastest engine in the precision, by the last `msnet
            bench` of this network on this machine; before one, and on a GPU, it is PyTorch, which
            needs no conversion.
        net: The network, with any weights.
        precision: "fp32", "bf16" (not in ONNX Runtime), "fp16" (PyTorch on a GPU), or "auto":
            bf16 where the engine has it, and the processor or GPU instructions for it, else fp32.
        threads: Threads on a CPU; None leaves it to the engine.
        device: A device of PyTorch such as "cpu" or "cuda:0", or "auto": a GPU if there is one
            and the engine may be PyTorch. The other engines run on the CPU.
        cache: See `ConvertedRuntime`.

    Raises:
        InputError: If a name or value is unknown, the engine is not installed, or it does not
            have the precision or the device.
    """
    name, precision, device = choose_engine(name, net.config, precision, device)
    if name == TorchRuntime.name:
        return TorchRuntime(net, device=device, precision=precision, threads=threads)
    return CONVERTED[name](net, precision=precision, threads=threads, cache=cache)


def choose_engine(name: str, config: Any, precision: str, device: str) -> tuple[str, str, str]:
    """What "auto" means here for the engine's name, the precision and the device.

    Raises:
        InputError: If the name or the device is unknown, or the engine does not run there.
    """
    if name not in RUNTIMES:
        raise InputError(f"unknown runtime {name!r}: there are {', '.join(RUNTIMES)}")
    device = check_device(name, device)
    best = "bf16" if _has_bfloat16(device) else "fp32"
    if name == AUTO:
        name = TorchRuntime.name
        if device == "cpu":
            name = _fastest(config, best if precision == AUTO else precision)
    if precision == AUTO:
        able = name == TorchRuntime.name or best in CONVERTED[name].precisions
        precision = best if able else "fp32"
    return name, precision, device


_FASTEST = "fastest.json"


def remember_fastest(config: Any, engines: Mapping[str, str]) -> Path | None:
    """Let "auto" take these engines for a network on this machine's CPU from now on.

    They are kept in the user's cache folder; where that cannot be written to, nothing changes.

    Args:
        config: The network's.
        engines: Precisions and, for each, the name of the fastest engine.

    Returns:
        The file that they are kept in; None if it cannot be written.
    """
    text = json.dumps({**_remembered(), str(config): dict(engines)}, indent=2) + "\n"
    path = user_cache() / _FASTEST
    with suppress(OSError):
        write_atomically(path, lambda file: file.write_text(text, "utf-8"))
        return path
    return None


def _fastest(config: Any, precision: str) -> str:
    # What another version wrote there may be anything.
    with suppress(TypeError, KeyError):
        name = _remembered()[str(config)][precision]
        if CONVERTED[name].installed():
            return str(name)
    return TorchRuntime.name


def _remembered() -> dict[str, Any]:
    with suppress(OSError, ValueError):
        found = json.loads((user_cache() / _FASTEST).read_text("utf-8"))
        if isinstance(found, dict):
            return found
    return {}


def check_device(name: str, device: str) -> str:
    """The device of PyTorch that "auto" means, or the one given, for an engine of `RUNTIMES`.

    Raises:
        InputError: If the device is unknown, missing, or none of the engine's.
    """
    if device == AUTO:
        may_be_torch = name in (AUTO, TorchRuntime.name)
        return "cuda" if may_be_torch and torch.cuda.is_available() else "cpu"
    if device != "cpu" and not re.fullmatch(r"cuda(:\d+)?", device):
        raise InputError(f"unknown device {device!r}: cpu, cuda and cuda:0 are such")
    if device != "cpu" and (torch.device(device).index or 0) >= torch.cuda.device_count():
        found = torch.cuda.device_count() or "no"
        raise InputError(f"device {device!r}: PyTorch finds {found} GPU here: use cpu")
    if name in CONVERTED and device != "cpu":
        raise InputError(f"{name} runs on the cpu, not on {device!r}: use runtime torch there")
    return device


def _has_bfloat16(device: str) -> bool:
    if device == "cpu":
        return has_bfloat16()
    with torch.cuda.device(device):
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
