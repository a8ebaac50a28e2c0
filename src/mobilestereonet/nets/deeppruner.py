"""DeepPruner (Duggal et al., ICCV 2019), "best" and "fast".

PatchMatch looks for a few likely disparities of each pixel, a range predictor cuts the range down
to where they agree, and only a few disparities within that are aggregated: at a quarter ("best")
or an eighth ("fast") of the resolution. Refinements lead from there to the full one.

PatchMatch starts from random particles. Here a seed gives them, so that in eval mode a pair has one
result; in training each step has particles of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import InputError, check_multiple
from mobilestereonet.nets.blocks import initialise
from mobilestereonet.nets.deeppruner_blocks import (
    PARTICLES,
    Hourglass,
    RangeEnd,
    Refinement,
    Smoothing,
    doubled,
    expectation,
    reduction,
)
from mobilestereonet.nets.patch_match import candidate_volume, patch_match
from mobilestereonet.nets.psmnet import FEATURES, POOLING, PyramidFeatures
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.regression import (
    RegressionModel,
    RegressionOutputs,
    enlarged,
)

Sampler = Literal["patch_match", "uniform"]
"""How the disparities within the predicted range are chosen."""

PRUNED = 7
"""Number of candidates in the predicted range, without its two ends; its least width in px."""

UPPER_QUANTILE, LOWER_QUANTILE = 0.95, 0.05
"""Shares of pixels whose disparity is to be below the predicted ends of the range."""

MAX_SEED = 2**32 - 1


@dataclass(frozen=True, kw_only=True)
class DeepPrunerConfig:
    """DeepPruner as data.

    Attributes:
        max_disparity: Largest disparity that is searched; a multiple of the scale. The refinements
            may leave this range.
        scale: The search takes place at 1 / scale of the resolution: 4 ("best") or 8 ("fast").
        sampler: Disparities within the predicted range: "patch_match" runs PatchMatch again, as in
            the paper and for the authors' SceneFlow weights; "uniform" spaces them evenly, as the
            authors' KITTI weights need it.
        seed: Of PatchMatch's particles; the same seed gives the same result.
    """

    max_disparity: int = 192
    scale: Literal[4, 8] = 4
    sampler: Sampler = "patch_match"
    seed: int = 0

    free_fields: ClassVar[tuple[str, ...]] = ("max_disparity", "sampler", "seed")
    """Fields that do not change what a network is called, see `model_name`."""

    untold: ClassVar[dict[str, str]] = {"sampler": "its authors' KITTI weights need uniform"}
    """Fields that the authors' checkpoints do not tell, and what to know of them."""

    def __post_init__(self) -> None:
        check_multiple("max_disparity", self.max_disparity, self.scale)
        if not 0 <= self.seed <= MAX_SEED:
            raise InputError(f"seed must be 0 .. {MAX_SEED}, got {self.seed}")


_RELEASE: dict[str, Any] = {
    "paper": "Duggal et al., DeepPruner: Learning Efficient Stereo Matching via Differentiable "
    "PatchMatch, ICCV 2019",
    "licence": "Uber Non-Commercial License (code), CC BY-NC-SA 3.0 (weights): non-commercial use "
    "alone",
    "trained_on": "SceneFlow cleanpass (sampler patch_match); that and KITTI 2012 and 2015 "
    "(uniform)",
    "recipes": ("deeppruner-sceneflow", "deeppruner-kitti2015"),
}


@register_model(
    "deeppruner-fast",
    config=DeepPrunerConfig(scale=8),
    checkpoints="uber-research/DeepPruner on GitHub: DeepPruner-fast-sceneflow.tar "
    "(sampler=patch_match), DeepPruner-fast-kitti.tar (sampler=uniform)",
    published={"SceneFlow EPE, px": 0.97, "KITTI 2015 test D1-all, %": 2.59},
    **_RELEASE,
)
@register_model(
    "deeppruner-best",
    checkpoints="uber-research/DeepPruner on GitHub: DeepPruner-best-sceneflow.tar "
    "(sampler=patch_match), DeepPruner-best-kitti.tar (sampler=uniform)",
    published={"SceneFlow EPE, px": 0.86, "KITTI 2015 test D1-all, %": 2.15},
    **_RELEASE,
)
class DeepPruner(RegressionModel):
    """PatchMatch, a predicted range for each pixel, and aggregation within it.

    Its scores are of each pixel's own candidates, and refinements follow them: it has no
    distribution over disparities. Views need sides of at least 256 px, as PSMNet's.
    """

    config: DeepPrunerConfig
    min_side = 4 * POOLING[-1]  # and 8 * 32 in the fast network

    def __init__(self, config: DeepPrunerConfig) -> None:
        super().__init__(config)
        fast = config.scale == 8
        windows = POOLING[:3] if fast else POOLING
        self.size_multiple = 8 * config.scale
        # The refined ones, the final one first; the aggregated one; both ends of the range.
        self.head_weights = (*(1.6, 1.3)[-1 - fast :], 1.0, 0.7, 0.7)
        self.features = PyramidFeatures(windows, eighth=fast)
        self.reduce = reduction(2 * FEATURES + 1)
        self.lower, self.upper = RangeEnd(), RangeEnd()
        self.aggregate = nn.Sequential(
            reduction(2 * FEATURES + 1 + 2 * (PARTICLES + 2)), Hourglass(add_input=True)
        )
        self.smoothing = Smoothing(PRUNED + 2)
        first, *others = (64, 32) if fast else (32,)
        self.refinements = nn.ModuleList(
            (Refinement(first + PRUNED + 2 + 1), *(Refinement(inputs + 1) for inputs in others))
        )
        self._step = 0
        initialise(self)
        for smoothing in (self.lower.smoothing, self.upper.smoothing, self.smoothing):
            smoothing.start_as_identity()

    def set_step(self, step: int) -> None:
        """Particles of their own for each training step, see `StereoModel`."""
        self._step = step

    def outputs(self, left: Tensor, right: Tensor) -> RegressionOutputs:
        """Disparities in the order of ``head_weights``, all of full size; see `RegressionModel`.

        In eval mode the final one alone.
        """
        self.check_views(left, right)
        features, *levels = self.features.levels(left)
        pair = features, self.features(right)
        random = np.random.RandomState([self.config.seed, self._step if self.training else 0])
        reach = self.max_disparity // self.config.scale
        low = torch.zeros_like(features[:, :1])
        candidates = self.candidates(*pair, low, low + reach, PARTICLES, "patch_match", random)
        volume = self.reduce(candidate_volume(*pair, candidates))
        lower, lower_features = self.lower(volume, candidates)
        upper, upper_features = self.upper(volume, candidates)

        low, high = pruned_range(lower, upper, reach)
        candidates = self.candidates(*pair, low, high, PRUNED, self.config.sampler, random)
        both = torch.cat((lower_features, upper_features), dim=1).unsqueeze(2)
        both = both.expand(-1, -1, candidates.shape[1], -1, -1)
        scores = self.aggregate(torch.cat((candidate_volume(*pair, candidates), both), dim=1))
        aggregated = doubled(expectation(scores, candidates))
        disparity, maps = self.smoothing(aggregated, enlarged(scores, 2))

        guides: list[tuple[Tensor, ...]] = [(each,) for each in levels[-len(self.refinements) :]]
        guides[0] += (maps,)
        disparities = [disparity]
        for refinement, guide in zip(self.refinements, guides, strict=True):
            disparities.append(refinement(*guide, disparities[-1]))
        heads = [*reversed(disparities), upper, lower] if self.training else disparities[-1:]
        width = left.shape[-1]
        full = [(head, width // head.shape[-1]) for head in heads]
        predictions = [(scale * enlarged(head, scale)).squeeze(1) for head, scale in full]
        return RegressionOutputs(predictions, predictions[0])

    @torch.no_grad()
    def candidates(
        self,
        left: Tensor,
        right: Tensor,
        low: Tensor,
        high: Tensor,
        count: int,
        sampler: Sampler,
        random: np.random.RandomState,
    ) -> Tensor:
        """Integer disparities of each pixel, in pixels of the features: (B, count + 2, H, W).

        Args:
            left: Features of the left views, (B, C, H, W).
            right: Features of the right views, likewise.
            low: Lower end of each pixel's range, (B, 1, H, W); a candidate itself.
            high: Upper end, likewise.
            count: Number of candidates between them.
            sampler: How these are chosen.
            random: Where the particles of "patch_match" come from, the same ones for all pairs of
                a batch, so that no result depends on its neighbours.
        """
        if sampler == "patch_match":
            offsets = random.random_sample((1, count, *low.shape[-2:])).astype(np.float32)
            particles = torch.from_numpy(offsets).to(low.device)
            samples = patch_match(left, right, low, high, particles)
        else:
            steps = torch.arange(1, count + 1, device=low.device)[:, None, None]
            samples = low + steps * (high - low) / (count + 1)
        return torch.cat((low.floor(), samples, high.ceil()), dim=1).trunc()

    def training_loss(self, outputs: RegressionOutputs, disparity: Tensor, valid: Tensor) -> Tensor:
        """Smooth L1 of every disparity, weighted, and the quantile loss of the range's ends.

        See `StereoModel`.
        """
        truth = torch.where(valid, disparity, 0)
        losses = [
            weight * F.smooth_l1_loss(prediction, truth, reduction="none")
            for weight, prediction in zip(self.head_weights, outputs.predictions, strict=True)
        ]
        for quantile, end in zip(
            (UPPER_QUANTILE, LOWER_QUANTILE), outputs.predictions[-2:], strict=True
        ):
            error = truth - end
            losses.append(error * (quantile - (error < 0).to(error.dtype)))
        return (torch.stack(losses).sum(dim=0) * valid).sum() / valid.sum().clamp_min(1)


def pruned_range(lower: Tensor, upper: Tensor, reach: int) -> tuple[Tensor, Tensor]:
    """The range between two disparities, at least `PRUNED` px wide within 0 .. reach.

    Args:
        lower: Predicted lower end, (B, 1, H, W).
        upper: Predicted upper end, likewise; whichever is less is the lower one.
        reach: Largest disparity.
    """
    wide = torch.promote_types(lower.dtype, torch.float32)  # bfloat16 has no fractions from 128 on
    low, high = torch.minimum(lower, upper).to(wide), torch.maximum(lower, upper).to(wide)
    low = torch.minimum(low, (low + high - PRUNED) / 2).clamp(0, reach)
    return low, torch.maximum(high, low + PRUNED).clamp_max(reach)
