"""PyTorch itself as an engine."""

from __future__ import annotations

import copy
import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import cast

import torch
from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.nets import SIZE_MULTIPLE, StereoNet
from mobilestereonet.nets.confidence import match_confidence
from mobilestereonet.nets.disparity import regress_disparity
from mobilestereonet.runtimes.optimise import fold_norms, optimise, weights_channels_last

_PRECISIONS = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}


class TorchRuntime:
    """Runs a network in eval mode, channels last, without gradients.

    The network is copied, so the caller's keeps its mode, device and memory format. On a CPU the
    copy is accelerated by `optimise`. On a GPU only its batch norms are folded: PyTorch's own
    layers run it.
    """

    name = "torch"
    normalised = True
    multiple = SIZE_MULTIPLE

    def __init__(
        self,
        net: StereoNet,
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
        if threads is not None and threads < 1:
            raise InputError(f"threads must be at least 1, got {threads}")
        self.threads = threads
        self.precision = precision
        self.max_disparity = net.config.max_disparity
        self.dtype = _PRECISIONS[precision]
        if on_cpu:
            _keep_freed_memory()
            self.net = optimise(net)
        else:
            self.net = copy.deepcopy(net).eval().requires_grad_(False)
            fold_norms(self.net)
            weights_channels_last(self.net)
        self.net.to(self.device, self.dtype)

    def __call__(self, left: Tensor, right: Tensor) -> Tensor:
        """Match the views.

        Args:
            left: Left views, (B, 3, H, W), normalised, H and W multiples of 16.
            right: Right views, the same.

        Returns:
            Disparity of the left views in px, (B, H, W) float32, on the device of ``left``.

        Raises:
            InputError: If the shapes do not fit.
        """
        with torch.inference_mode(), use_threads(self.threads):
            return cast(Tensor, self.net(*self._views(left, right))).to(left.device)

    def with_confidence(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Match the views and tell how sure the network is.

        Args:
            left: Left views, (B, 3, H, W), normalised, H and W multiples of 16.
            right: Right views, the same.

        Returns:
            Disparity of the left views in px, and its confidence in 0..1, both (B, H, W) float32
            on the device of ``left``.

        Raises:
            InputError: If the shapes do not fit.
        """
        with torch.inference_mode(), use_threads(self.threads):
            scores = self.net.scores(*self._views(left, right))[-1]
            estimator = self.net.config.estimator
            maps = regress_disparity(scores, estimator), match_confidence(scores, estimator)
            return maps[0].to(left.device), maps[1].to(left.device)

    def _views(self, left: Tensor, right: Tensor) -> list[Tensor]:
        return [
            view.to(self.device, self.dtype, memory_format=torch.channels_last)
            for view in (left, right)
        ]


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


@contextmanager
def use_threads(count: int | None) -> Iterator[None]:
    """PyTorch on so many threads for a while; None leaves its setting."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)
