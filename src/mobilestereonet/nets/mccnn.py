"""MC-CNN (Zbontar and LeCun, "Stereo Matching by Training a CNN to Compare Patches", JMLR 2016).

A network that compares small patches, fast or accurate ("slow"), and a whole stereo method after
it: cross-based aggregation, semi-global matching and the refinement of the disparity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import InputError
from mobilestereonet.nets.cross_based import (
    Penalties,
    SemiGlobalMatching,
    aggregate,
    cross_arms,
)
from mobilestereonet.nets.disparity_refinement import (
    bilateral,
    fill_mismatched,
    fill_occluded,
    median,
    outliers,
    subpixel,
)
from mobilestereonet.nets.model import MIN_STD, RGB, Prediction, StereoModel
from mobilestereonet.nets.registry import register_model

GREY = (0.299, 0.587, 0.114)
"""Shares of red, green and blue in an intensity."""


MARGIN = 0.2
"""Of the fast network's loss: by how much the right partner should be more alike."""

PIXELS = 1 << 14
"""Most pixels of a batch that the loss compares."""

ROWS = 32
"""Rows whose pixels are compared at once."""


@dataclass(frozen=True, kw_only=True)
class MCCNNConfig:
    """MC-CNN as data, by default the fast network with the parameters for KITTI 2015.

    Attributes:
        max_disparity: Disparities 0 .. max_disparity - 1 are searched.
        layers: 3x3 convolutions.
        width: Channels of the convolutions.
        hidden: Hidden fully connected layers that compare two patches; with none, the fast
            network, it is the cosine of their features.
        hidden_width: Units of those.
        arm: Limit of the arms of a cross, in px.
        arm_intensity: Most that intensities in an arm differ.
        rounds_before: Rounds of aggregation before semi-global matching.
        rounds_after: The same after it.
        p1: See `Penalties`, also for the next five.
        p2: Penalty.
        q1: Divisor.
        q2: Divisor.
        alpha: Divisor.
        step: Intensity difference.
        blur: Standard deviation of the bilateral filter, in px.
        blur_threshold: Most that disparities in it differ, in px.
    """

    free_fields: ClassVar[tuple[str, ...]] = (
        *("max_disparity", "arm", "arm_intensity", "rounds_before", "rounds_after"),
        *("p1", "p2", "q1", "q2", "alpha", "step", "blur", "blur_threshold"),
    )

    max_disparity: int = 228
    layers: int = 4
    width: int = 64
    hidden: int = 0
    hidden_width: int = 384
    arm: int = 0
    arm_intensity: float = 0.0
    rounds_before: int = 0
    rounds_after: int = 0
    p1: float = 2.3
    p2: float = 18.38
    q1: float = 3.0
    q2: float = 2.0
    alpha: float = 1.25
    step: float = 0.08
    blur: float = 4.64
    blur_threshold: float = 5.0

    def __post_init__(self) -> None:
        positive = ("max_disparity", "layers", "width", "hidden_width", "blur", "blur_threshold")
        for name in (*positive, "q1", "q2", "alpha"):
            if (value := getattr(self, name)) <= 0:
                raise InputError(f"{name} must be positive, got {value}")
        for name in ("hidden", "arm", "rounds_before", "rounds_after", "p1", "p2"):
            if (value := getattr(self, name)) < 0:
                raise InputError(f"{name} must not be negative, got {value}")
        if self.max_disparity < 3:
            raise InputError(f"max_disparity must be at least 3, got {self.max_disparity}")

    @property
    def penalties(self) -> Penalties:
        """Those of semi-global matching."""
        return Penalties(self.p1, self.p2, self.q1, self.q2, self.alpha, self.step)


SLOW_KITTI2015 = MCCNNConfig(
    width=112,
    hidden=4,
    arm=5,
    arm_intensity=0.03,
    rounds_before=2,
    rounds_after=4,
    p2=24.25,
    alpha=1.75,
    blur=5.99,
)
"""The accurate network with its parameters for KITTI 2015."""


class MCCNNOutputs:
    """Features of both views, (B, C, H, W), and the disparity (B, H, W) where it is asked for."""

    def __init__(self, net: MCCNN, left: Tensor, right: Tensor) -> None:
        self.net, self.left, self.right = net, left, right

    @cached_property
    def disparity(self) -> Tensor | None:
        """Of the lowest cost, without the stereo method and without a gradient.

        None in the accurate network, where it would take most of a step's time.
        """
        return None if self.net.config.hidden else self.cheapest()

    def cheapest(self) -> Tensor:
        """Disparity (B, H, W) of the lowest cost."""
        with torch.no_grad():
            pairs = zip(self.left, self.right, strict=True)
            volumes = [self.net.volume(left, right) for left, right in pairs]
            return torch.stack([volume.argmin(dim=0) for volume in volumes]).to(self.left.dtype)


_INFORMATION: dict[str, Any] = {
    "paper": "Zbontar and LeCun, Stereo Matching by Training a Convolutional Neural Network to "
    "Compare Image Patches, JMLR 2016",
    "licence": "BSD 2-clause",
    "checkpoints": "none that can be read here; jzbontar/mc-cnn on GitHub has Torch7 files",
    "trained_on": "KITTI 2012, KITTI 2015 or Middlebury",
}


@register_model(
    "mccnn-slow", config=SLOW_KITTI2015, recipes=("mccnn-slow-kitti2015",), **_INFORMATION
)
@register_model("mccnn-fast", recipes=("mccnn-fast-kitti2015",), **_INFORMATION)
class MCCNN(StereoModel):
    """Patches of 9x9 px compared by their features, and a stereo method without learning."""

    config: MCCNNConfig
    exportable = False  # mismatched pixels are looked up one by one
    preprocessing = RGB
    size_multiple = 1

    def __init__(self, config: MCCNNConfig) -> None:
        super().__init__(config)
        self.min_side = 2 * config.layers + 1
        sizes = [1, *[config.width] * config.layers]
        self.convs = nn.ModuleList(
            nn.Conv2d(inputs, outputs, 3, padding=1) for inputs, outputs in pairwise(sizes)
        )
        self.semi_global = SemiGlobalMatching(config.penalties)
        sizes = [2 * config.width, *[config.hidden_width] * config.hidden, 1]
        self.compare = nn.ModuleList(
            nn.Linear(inputs, outputs) for inputs, outputs in pairwise(sizes) if config.hidden
        )

    def forward(self, left: Tensor, right: Tensor) -> Any:
        """A `Prediction` in eval mode, `MCCNNOutputs` in training mode; see `StereoModel`."""
        self.check_views(left, right)
        left, right = intensities(left), intensities(right)
        outputs = MCCNNOutputs(self, self.features(left), self.features(right))
        if self.training:
            return outputs
        if left.is_meta:  # the stereo method depends on values
            return Prediction(outputs.cheapest())
        pairs = zip(outputs.left, outputs.right, left[:, 0], right[:, 0], strict=True)
        return Prediction(torch.stack([self.match(*pair) for pair in pairs]))

    def features(self, image: Tensor) -> Tensor:
        """Intensities (B, 1, H, W) -> (B, C, H, W), of unit length in the fast network."""
        x = image
        for conv in self.convs[:-1]:
            x = F.relu(conv(x))
        x = self.convs[-1](x)
        if self.config.hidden:
            return F.relu(x)
        return cast(Tensor, x / (x.square().sum(dim=1, keepdim=True) + 1e-5).sqrt())

    def logit(self, left: Tensor, right: Tensor) -> Tensor:
        """Mismatch of patches by their features (..., C): logit of its probability, (...)."""
        x = torch.cat((left, right), dim=-1)
        for layer in self.compare[:-1]:
            x = F.relu(layer(x))
        return cast(Tensor, self.compare[-1](x).squeeze(-1))

    def volume(self, left: Tensor, right: Tensor) -> Tensor:
        """Costs (D, H, W) of the left view from the features (C, H, W) of both.

        Infinite where a pixel has no partner.
        """
        _, height, width = left.shape
        volume = left.new_full((self.max_disparity, height, width), torch.inf)
        for top in range(0, height, ROWS):
            rows = slice(top, top + ROWS)
            one, other = (view[:, rows].permute(1, 2, 0) for view in (left, right))
            alike = None if self.config.hidden else one @ other.mT  # all pairs of columns
            for d in range(min(self.max_disparity, width)):
                if alike is None:
                    cost = self.logit(one[:, d:], other[:, : width - d]).sigmoid()
                else:
                    cost = -alike.diagonal(-d, dim1=1, dim2=2)
                volume[d, rows, d:] = cost
        return volume

    def match(self, left: Tensor, right: Tensor, image: Tensor, other: Tensor) -> Tensor:
        """The stereo method (Sec. 4): disparity (H, W) of the left view.

        Args:
            left: Features of the left view, (C, H, W).
            right: Features of the right view, likewise.
            image: Intensities of the left view, (H, W).
            other: Intensities of the right view, likewise.
        """
        config = self.config
        volume = self.volume(left, right)
        of_right = self.optimise(self.for_right(volume), image, other, side=1).argmin(dim=0)
        volume = self.optimise(self.at_border(volume, -1), image, other, side=-1)
        disparity = volume.argmin(dim=0)
        classes = outliers(disparity, of_right, config.max_disparity)
        disparity = disparity.to(volume.dtype)
        disparity = fill_mismatched(fill_occluded(disparity, classes), classes)
        disparity = median(subpixel(disparity, volume))
        return bilateral(disparity, config.blur, config.blur_threshold)

    def for_right(self, volume: Tensor) -> Tensor:
        """The right view's volume, from the same comparisons as the left view's."""
        planes, _, width = volume.shape
        moved = torch.full_like(volume, torch.inf)
        for d in range(min(planes, width)):
            moved[d, :, : width - d] = volume[d, :, d:]
        return self.at_border(moved, 1)

    def at_border(self, volume: Tensor, side: int) -> Tensor:
        """A volume whose columns that see past the border are those beside them."""
        n, width = self.config.layers, volume.shape[-1]
        columns = slice(width - n, width) if side < 0 else slice(0, n)
        beside = volume[..., width - 1 - n if side < 0 else n, None]
        volume = volume.clone()
        # Of planes in which the column beside them has no partner, they keep their own.
        volume[..., columns] = torch.where(beside.isfinite(), beside, volume[..., columns])
        return volume

    def optimise(self, volume: Tensor, image: Tensor, other: Tensor, side: int) -> Tensor:
        """Aggregation, semi-global matching, aggregation (Sec. 4.1, 4.2), see `cross_based`."""
        config = self.config
        arms, partner = (
            cross_arms(view, config.arm, config.arm_intensity) for view in (image, other)
        )
        for _ in range(config.rounds_before):
            volume = aggregate(volume, arms, partner, side)
        volume = self.semi_global(volume, image, other, side)
        for _ in range(config.rounds_after):
            volume = aggregate(volume, arms, partner, side)
        return volume

    def training_loss(self, outputs: MCCNNOutputs, disparity: Tensor, valid: Tensor) -> Tensor:
        """Hinge loss or, in the accurate network, cross entropy (Sec. 3); see `StereoModel`.

        Of up to `PIXELS` pixels, each with a right partner, within 1 px of the ground truth, and a
        wrong one, 4 to 10 px off.
        """
        batch, y, x = valid.nonzero(as_tuple=True)
        chosen = torch.randperm(len(x), device=x.device)[:PIXELS]
        batch, y, x = batch[chosen], y[chosen], x[chosen]
        near = 2 * torch.rand_like(disparity[batch, y, x]) - 1
        far = (4 + 6 * torch.rand_like(near)) * near.new_tensor([-1, 1])[
            torch.randint(2, near.shape, device=x.device)
        ]
        partner = x - disparity[batch, y, x]
        columns = torch.stack((partner + near, partner + far)).round().long()
        inside = ((columns >= 0) & (columns < valid.shape[-1])).all(dim=0)
        batch, y, x, columns = batch[inside], y[inside], x[inside], columns[:, inside]
        features = outputs.left.movedim(1, -1)[batch, y, x]
        right, wrong = (outputs.right.movedim(1, -1)[batch, y, column] for column in columns)
        if self.config.hidden:
            mismatch = self.logit(features, wrong), self.logit(features, right)
            losses = F.softplus(-mismatch[0]) + F.softplus(mismatch[1])
        else:
            losses = F.relu(MARGIN + (features * wrong).sum(-1) - (features * right).sum(-1))
        return losses.sum() / max(len(x), 1)


def intensities(view: Tensor) -> Tensor:
    """Grey values (B, 1, H, W) of RGB, without their mean and by their standard deviation."""
    grey = (view * view.new_tensor(GREY)[:, None, None]).sum(dim=1, keepdim=True)
    grey = grey - grey.mean(dim=(-2, -1), keepdim=True)
    return grey / grey.std(dim=(-2, -1), keepdim=True).clamp_min(MIN_STD)
