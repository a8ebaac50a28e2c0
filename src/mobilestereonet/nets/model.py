"""`StereoModel`, the interface of every stereo network."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import InputError
from mobilestereonet.nets.confidence import ConfidenceFit

MIN_STD = 1e-6
"""Standard deviation of a view, in the unit of its values, below which it counts as constant."""


@dataclass(frozen=True)
class Preprocessing:
    """How RGB views become a network's input: ``(scale * view - mean) / std`` per channel.

    With ``per_image`` each channel of each view is then standardised by its own mean and
    (population) standard deviation.

    Attributes:
        mean: Mean of red, green and blue, after scaling.
        std: Standard deviation of red, green and blue, after scaling.
        scale: Factor of values in 0..1, such as 255 for networks that take 0..255.
        per_image: Standardise each view by its own statistics.
    """

    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    scale: float = 1.0
    per_image: bool = False

    def __call__(self, view: Tensor) -> Tensor:
        """RGB in 0..1, (..., 3, H, W), to the network's input of the same shape."""
        mean = view.new_tensor(self.mean)[:, None, None]
        std = view.new_tensor(self.std)[:, None, None]
        view = (view * self.scale - mean) / std
        if self.per_image:
            around = view.mean(dim=(-2, -1), keepdim=True)
            spread = view.std(dim=(-2, -1), keepdim=True, correction=0)
            view = (view - around) / spread.clamp_min(MIN_STD)
        return view


RGB = Preprocessing()
"""Views stay as they are, RGB in 0..1."""

IMAGENET = Preprocessing((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
"""Normalisation by the mean and standard deviation of ImageNet's pictures."""


class Prediction(NamedTuple):
    """What a network predicts for a batch of pairs.

    Attributes:
        disparity: (B, H, W), in pixels of the left view.
        confidence: (B, H, W) in 0..1; None from networks that regress the disparity without
            scores. From a network, its own: the probability that the disparity is within 2 px of
            the estimate. From a `StereoMatcher`, the probability of an error below 3 px, where the
            weights have a `ConfidenceFit`.
    """

    disparity: Tensor
    confidence: Tensor | None = None


class StereoModel(nn.Module):
    """A stereo network: everything that training, evaluation, export and engines know of one.

    In training mode ``forward`` returns what `training_loss` takes: any object with the final
    prediction as its attribute ``disparity``, (B, H, W), or None where that would take long.

    Args:
        config: The network as data: a frozen dataclass with a field ``max_disparity``. A weights
            file holds it as JSON.

    Attributes:
        config: The same.
        preprocessing: How RGB views become the network's input.
        size_multiple: Height and width of an input must be multiples of this.
        min_side: Smallest height and width of an input.
        exportable: Whether a graph of operators can hold the network.
        confidence_fit: What makes a probability of its confidence, fitted to its weights; None
            where nothing was fitted.
    """

    exportable: ClassVar[bool] = True
    preprocessing: ClassVar[Preprocessing] = IMAGENET
    size_multiple: int = 16
    min_side: int = 1
    confidence_fit: ConfidenceFit | None = None

    @classmethod
    def config_of_state(cls, config: Any, names: Container[str]) -> dict[str, Any]:
        """Values of the config that a state dict's names tell; none by default.

        A state dict without a config is loaded into a network with these values.

        Args:
            config: The registered config, whose values hold where the names tell nothing.
            names: Names of the tensors.
        """
        return {}

    @classmethod
    def state_of_config(cls, config: Any, state: dict[str, Tensor]) -> dict[str, Tensor]:
        """Those tensors of a state dict that a smaller config has; all by default.

        Args:
            config: A config that asks for less than the state dict's own, such as fewer stages.
            state: Tensors by name.
        """
        return state

    def __init__(self, config: Any) -> None:
        super().__init__()
        self.config = config

    @property
    def max_disparity(self) -> int:
        """Disparities 0 .. max_disparity - 1 are searched, in pixels."""
        return int(self.config.max_disparity)

    def forward(self, left: Tensor, right: Tensor) -> Any:
        """Match a batch of pairs.

        Args:
            left: Left views (B, 3, H, W), preprocessed; H and W multiples of ``size_multiple``.
            right: Right views, likewise.

        Returns:
            A `Prediction` in eval mode, in training mode what `training_loss` takes.

        Raises:
            InputError: If the shapes differ or are not such multiples.
        """
        raise NotImplementedError

    def training_loss(self, outputs: Any, disparity: Tensor, valid: Tensor) -> Tensor:
        """The loss of the network's paper, on the pixels that the caller chooses.

        Args:
            outputs: What ``forward`` returned in training mode.
            disparity: Ground truth (B, H, W), in pixels.
            valid: Pixels that count, (B, H, W) bool; see `trained_pixels`.

        Returns:
            Mean over the valid pixels, a scalar; 0 where there is none.
        """
        raise NotImplementedError

    def zero_residuals(self) -> None:
        """Start every residual branch of fresh weights at zero, where a network has this.

        Raises:
            InputError: From networks that do not.
        """
        raise InputError(f"{type(self).__name__} cannot start residual branches at zero")

    def set_step(self, step: int) -> None:
        """Called with the number of the training step before each of them; does nothing here."""

    def check_views(self, left: Tensor, right: Tensor) -> None:
        """Check that two views fit each other and the network.

        Raises:
            InputError: If they are no batches of one shape (B, 3, H, W), or H or W is no multiple
                of ``size_multiple`` or below ``min_side``.
        """
        if left.shape != right.shape or left.dim() != 4 or left.shape[1] != 3:
            raise InputError(
                "left and right must both be (B, 3, H, W), "
                f"got {tuple(left.shape)} and {tuple(right.shape)}"
            )
        height, width = left.shape[-2:]
        if height % self.size_multiple or width % self.size_multiple:
            raise InputError(
                f"height and width must be multiples of {self.size_multiple}, got {height} x "
                f"{width}: pad the pair (StereoMatcher does)"
            )
        if min(height, width) < self.min_side:
            raise InputError(
                f"height and width must be at least {self.min_side}, got {height} x {width}: pad "
                "the pair (StereoMatcher does)"
            )


def smooth_l1_of_heads(
    predictions: Sequence[Tensor], weights: Sequence[float], disparity: Tensor, valid: Tensor
) -> Tensor:
    """Weighted sum of the heads' smooth L1, a mean over the valid pixels; 0 where there is none.

    Args:
        predictions: Disparity (B, H, W) per head, in pixels.
        weights: Weight of each head.
        disparity: Ground truth (B, H, W), in pixels; anything where it is not valid, NaN too.
        valid: Pixels that count, (B, H, W) bool.
    """
    truth = torch.where(valid, disparity, 0)
    losses = [
        weight * (valid * F.smooth_l1_loss(prediction, truth, reduction="none")).sum()
        for weight, prediction in zip(weights, predictions, strict=True)
    ]
    return torch.stack(losses).sum() / valid.sum().clamp_min(1)


def fitting_side(net: StereoModel | type[StereoModel], side: int) -> int:
    """Smallest height or width, in pixels, that a network takes and that is at least ``side``."""
    return math.ceil(max(side, net.min_side) / net.size_multiple) * net.size_multiple


def trained_pixels(disparity: Tensor, valid: Tensor, max_disparity: int) -> Tensor:
    """Pixels with known ground truth 0 < d < max_disparity: (B, H, W) bool.

    Those that MobileStereoNet trains and evaluates on.
    """
    return valid & (disparity > 0) & (disparity < max_disparity)
