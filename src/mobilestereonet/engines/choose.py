"""Inference engines by their names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from mobilestereonet.engines.base import Engine
from mobilestereonet.engines.converted import ConvertedEngine
from mobilestereonet.engines.devices import AUTO, torch_device
from mobilestereonet.engines.network import NetworkEngine
from mobilestereonet.engines.onnx_file import OnnxFileEngine
from mobilestereonet.engines.onnxruntime import OnnxRuntimeEngine
from mobilestereonet.engines.openvino import OpenVinoEngine
from mobilestereonet.engines.sgbm import StereoSGBM
from mobilestereonet.engines.torch import TorchEngine, has_bfloat16
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import StereoModel
from mobilestereonet.nets.volume_model import VolumeModel
from mobilestereonet.settings import check_arguments

CONVERTED: dict[str, type[ConvertedEngine]] = {
    engine.name: engine for engine in (OnnxRuntimeEngine, OpenVinoEngine)
}
"""Engines that convert a network first, by their names."""

ENGINES = (TorchEngine.name, *CONVERTED)
"""Names that `open_engine` takes."""


def open_engine(
    name: str,
    net: StereoModel,
    *,
    precision: str = "fp32",
    threads: int | None = None,
    device: str | torch.device = "cpu",
    cache: str | Path | None = None,
) -> NetworkEngine:
    """Make a network ready in an engine.

    Args:
        name: One of `ENGINES`.
        net: The network, in any mode and on any device; it stays as it is.
        precision: "fp32"; "bf16" or "fp16" where the engine has them on the device; or "auto": bf16
            where the engine has it, and the processor or GPU instructions for it, else fp32; and
            fp32 for networks that regress the disparity themselves, in the network's precision.
        threads: Threads on a CPU; None leaves them to the engine.
        device: A device of PyTorch such as "cpu", "cuda:0" or "mps"; for ONNX Runtime "cpu" or
            "cuda:0", for OpenVINO "cpu", "GPU" or "NPU". "auto" is a GPU if the engine finds one
            (OpenVINO: the CPU).
        cache: Folder for conversions, see `ConvertedEngine`.

    Raises:
        InputError: If a name or value is unknown, the engine is not installed, or it does not
            have the precision or the device.
    """
    if name not in ENGINES:
        raise InputError(f"unknown engine {name!r}: there are {', '.join(ENGINES)}")
    if precision == AUTO and not isinstance(net, VolumeModel):
        precision = "fp32"
    if name == TorchEngine.name:
        found = torch_device(device)
        if precision == AUTO:
            precision = "bf16" if has_bfloat16(found) else "fp32"
        return TorchEngine(net, device=found, precision=precision, threads=threads)
    engine = CONVERTED[name]
    if precision == AUTO:
        precision = _best_precision(engine, device)
    return engine(net, precision=precision, threads=threads, device=device, cache=cache)


def open_standalone(
    model: str,
    *,
    threads: int | None = None,
    device: str | torch.device = "cpu",
    options: Mapping[str, Any] | None = None,
) -> Engine | None:
    """Open a model that is an engine by itself, without a network of this package.

    Args:
        model: "sgbm", for OpenCV's semi-global matching, or "onnx:FILE" (see `OnnxFileEngine`).
        threads: Threads on a CPU; None leaves them to the engine. OpenCV has its own.
        device: For an ONNX file, see `OnnxFileEngine`.
        options: For "sgbm", those of `StereoSGBM`.

    Returns:
        None if ``model`` is no such name.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file or a value is refused.
    """
    if model == StereoSGBM.name:
        return StereoSGBM(**check_arguments(StereoSGBM.__init__, options or {}, model))
    if model.startswith(OnnxFileEngine.prefix):
        if options:
            given = ", ".join(options)
            raise InputError(f"{model} has its options in its name, not as {given}: leave that out")
        return OnnxFileEngine(model, threads=threads, device=device)
    return None


def installed_engines(device: str | torch.device) -> list[tuple[str, str]]:
    """Names and precisions of the engines that are installed and have a device.

    On a CPU without instructions for bfloat16, PyTorch in bf16 is left out: it is slower.
    """
    engines = []
    try:
        found = torch_device(device)
        engines = [
            (TorchEngine.name, precision)
            for precision in TorchEngine.precisions(found)
            if precision != "bf16" or has_bfloat16(found)
        ]
    except InputError:  # a device of another engine, such as OpenVINO's NPU
        pass
    for name, engine in CONVERTED.items():
        if engine.installed():
            try:
                target, _ = engine.find_device(device)
            except InputError:
                continue
            engines += [(name, precision) for precision in engine.precisions(target)]
    return engines


def _best_precision(engine: type[ConvertedEngine], device: str | torch.device) -> str:
    if not engine.installed():
        return "fp32"  # the engine itself says what is missing
    has_it = "bf16" in engine.precisions(engine.find_device(device)[0])
    return "bf16" if has_it and has_bfloat16(torch.device("cpu")) else "fp32"
