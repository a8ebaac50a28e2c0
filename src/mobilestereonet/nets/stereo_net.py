"""The assembly of every network in the paper."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn

from mobilestereonet.errors import InputError
from mobilestereonet.nets.blocks import V2Block, initialise
from mobilestereonet.nets.coarse_pass import guidance, halve
from mobilestereonet.nets.config import NetConfig
from mobilestereonet.nets.cost_volumes import build_cost_volume
from mobilestereonet.nets.disparity import regress_disparity
from mobilestereonet.nets.features import (
    FeatureExtraction,
    ResidualBlock,
    channel_reduction,
)
from mobilestereonet.nets.hourglass import Head, Hourglass, PreHourglass


class StereoNet(nn.Module):
    """Stereo matching network (the paper's Fig. 4), assembled from a config.

    Both views go through the features in one batch, and all disparities through the cost volume
    in one: in training, batch norm statistics are taken once, over both views and all
    disparities, without the columns left of each disparity. In eval mode the result is that of
    the authors' code, which loops.
    """

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.config = config
        self.features = FeatureExtraction(config)
        self.reduction = channel_reduction() if config.channel_reduction else nn.Identity()
        self.volume = build_cost_volume(config)
        inputs = config.volume_channels * (config.planes if config.dims == 2 else 1)
        self.pre_hourglass = PreHourglass(config, inputs)
        self.hourglasses = nn.ModuleList(Hourglass(config) for _ in range(config.hourglasses))
        self.heads = nn.ModuleList(Head(config) for _ in range(config.hourglasses + 1))
        initialise(self)
        if config.coarse_pass:
            self.guide = nn.Conv3d(1, config.width, 3, padding=1, bias=False)
            nn.init.zeros_(self.guide.weight)

    def forward(self, left: Tensor, right: Tensor) -> Tensor | list[Tensor]:
        """Disparity of the left view.

        Args:
            left: Left views (B, 3, H, W), RGB in 0..1, normalised by ImageNet's mean and standard
                deviation; H and W are multiples of the config's ``size_multiple``.
            right: Right views, likewise.

        Returns:
            Disparity (B, H, W) in pixels in eval mode; in training mode a list of one disparity
            per head, first to last.

        Raises:
            InputError: If the shapes differ or are not such multiples.
        """
        scores = self.scores(left, right)
        if self.training:
            return [regress_disparity(score) for score in scores]
        return regress_disparity(scores[-1], self.config.estimator)

    def scores(self, left: Tensor, right: Tensor) -> list[Tensor]:
        """Matching scores before the upsampling, see `aggregate`."""
        guidance = self.guidance(left, right)  # first, while no volume takes memory
        return self.aggregate(self.cost_volume(left, right), guidance)

    @torch.no_grad()
    def guidance(self, left: Tensor, right: Tensor) -> Tensor | None:
        """What the coarse pass, in eval mode, tells the fine one.

        Args:
            left: Left views (B, 3, H, W), normalised.
            right: Right views, likewise.

        Returns:
            (B, D, H / 4, W / 4), see `nets.coarse_pass`; None from a network without one.

        Raises:
            InputError: If the shapes differ or are not multiples of the config's ``size_multiple``.
        """
        if not self.config.coarse_pass:
            return None
        self.check_views(left, right)
        training = self.training
        self.eval()
        volume = self._volume(halve(left), halve(right), self.config.planes // 2)
        scores = self.aggregate(volume)[-1]
        self.train(training)
        return guidance(scores)

    def cost_volume(self, left: Tensor, right: Tensor) -> Tensor:
        """Cost volume of a pair.

        Args:
            left: Left views (B, 3, H, W), normalised; H and W are multiples of the config's
                ``size_multiple``.
            right: Right views, likewise.

        Returns:
            (B, C, D, H / 4, W / 4), D disparities at a quarter of the resolution.

        Raises:
            InputError: If the shapes differ or are not such multiples.
        """
        self.check_views(left, right)
        return self._volume(left, right, self.config.planes)

    def _volume(self, left: Tensor, right: Tensor, planes: int) -> Tensor:
        views = self.reduction(self.features(torch.cat((left, right))))
        return cast(Tensor, self.volume(*views.chunk(2), planes))

    def aggregate(self, volume: Tensor, guidance: Tensor | None = None) -> list[Tensor]:
        """Encoder-decoder and heads: matching scores of a cost volume.

        Args:
            volume: (B, C, D, H / 4, W / 4).
            guidance: (B, D, H / 4, W / 4), see `guidance`; None, as zeros, tells nothing.

        Returns:
            One (B, D, H / 4, W / 4) per head in training mode, the last one's alone in eval mode.
        """
        x = self.pre_hourglass(volume.flatten(1, 2) if self.config.dims == 2 else volume)
        if guidance is not None:
            x = self.guide(guidance.unsqueeze(1)).add_(x)
        scores = []
        for head, hourglass in zip(self.heads[:-1], self.hourglasses, strict=True):
            if self.training:
                scores.append(cast(Tensor, head(x)))
            x = hourglass(x)
        return [*scores, cast(Tensor, self.heads[-1](x))]

    def zero_residuals(self) -> None:
        """Start every residual branch at zero: the last batch norm's scale in each.

        Fresh weights as the authors draw them amplify rounding some ten thousand times from input
        to scores, so that reduced precision gives the first layers gradients of mere noise.
        """
        for module in self.modules():
            if isinstance(module, ResidualBlock):
                nn.init.zeros_(cast(nn.BatchNorm2d, module.conv2[-1]).weight)
            elif isinstance(module, V2Block) and module.skip:
                nn.init.zeros_(cast(nn.BatchNorm2d, module.conv[-1]).weight)

    def check_views(self, left: Tensor, right: Tensor) -> None:
        """Check that two views fit each other and the network.

        Raises:
            InputError: If the shapes differ or are not multiples of the config's ``size_multiple``.
        """
        if left.shape != right.shape or left.dim() != 4 or left.shape[1] != 3:
            raise InputError(
                "left and right must both be (B, 3, H, W), "
                f"got {tuple(left.shape)} and {tuple(right.shape)}"
            )
        height, width = left.shape[-2:]
        multiple = self.config.size_multiple
        if height % multiple or width % multiple:
            raise InputError(
                f"height and width must be multiples of {multiple}, got {height} x {width}: "
                "pad the pair (StereoMatcher does)"
            )
