"""PyTorch itself as an engine."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from typing import cast

import torch
from torch import Tensor
from torch.nn.utils import (
    convert_conv2d_weight_memory_format,
    convert_conv3d_weight_memory_format,
)

from mobilestereonet.errors import InputError
from mobilestereonet.nets import SIZE_MULTIPLE, StereoNet


class TorchRuntime:
    """Runs a network in eval mode, channels last, without gradients.

    The network is copied, so the caller's keeps its mode, device and memory format.
    """

    name = "torch"
    normalised = True
    multiple = SIZE_MULTIPLE

    def __init__(
        self, net: StereoNet, *, device: torch.device | str = "cpu", threads: int | None = None
    ) -> None:
        """Copy the network.

        Args:
            net: The network, in any mode.
            device: Where it runs, such as ``cuda``.
            threads: Threads on a CPU; None leaves PyTorch's setting.

        Raises:
            InputError: If ``threads`` is below 1.
        """
        if threads is not None and threads < 1:
            raise InputError(f"threads must be at least 1, got {threads}")
        self.threads = threads
        self.device = torch.device(device)
        self.net = copy.deepcopy(net).eval().requires_grad_(False).to(self.device)
        # Depthwise 3D convolutions are several times faster on a CPU with channels last.
        convert_conv2d_weight_memory_format(self.net, torch.channels_last)
        convert_conv3d_weight_memory_format(self.net, torch.channels_last_3d)

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
        views = [
            view.to(self.device, torch.float32, memory_format=torch.channels_last)
            for view in (left, right)
        ]
        with torch.inference_mode(), _threads(self.threads):
            return cast(Tensor, self.net(*views)).to(left.device)


@contextmanager
def _threads(count: int | None) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)
