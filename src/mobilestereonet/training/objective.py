"""The loss of a training batch under a recipe: the network's own, and terms on matching scores."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import torch
from torch import Tensor

from mobilestereonet.accelerate.soft_argmax import has_closed_form
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel, VolumeModel, trained_pixels
from mobilestereonet.nets.model import fitting_side
from mobilestereonet.nets.registry import import_from_file
from mobilestereonet.training.losses import (
    cross_entropy_sum,
    distillation_sum,
    fine_cross_entropy_sum,
    own_surface,
    surfaces,
)
from mobilestereonet.training.recipe import MODEL_LOSS, Recipe

LossFunction: TypeAlias = Callable[[Any, Tensor, Tensor], Tensor]
"""Outputs in training mode, disparity in px, valid pixels (both (B, H, W)) to a mean, a scalar."""


class Part(NamedTuple):
    """One part of a batch's loss.

    Attributes:
        total: Sum over pixels, a scalar.
        pixels: How many pixels it is a sum over, or the sum of their weights.
        figures: Means to log, by name.
    """

    total: Tensor
    pixels: Tensor
    figures: dict[str, Tensor]


class Objective:
    """Sums of losses over the pixels of a batch, so that ranks can be averaged exactly.

    Args:
        recipe: The recipe.
        net: The network in training.

    Raises:
        FileNotFoundError: If the file of a loss of the user's own is not there.
        InputError: If a value of the recipe does not fit the network, or the file has no such
            function.
    """

    def __init__(self, recipe: Recipe, net: StereoModel) -> None:
        _check_crop(recipe, net)
        _check_heads(recipe, net)
        self.recipe = recipe
        self._own_loss: LossFunction | None = None
        if recipe.loss != MODEL_LOSS:
            self._own_loss = _import_loss(recipe.loss)

    def truth(self, net: StereoModel, outputs: Any, pairs: StereoSample) -> Part:
        """What the ground truth says; zeros where there is none.

        Args:
            net: The network that gave ``outputs``.
            outputs: What it gave in training mode.
            pairs: Batch of pairs, (B, 3, H, W).
        """
        if pairs.disparity is None or pairs.valid is None:
            zero = pairs.left.new_zeros((), dtype=torch.float32)
            return Part(zero, zero, {})
        mask = trained_pixels(pairs.disparity, pairs.valid, net.max_disparity)
        pixels = mask.sum()
        trained = self.trained_heads(outputs)
        loss = self._own_loss or net.training_loss
        # The mean over nothing need not be finite: take it over everything, and count it as zero.
        mean = loss(trained, pairs.disparity, mask | (pixels == 0))
        total = mean * pixels
        figures: dict[str, Tensor] = {}
        if isinstance(net, VolumeModel):
            coarse, figures = self._volume_terms(net, outputs, pairs.disparity, mask)
            total = total + coarse
        if trained.disparity is not None:
            error = torch.where(mask, (trained.disparity.detach() - pairs.disparity).abs(), 0)
            figures["epe"] = error.sum() / pixels.clamp_min(1)
        return Part(total, pixels.to(total.dtype), figures)

    def taught(
        self,
        net: VolumeModel,
        outputs: Any,
        teacher_scores: Tensor,
        teacher_disparity: Tensor,
        confidence: Tensor,
    ) -> Part:
        """What a teacher says, each pixel counting as far as the teacher is sure of it.

        Of a cascade both passes learn, the fine one where the teacher's disparity is in its band.

        Args:
            net: The network that gave ``outputs``.
            outputs: What it gave in training mode.
            teacher_scores: The teacher's scores (B, D, H / s, W / s).
            teacher_disparity: The teacher's disparity (B, H, W) in px.
            confidence: The teacher's confidence (B, H, W) in 0..1.
        """
        total = confidence.new_zeros(())
        for weight, part in outputs.passes:
            total = total + weight * distillation_sum(
                part.scores,
                net.weights_of(part.scores),
                self.trained_heads(part).disparity,
                teacher_scores,
                teacher_disparity,
                confidence * part.searched(teacher_disparity),
                cross_entropy=self.recipe.cross_entropy,
                scale=net.regression.scale,
                searched=part.searched_planes,
            )
        return Part(total, confidence.sum(), {})

    def trained_heads(self, outputs: Any) -> Any:
        """Outputs of the heads that the full-resolution loss trains."""
        return outputs.last(self.recipe.full_heads) if self.recipe.full_heads else outputs

    def _volume_terms(
        self, net: VolumeModel, outputs: Any, disparity: Tensor, mask: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Cross entropies of the scores and of a cost volume of one channel, where wanted."""
        total = disparity.new_zeros(())
        figures: dict[str, Tensor] = {}
        scale = net.regression.scale
        if self.recipe.cross_entropy:
            for weight, part in outputs.passes:
                searched = mask & part.searched(disparity)
                loss = self._cross_entropy(net, part.scores, disparity, searched)
                total = total + weight * self.recipe.cross_entropy * loss
        volume = outputs.volume
        if self.recipe.volume_cross_entropy and volume is not None and volume.shape[1] == 1:
            loss = volume_loss_sum(volume, disparity, mask, scale=scale)
            figures["volume_loss"] = loss.detach() / mask.sum().clamp_min(1)
            total = total + self.recipe.volume_cross_entropy * loss
        return total, figures

    def _cross_entropy(
        self, net: VolumeModel, scores: list[Tensor], disparity: Tensor, mask: Tensor
    ) -> Tensor:
        weights = net.weights_of(scores)
        if self.recipe.cross_entropy_target == "planes":
            return cross_entropy_sum(scores, weights, disparity, mask, scale=net.regression.scale)
        modes = surfaces if self.recipe.cross_entropy_target == "surfaces" else own_surface
        full_heads = self.recipe.full_heads or len(scores)
        return fine_cross_entropy_sum(
            scores, weights, *modes(disparity, mask), full_heads=full_heads
        )


def volume_loss_sum(volume: Tensor, disparity: Tensor, mask: Tensor, *, scale: int = 4) -> Tensor:
    """Cross entropy of a cost volume of one channel, its planes taken as scores.

    Args:
        volume: (B, 1, D, H / s, W / s).
        disparity: Ground truth (B, H, W) in pixels.
        mask: Pixels that count, (B, H, W) bool.
        scale: Pixels from one coarse plane to the next, s.

    Returns:
        Sum over pixels, see `cross_entropy_sum`.
    """
    # Batch norm and ReLU leave the planes within a few units: sharpen them to be scores.
    scores = 4 * volume[:, 0].float()
    # Plane k compares columns at disparity s k, while a head's plane k means s k + (s - 1) / 2.
    return cross_entropy_sum([scores], [1.0], disparity + (scale - 1) / 2, mask, scale=scale)


def _check_crop(recipe: Recipe, net: StereoModel) -> None:
    """Refuse crops of a size that the network does not take."""
    for name in ("height", "width"):
        side = getattr(recipe.augment, name)
        if side is not None and (fitting := fitting_side(net, side)) != side:
            raise InputError(
                f"recipe: {recipe.model} takes heights and widths that are multiples of "
                f"{net.size_multiple}, from {fitting_side(net, 1)} on, and augment.{name} is "
                f"{side}: --set augment.{name}={fitting}"
            )


def _check_heads(recipe: Recipe, net: StereoModel) -> None:
    """Refuse what the recipe asks of scores that the network does not have, or of too few heads."""
    if not isinstance(net, VolumeModel):
        defaults = {part.name: part.default for part in dataclasses.fields(Recipe)}
        needed = ("full_heads", "cross_entropy", "volume_cross_entropy", "teacher")
        wanted = [name for name in needed if getattr(recipe, name) != defaults[name]]
        if wanted:
            values = " ".join(f"--set {name}={_as_json(defaults[name])}" for name in wanted)
            raise InputError(
                f"recipe: {recipe.model} regresses the disparity directly, and {', '.join(wanted)} "
                f"need matching scores: {values}, or --recipe procedural-plain"
            )
        return
    if (recipe.cross_entropy or recipe.volume_cross_entropy) and net.regression.align_corners:
        raise InputError(
            f"recipe: cross_entropy is for scores with half-pixel centres, and {recipe.model} has "
            "net.align_corners: --set net.align_corners=false, or --set cross_entropy=0 "
            "--set volume_cross_entropy=0"
        )
    target = recipe.cross_entropy_target
    if recipe.cross_entropy and target != "planes" and not has_closed_form(net.regression):
        raise InputError(
            f"recipe: cross_entropy_target={target} is for scores at a quarter of the resolution "
            f"with half-pixel centres, not for those of {recipe.model}: "
            "--set cross_entropy_target=planes"
        )
    heads = len(net.head_weights)
    if recipe.full_heads and recipe.full_heads < heads and not recipe.cross_entropy:
        raise InputError(
            f"recipe: full_heads={recipe.full_heads} without cross_entropy leaves the other heads "
            f"of {recipe.model} without a gradient: --set full_heads=null, or --set cross_entropy=5"
        )


def _as_json(value: Any) -> str:
    return "null" if value is None else f"{value:g}"


def _import_loss(reference: str) -> LossFunction:
    path, colon, name = reference.rpartition(":")
    if not colon or not path.endswith(".py"):
        raise InputError(
            f'recipe: loss must be "{MODEL_LOSS}" or such as my_loss.py:function, got {reference!r}'
        )
    function: LossFunction = import_from_file(Path(path), name)
    if not callable(function):
        raise InputError(f"{path}: {name} is no function(outputs, disparity, valid)")
    return function
