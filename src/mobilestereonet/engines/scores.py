"""What the engines of our networks share: disparity and confidence from the scores."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

from mobilestereonet.accelerate.soft_argmax import ClosedFormSoftArgmax
from mobilestereonet.errors import InputError
from mobilestereonet.nets import VolumeModel


class ScoresRuntime(ABC):
    """An engine that gives a network's scores; PyTorch computes the soft-argmax, in float32.

    Args:
        net: The network.
        precision: What the engine computes in.
        threads: Threads on a CPU; None leaves it to the engine.

    Raises:
        InputError: If ``threads`` is below 1.
    """

    normalised = True

    def __init__(self, net: VolumeModel, precision: str, threads: int | None) -> None:
        if threads is not None and threads < 1:
            raise InputError(f"threads must be at least 1, got {threads}")
        self.precision = precision
        self.threads = threads
        self.max_disparity = net.max_disparity
        self.multiple = net.size_multiple
        self._regression = ClosedFormSoftArgmax(net.regression)

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
            maps = [self._regression(part) for part in self._scores(left, right)]
            return torch.cat(maps).to(left.device)

    def with_confidence(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Match the views, and tell how sure the network is.

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
            maps = [
                torch.stack([self._regression(part), self._regression.confidence(part)])
                for part in self._scores(left, right)
            ]
            disparity, confidence = torch.cat(maps, dim=1).to(left.device)
            return disparity, confidence

    def scores(self, left: Tensor, right: Tensor) -> Tensor:
        """The network's scores, see `VolumeModel.scores`.

        Args:
            left: Left views, (B, 3, H, W), normalised, H and W multiples of 16.
            right: Right views, the same.

        Returns:
            (B, D, H / 4, W / 4) in the engine's precision, on its device.

        Raises:
            InputError: If the shapes do not fit.
        """
        with torch.inference_mode(), use_threads(self.threads):
            return torch.cat(list(self._scores(left, right)))

    @abstractmethod
    def _scores(self, left: Tensor, right: Tensor) -> Iterable[Tensor]:
        """Scores (b, D, H / 4, W / 4) of the pairs in their order, b at a time."""


@contextmanager
def use_threads(count: int | None) -> Iterator[None]:
    """PyTorch on so many threads for a while; None leaves its setting."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)
