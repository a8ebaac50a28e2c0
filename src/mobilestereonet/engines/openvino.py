"""OpenVINO as an inference engine, and the conversion to its form."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from threading import Lock
from typing import TYPE_CHECKING, Any

import torch
from numpy.typing import NDArray

from mobilestereonet.engines.converted import ConvertedEngine, Run
from mobilestereonet.engines.devices import AUTO
from mobilestereonet.engines.tracing import Size, example_pair
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.accelerate.export import ExportableNet

_PRECISIONS = {"fp32": "f32", "bf16": "bf16", "fp16": "f16"}


def openvino_core() -> Any:
    """The one ``openvino.Core`` of this process.

    OpenVINO's CPU device gives the thread that loads it a signal stack and puts the former one back
    when its core is deleted. Two cores that are not deleted in the reverse order leave a stack that
    is no longer mapped, and the next signal with a Python handler (Ctrl-C) kills the process.
    """
    with _ONE_CORE:
        return _core()


@cache
def _core() -> Any:
    import openvino

    return openvino.Core()


_ONE_CORE = Lock()


def to_openvino(network: ExportableNet, size: Size | None = None) -> Any:
    """Convert a network to OpenVINO's form in memory.

    Args:
        network: The network, in eval mode.
        size: Height and width that the graph takes; None for a graph of any size, which the
            network must have.

    Returns:
        An ``openvino.Model`` with inputs ``left`` and ``right`` and the network's ``outputs``.
    """
    import openvino

    shape = [1, 3, *((-1, -1) if size is None else size)]
    with without_telemetry():
        model = openvino.convert_model(
            network,
            example_input=example_pair(network, size),
            input=[("left", shape), ("right", shape)],
        )
    for output, name in zip(model.outputs, network.outputs, strict=True):
        output.tensor.set_names({name})
    return model


@contextmanager
def without_telemetry() -> Iterator[None]:
    """Nothing is sent to OpenVINO's makers for a while: its converter does unless told not to."""
    try:
        module = import_module("openvino_telemetry")
        from openvino.tools.ovc.telemetry_stub import Telemetry
    except ImportError:  # then it sends nothing
        yield
        return
    before = module.Telemetry
    module.Telemetry = Telemetry  # type: ignore[attr-defined]
    try:
        yield
    finally:
        module.Telemetry = before  # type: ignore[attr-defined]


class OpenVinoEngine(ConvertedEngine):
    """Runs a network in OpenVINO, on the CPU, or on the "GPU" or "NPU" that it finds."""

    name = "openvino"
    extra = "openvino"
    packages = ("openvino",)

    @classmethod
    def find_device(cls, device: str | torch.device) -> tuple[str, torch.device]:
        """OpenVINO's name of a device; its results come through the CPU's memory.

        Args:
            device: "cpu", "GPU", "GPU.1", "NPU", in capitals or not; "auto" is the CPU.

        Raises:
            InputError: If OpenVINO does not have it here.
        """
        name = str(device).upper()
        devices = openvino_core().available_devices
        target = "CPU" if name == AUTO.upper() else name
        if target not in devices and f"{target}.0" not in devices:
            raise InputError(
                f"openvino has no device {str(device)!r} here, only {', '.join(devices)}"
            )
        return target, torch.device("cpu")

    @classmethod
    def precisions(cls, target: str) -> tuple[str, ...]:
        """Float32, and the reduced precision of the device."""
        return ("fp32", "bf16") if target == "CPU" else ("fp32", "fp16")

    @property
    def _takes_any_size(self) -> bool:
        return not self.target.startswith("NPU")

    def _machine(self) -> object:
        facts = ("FULL_DEVICE_NAME", "OPTIMIZATION_CAPABILITIES")
        return [openvino_core().get_property(self.target, fact) for fact in facts]

    def _options(self) -> dict[str, Any]:
        # Left to itself OpenVINO computes in reduced precision wherever the device can.
        options: dict[str, Any] = {
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_PRECISION_HINT": _PRECISIONS[self.precision],
        }
        if self.threads is not None and self.target == "CPU":
            options["INFERENCE_NUM_THREADS"] = self.threads
        return options

    def _convert(self, network: ExportableNet, size: Size | None) -> bytes:
        model = to_openvino(network, size)
        compiled = openvino_core().compile_model(model, self.target, self._options())
        blob: bytes = compiled.export_model().getvalue()
        return blob

    def _load(self, model: bytes) -> Run:
        compiled = openvino_core().import_model(model, self.target, self._options())

        def run(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
            # A request of its own for each call: threads cannot share one.
            result: NDArray[Any] = compiled.create_infer_request().infer([left, right])[0]
            return result

        return run
