"""The one thing that every engine can do."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from torch import Tensor


@runtime_checkable
class Runtime(Protocol):
    """Turns a prepared pair into a disparity map.

    What "prepared" means is said by two attributes, so that whoever feeds an engine needs no
    list of engines: `mobilestereonet.inference` normalises and pads exactly as they say.
    """

    @property
    def name(self) -> str:
        """What the command line calls the engine, such as ``sgbm``."""
        ...

    @property
    def precision(self) -> str:
        """What it computes in, such as ``fp32``."""
        ...

    @property
    def normalised(self) -> bool:
        """True: takes views with ImageNet's mean and standard deviation; False: RGB in 0..1."""
        ...

    @property
    def multiple(self) -> int:
        """Height and width must be multiples of this; 1 takes any size."""
        ...

    @property
    def max_disparity(self) -> int:
        """Disparities below this are searched, in px."""
        ...

    def __call__(self, left: Tensor, right: Tensor) -> Tensor:
        """Match the views.

        Args:
            left: Left views, (B, 3, H, W) float, prepared as the attributes say.
            right: Right views, the same.

        Returns:
            Disparity of the left views in px, (B, H, W) float32, on the device of ``left``.
        """
        ...


@runtime_checkable
class ConfidentRuntime(Runtime, Protocol):
    """An engine that tells how sure it is as well."""

    def with_confidence(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Match the views.

        Args:
            left: Left views, (B, 3, H, W) float, prepared as the attributes say.
            right: Right views, the same.

        Returns:
            Disparity of the left views in px, and its confidence in 0..1 (see
            `mobilestereonet.nets.confidence`), both (B, H, W) float32 on the device of ``left``.
        """
        ...
