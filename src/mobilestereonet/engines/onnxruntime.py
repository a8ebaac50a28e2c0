"""ONNX Runtime as an inference engine, and the conversion to ONNX."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import torch
from numpy.typing import NDArray

from mobilestereonet.engines.converted import ConvertedEngine, Run
from mobilestereonet.engines.devices import AUTO
from mobilestereonet.engines.tracing import Size, example_pair
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.accelerate.export import ExportableNet

# Read when the library is loaded: it reports to its makers unless told not to.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

_OPSET = 20
_CPU = "CPUExecutionProvider"
_GPU = {"cuda": "CUDAExecutionProvider", "tensorrt": "TensorrtExecutionProvider"}


def to_onnx(network: ExportableNet, size: Size | None = None) -> Any:
    """Convert a network to ONNX in memory.

    Args:
        network: The network, in eval mode.
        size: Height and width that the graph takes; None for a graph of any size, which the
            network must have.

    Returns:
        An ``onnx.ModelProto`` with inputs ``left`` and ``right`` and the network's ``outputs``.
    """
    with _silent("torch.onnx"):
        program = torch.onnx.export(
            network,
            example_pair(network, size),
            dynamo=True,
            verbose=False,
            input_names=["left", "right"],
            output_names=list(network.outputs),
            opset_version=_OPSET,
        )
    model = cast(Any, program).model_proto
    if size is None:
        # The graph serves any size, though it was traced at one: only its description says
        # otherwise.
        del model.graph.value_info[:]
        for value in (*model.graph.input, *model.graph.output):
            sizes = value.type.tensor_type.shape.dim[-2:]
            for dimension, name in zip(sizes, ("height", "width"), strict=True):
                dimension.dim_param = name
    return model


@contextmanager
def _silent(logger: str) -> Iterator[None]:
    """Errors of a logger only, for a while.

    PyTorch warns that torchvision, whose operators the networks do without, is not installed.
    """
    found = logging.getLogger(logger)
    before = found.level
    found.setLevel(logging.ERROR)
    try:
        yield
    finally:
        found.setLevel(before)


def find_provider(device: str | torch.device) -> tuple[str, torch.device]:
    """ONNX Runtime's provider for a device, and PyTorch's device for results from there.

    Args:
        device: "cpu", "cuda", "cuda:1" ..., "tensorrt", "tensorrt:1" ... for the same GPUs through
            TensorRT, or "auto": a CUDA GPU if the installed ONNX Runtime has a provider for it,
            else the CPU.

    Raises:
        InputError: If there is no provider for it.
    """
    import onnxruntime

    providers = onnxruntime.get_available_providers()
    name = str(device)
    if name == AUTO:
        name = "cuda" if _GPU["cuda"] in providers and torch.cuda.is_available() else "cpu"
    kind, _, index = name.partition(":")
    if kind == "cpu":
        return "cpu", torch.device("cpu")
    if kind in _GPU and (index or "0").isdigit() and _GPU[kind] in providers:
        number = index or "0"
        results = torch.device(f"cuda:{number}" if torch.cuda.is_available() else "cpu")
        return f"{kind}:{number}", results
    raise InputError(
        f"onnxruntime has no device {name!r} here: its providers are {', '.join(providers)} (a "
        "GPU takes cuda or tensorrt, and the package onnxruntime-gpu)"
    )


def open_session(model: bytes | Path, target: str, threads: int | None) -> Any:
    """An ``onnxruntime.InferenceSession`` on one of `find_provider`'s devices."""
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # it warns of operators that it does not fold
    options.intra_op_num_threads = threads or 0
    kind, _, number = target.partition(":")
    # TensorRT leaves to CUDA what it does not take.
    names = {"cpu": [], "cuda": ["cuda"], "tensorrt": ["tensorrt", "cuda"]}[kind]
    providers: list[Any] = [(_GPU[name], {"device_id": int(number)}) for name in names]
    content = model if isinstance(model, bytes) else str(model)
    session = onnxruntime.InferenceSession(content, options, [*providers, _CPU])
    if kind in _GPU and _GPU[kind] not in session.get_providers():
        raise InputError(
            f"onnxruntime could not start on {target}: its libraries of {kind} do not load here; "
            "use device cpu, or engine torch"
        )
    return session


class OnnxRuntimeEngine(ConvertedEngine):
    """Runs a network in ONNX Runtime, on a device that `find_provider` knows."""

    name = "onnxruntime"
    extra = "onnx"
    packages = ("onnxruntime", "onnx", "onnxscript")

    @classmethod
    def find_device(cls, device: str | torch.device) -> tuple[str, torch.device]:
        """See `find_provider`."""
        return find_provider(device)

    @classmethod
    def precisions(cls, target: str) -> tuple[str, ...]:
        """Float32 alone."""
        return ("fp32",)

    def _convert(self, network: ExportableNet, size: Size | None) -> bytes:
        model: bytes = to_onnx(network, size).SerializeToString()
        return model

    def _load(self, model: bytes) -> Run:
        session = open_session(model, self.target, self.threads)

        def run(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
            return cast(NDArray[Any], session.run(None, {"left": left, "right": right})[0])

        return run
