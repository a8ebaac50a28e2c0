"""PyTorch as an inference engine."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import torch
from torch import Tensor

from mobilestereonet.accelerate import accelerate
from mobilestereonet.engines.devices import torch_device
from mobilestereonet.engines.network import NetworkEngine, regress
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import Prediction, StereoModel
from mobilestereonet.nets.volume_model import VolumeModel

_DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}


class TorchEngine(NetworkEngine):
    """Runs an accelerated copy of a network in PyTorch, without gradients.

    Args:
        net: The network, in any mode and on any device; it stays as it is.
        device: Where the copy runs: a device of PyTorch, or "auto" (see `torch_device`).
        precision: Number format of weights and features: "fp32", "bf16" or, not on a CPU, "fp16".
            Disparities are regressed from scores in float32 always.
        threads: Threads on a CPU; None leaves PyTorch's setting.

    Raises:
        InputError: If a value is none of these.
    """

    name = "torch"

    def __init__(
        self,
        net: StereoModel,
        *,
        device: torch.device | str = "cpu",
        precision: str = "fp32",
        threads: int | None = None,
    ) -> None:
        super().__init__(net, precision, threads, torch_device(device))
        choices = self.precisions(self.device)
        if precision not in choices:
            raise InputError(
                f"precision must be one of {', '.join(choices)} on {self.device.type}, "
                f"got {precision!r}"
            )
        self.dtype = _DTYPES[precision]
        # Weights are rewritten for the device on which they are; the caller's stay where they are.
        if next(net.parameters(), torch.empty(0)).device != self.device:
            net = copy.deepcopy(net).to(self.device)
        self.net = accelerate(net, "inference").to(self.dtype)

    @staticmethod
    def precisions(device: torch.device) -> list[str]:
        """Number formats that PyTorch computes in on a device."""
        return [name for name in _DTYPES if not (device.type == "cpu" and name == "fp16")]

    def _predict(self, left: Tensor, right: Tensor, confidence: bool) -> Iterator[Prediction]:
        if isinstance(self.net, VolumeModel):
            for scores in self._scores(left, right):
                yield regress(self.net, scores, confidence)
        else:
            yield self.net(*self._views(left, right))

    def _scores(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        assert isinstance(self.net, VolumeModel)
        yield self.net.scores(*self._views(left, right))

    def _views(self, left: Tensor, right: Tensor) -> list[Tensor]:
        return [
            view.to(self.device, self.dtype, memory_format=torch.channels_last)
            for view in (left, right)
        ]


def has_bfloat16(device: torch.device) -> bool:
    """Whether a processor or GPU computes in bfloat16 by instructions of its own.

    Without them the precision "bf16" is allowed on a CPU, but slower than "fp32".
    """
    if device.type == "cpu":
        capabilities = torch.cpu.get_capabilities()
        return any(present is True for name, present in capabilities.items() if "bf16" in name)
    if device.type == "cuda":
        with torch.cuda.device(device):
            return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    return False
