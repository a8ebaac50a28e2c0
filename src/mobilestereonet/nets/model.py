"""`StereoModel`, the interface of every stereo network; `VolumeModel`, with a cost volume."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import InputError
from mobilestereonet.nets.soft_argmax import SoftArgmax

MIN_STD = 1e-6
"""Standard deviation of a view, in the unit of its values, below which it counts as constant."""


COARSE_WEIGHT = 0.5
"""Weight of a coarse pass's loss beside that of the fine pass (Gu et al., CVPR 2020: 0.5 to 1)."""


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
        confidence: (B, H, W) in 0..1, the probability that the disparity is within 2 px of the
            estimate; None from networks that regress the disparity without scores.
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
    """

    exportable: ClassVar[bool] = True
    preprocessing: ClassVar[Preprocessing] = IMAGENET
    size_multiple: int = 16
    min_side: int = 1

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


class Band(NamedTuple):
    """Which planes of a cost volume were searched at each pixel.

    Attributes:
        start: First plane, (B, H / s, W / s) int64.
        planes: Number of planes.
    """

    start: Tensor
    planes: int


class VolumeOutputs:
    """What a `VolumeModel` computes: scores per head, and disparities where they are asked for.

    Args:
        scores: Matching scores (B, D, H / s, W / s) per head, first to last; in eval mode those of
            the last head alone. s is ``regression.scale``.
        volume: The cost volume (B, C, N, H / s, W / s) of the planes that were compared, all D or
            fewer; None from networks that do not give it.
        regression: From scores to disparity.
        band: The planes that were searched; None: all.
        coarse: What a coarse pass computed that the same loss trains; None: there is none.
    """

    def __init__(
        self,
        scores: list[Tensor],
        volume: Tensor | None,
        regression: SoftArgmax,
        band: Band | None = None,
        coarse: VolumeOutputs | None = None,
    ) -> None:
        self.scores = scores
        self.volume = volume
        self.regression = regression
        self.band = band
        self.coarse = coarse

    def last(self, count: int) -> VolumeOutputs:
        """The outputs of the last ``count`` heads."""
        if count >= len(self.scores):
            return self
        coarse = None if self.coarse is None else self.coarse.last(count)
        return VolumeOutputs(self.scores[-count:], self.volume, self.regression, self.band, coarse)

    def searched(self, disparity: Tensor) -> Tensor:
        """Pixels whose ground truth lies within the planes that were searched.

        From the others nothing can be learnt: whatever the scores say, the answer is wrong.

        Args:
            disparity: Ground truth (B, H, W), in pixels.

        Returns:
            (B, H, W) bool.
        """
        if self.band is None:
            return torch.ones_like(disparity, dtype=torch.bool)
        scale = self.regression.scale
        start = self.band.start.repeat_interleave(scale, 1).repeat_interleave(scale, 2)
        # Plane k lies at the disparity s k + (s - 1) / 2.
        plane = (disparity - (scale - 1) / 2) / scale
        return (plane >= start) & (plane <= start + self.band.planes - 1)

    @property
    def passes(self) -> list[tuple[float, VolumeOutputs]]:
        """Outputs that the loss trains, with their weights.

        The fine pass, and the coarse pass if it learns.
        """
        own = (1.0, self)
        return [own] if self.coarse is None else [own, (COARSE_WEIGHT, self.coarse)]

    @cached_property
    def disparities(self) -> list[Tensor]:
        """Expected disparity (B, H, W) per head."""
        return [self.regression.expectation(scores) for scores in self.scores]

    @property
    def disparity(self) -> Tensor:
        """Expected disparity of the last head, (B, H, W), in pixels."""
        return self.disparities[-1]


class VolumeModel(StereoModel):
    """A network that scores each pixel's disparities, and regresses from the scores.

    Attributes:
        head_weights: Weights of the heads in the loss, first to last.
        regression: From scores to disparity and confidence.
    """

    head_weights: tuple[float, ...] = (1.0,)
    regression: SoftArgmax

    def outputs(self, left: Tensor, right: Tensor) -> VolumeOutputs:
        """Scores of all heads in training mode, of the last one in eval mode.

        Args:
            left: Left views (B, 3, H, W), preprocessed.
            right: Right views, likewise.

        Raises:
            InputError: If the shapes do not fit, see `check_views`.
        """
        raise NotImplementedError

    def scores(self, left: Tensor, right: Tensor) -> Tensor:
        """The last head's matching scores (B, D, H / s, W / s), s being ``regression.scale``."""
        return self.outputs(left, right).scores[-1]

    def forward(self, left: Tensor, right: Tensor) -> Any:
        """A `Prediction` in eval mode, `VolumeOutputs` in training mode; see `StereoModel`."""
        if self.training:
            return self.outputs(left, right)
        scores = self.scores(left, right)
        return Prediction(self.regression(scores), self.regression.confidence(scores))

    def weights_of(self, heads: list[Tensor]) -> list[float]:
        """Weights of the last heads; those before the listed ones weigh as the first of them."""
        missing = max(0, len(heads) - len(self.head_weights))
        weights = [self.head_weights[0]] * missing + list(self.head_weights)
        return weights[-len(heads) :]

    def training_loss(self, outputs: VolumeOutputs, disparity: Tensor, valid: Tensor) -> Tensor:
        """Smooth L1 of the heads' expected disparities, weighted; see `StereoModel`.

        Of each pass's pixels whose disparity was searched (`VolumeOutputs.searched`).
        """
        losses = [
            weight
            * smooth_l1_of_heads(
                part.disparities,
                self.weights_of(part.scores),
                disparity,
                valid & part.searched(disparity),
            )
            for weight, part in outputs.passes
        ]
        return torch.stack(losses).sum()


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
