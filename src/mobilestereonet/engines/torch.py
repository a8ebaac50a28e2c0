"""PyTorch itself as an engine."""

from __future__ import annotations

import copy
import ctypes
import sys
from collections.abc import Iterator
from typing import cast

import torch
from torch import Tensor

from mobilestereonet.accelerate.inference import inference_form
from mobilestereonet.engines.scores import ScoresRuntime
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel, VolumeModel

_PRECISIONS = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}


class TorchRuntime(ScoresRuntime):
    """Runs a network in eval mode, channels last, without gradients.

    The network is copied, so the caller's keeps its mode, device and memory format. On a CPU the
    copy is accelerated by `inference_form`. On a GPU only its batch norms are folded: PyTorch's own
    layers run it.
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
        """Copy the network.

        Args:
            net: The network, in any mode.
            device: Where it runs, such as ``cuda``.
            precision: Type of weights and features: "fp32", "bf16" or, not on a CPU, "fp16". The
                soft-argmax is computed in float32 always. See `has_bfloat16`.
            threads: Threads on a CPU; None leaves PyTorch's setting.

        Raises:
            InputError: If ``precision`` is none of these, or ``threads`` is below 1.
        """
        self.device = torch.device(device)
        on_cpu = self.device.type == "cpu"
        choices = [name for name in _PRECISIONS if not (on_cpu and name == "fp16")]
        if precision not in choices:
            raise InputError(
                f"precision must be one of {', '.join(choices)} on {self.device.type}, "
                f"got {precision!r}"
            )
        super().__init__(cast(VolumeModel, net), precision, threads)
        self.dtype = _PRECISIONS[precision]
        if on_cpu:
            _keep_freed_memory()
        self.net = inference_form(copy.deepcopy(net).to(self.device))
        self.net.to(self.dtype)

    def _scores(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        """The scores of all pairs at once."""
        views = [
            view.to(self.device, self.dtype, memory_format=torch.channels_last)
            for view in (left, right)
        ]
        yield cast(VolumeModel, self.net).scores(*views)


def has_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 by instructions of its own.

    Without them ``precision="bf16"`` is allowed, but slower than "fp32".
    """
    capabilities = torch.cpu.get_capabilities()
    return any(present is True for name, present in capabilities.items() if "bf16" in name)


_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4


def _keep_freed_memory() -> None:
    """Let the C library keep freed memory for the next tensor; this holds for the whole process.

    By default glibc gives large blocks back to the operating system at once. The next layer's
    tensor then comes page by page, which can take longer than its convolution does.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:  # musl has none
        mallopt(_M_TRIM_THRESHOLD, -1)
        mallopt(_M_MMAP_MAX, 0)
