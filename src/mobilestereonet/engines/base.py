"""Protocol implemented by all inference engines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from mobilestereonet.nets.model import Prediction, Preprocessing


@runtime_checkable
class Engine(Protocol):
    """Matches batches of preprocessed pairs.

    Its attributes say what "preprocessed" means, so that whoever feeds an engine needs no list of
    engines: `mobilestereonet.inference` preprocesses and pads exactly as they say.

    An engine may also have a ``confidence_fit``, the calibration of its confidence: the matcher
    applies it after the refinement, which takes the confidence as it is.
    """

    @property
    def name(self) -> str:
        """Name on the command line, such as ``sgbm``."""
        ...

    @property
    def precision(self) -> str:
        """Number format of the computation, such as ``fp32``."""
        ...

    @property
    def device(self) -> torch.device:
        """PyTorch's device on which results lie; views elsewhere are moved."""
        ...

    @property
    def threads(self) -> int | None:
        """Threads on a CPU; None leaves them to the engine."""
        ...

    @property
    def preprocessing(self) -> Preprocessing:
        """How RGB views in 0..1 become the engine's input."""
        ...

    @property
    def size_multiple(self) -> int:
        """Height and width of the views must be multiples of this; 1 takes any size."""
        ...

    @property
    def min_side(self) -> int:
        """Smallest height and width of the views, in pixels."""
        ...

    @property
    def max_disparity(self) -> int:
        """Disparities 0 .. max_disparity - 1 are searched, in pixels."""
        ...

    @property
    def has_confidence(self) -> bool:
        """Whether predictions have a confidence when it is asked for."""
        ...

    def __call__(self, left: Tensor, right: Tensor, confidence: bool = False) -> Prediction:
        """Match a batch of pairs.

        Args:
            left: Left views, (B, 3, H, W) float, preprocessed, H and W such multiples.
            right: Right views, likewise.
            confidence: Predict the confidence as well, where the engine has one.

        Returns:
            Disparity of the left views in pixels, and confidence in 0..1 or None, (B, H, W)
            float32 on ``device``.

        Raises:
            InputError: If the shapes do not fit.
        """
        ...


def confidence_fit(engine: Engine) -> Callable[[Tensor], Tensor] | None:
    """Calibration of an engine's confidence, see `nets.confidence`; None where it has none."""
    fit: Callable[[Tensor], Tensor] | None = getattr(engine, "confidence_fit", None)
    return fit
