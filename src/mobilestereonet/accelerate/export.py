"""The form of a network for export: a graph of plain operators that converters and engines take.

That of a MobileStereoNet has tensors of at most four dimensions (with ``conv3d_as_2d``) and no
height or width written into it: traced at one size, it serves any. Disparities lie along the batch
axis, so it takes one pair.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.export_volumes import (
    BlockwiseCorrelation,
    BlockwiseLearnedVolume,
    banded,
    cut_to,
    fill_without_sizes,
    guidance_in_four_dimensions,
)
from mobilestereonet.accelerate.inference import guide_convolution
from mobilestereonet.accelerate.modules import inference_copy
from mobilestereonet.accelerate.norms import fold_norms
from mobilestereonet.accelerate.slices import slice_layers
from mobilestereonet.accelerate.soft_argmax import ClosedFormSoftArgmax, use_closed_form
from mobilestereonet.errors import InputError
from mobilestereonet.nets.coarse_pass import (
    band_start,
    cut_band,
    halve,
    spread_band,
)
from mobilestereonet.nets.cost_volumes import LearnedVolume
from mobilestereonet.nets.hourglass import Aggregation
from mobilestereonet.nets.model import Prediction, StereoModel
from mobilestereonet.nets.msnet import MobileStereoNet
from mobilestereonet.nets.volume_model import VolumeModel


class ExportableNet(nn.Module):
    """A network in eval mode on one pair, with the same result up to rounding.

    Attributes:
        config: Config of the network.
        preprocessing: How RGB views become the network's input.
        max_disparity: Disparities below this are searched, in pixels.
        size_multiple: Height and width must be multiples of this.
        min_width: Smallest width in pixels.
        any_size: Whether a graph that was traced at one size serves any.
        outputs: Names of what it gives: "disparity" and, of a network with scores, "confidence";
            or "scores" alone.
        finish: What becomes of a prediction, with the RGB views that it is for; needs ``rgb``.
    """

    any_size = False

    def __init__(self, net: StereoModel, *, rgb: bool = False, scores: bool = False) -> None:
        """Rewrite a copy of a network, on the CPU, in float32 or, as it is, float64.

        Args:
            net: The network, with any weights, in any mode and on any device; it stays as it is.
            rgb: Take RGB in 0..1 and preprocess it inside; otherwise preprocessed views.
            scores: Give the last head's scores at their own resolution in place of the prediction.

        Raises:
            InputError: If scores are asked of a network that has none, or no graph can hold it.
        """
        super().__init__()
        if not net.exportable:
            raise InputError(
                f"{type(net).__name__} cannot be exported: no graph of operators holds what it "
                "computes; use the engine torch"
            )
        if scores and not isinstance(net, VolumeModel):
            raise InputError(f"{type(net).__name__} regresses the disparity: it has no scores")
        self.config, self.preprocessing = net.config, net.preprocessing
        self.max_disparity, self.size_multiple = net.max_disparity, net.size_multiple
        self.min_width = max(net.max_disparity + net.size_multiple, net.min_side)
        self.rgb = rgb
        self.finish: Callable[[Prediction, Tensor, Tensor], Prediction] | None = None
        self.outputs: tuple[str, ...] = ("disparity",)
        if isinstance(net, VolumeModel):
            self.outputs = ("scores",) if scores else ("disparity", "confidence")
        net = inference_copy(net).cpu()
        dtype = next((weight.dtype for weight in net.parameters()), torch.float32)
        net.to(torch.promote_types(dtype, torch.float32))
        fold_norms(net)
        self._build(net)
        self.requires_grad_(False).eval()

    def _build(self, net: StereoModel) -> None:
        use_closed_form(net, in_tiles=False)
        self.net = net

    def forward(self, left: Tensor, right: Tensor) -> Tensor | tuple[Tensor, ...]:
        """Match one pair.

        Args:
            left: Left view (1, 3, H, W), preprocessed, or RGB in 0..1 with ``rgb``; H and W are
                multiples of ``size_multiple``, W at least ``min_width``.
            right: Right view, likewise.

        Returns:
            What ``outputs`` names: disparity in pixels and confidence in 0..1, (1, H, W) float32
            each, or scores (1, D, H / s, W / s).
        """
        views = left, right
        if self.rgb:
            dtype = next((weight.dtype for weight in self.parameters()), left.dtype)
            left, right = (self.preprocessing(view).to(dtype) for view in views)
        if self.outputs == ("scores",):
            return self._scores(left, right)
        prediction = self._predict(left, right)
        if self.finish is not None:
            prediction = self.finish(prediction, *views)
        found = tuple(getattr(prediction, name) for name in self.outputs)
        return found if len(found) > 1 else found[0]

    def _predict(self, left: Tensor, right: Tensor) -> Prediction:
        prediction: Prediction = self.net(left, right)
        return prediction

    def _scores(self, left: Tensor, right: Tensor) -> Tensor:
        assert isinstance(self.net, VolumeModel)
        return self.net.scores(left, right)


def exportable_form(
    net: StereoModel, *, rgb: bool = False, scores: bool = False, conv3d_as_2d: bool = False
) -> ExportableNet:
    """A copy of a network for export.

    Args:
        net: See `ExportableNet`.
        rgb: Likewise.
        scores: Likewise.
        conv3d_as_2d: Write 3D layers as 2D layers on slices, where the network's form for export
            has that: for converters without 3D convolutions, or engines that are slow at them.

    Raises:
        InputError: See `ExportableNet`.
    """
    if type(net) is MobileStereoNet:
        return ExportableMobileStereoNet(net, rgb=rgb, scores=scores, conv3d_as_2d=conv3d_as_2d)
    return ExportableNet(net, rgb=rgb, scores=scores)


class GuidedAggregation(nn.Module):
    """Pre-hourglass, guide, hourglasses and last head of a pass."""

    def __init__(self, part: Aggregation) -> None:
        super().__init__()
        self.pre_hourglass = part.pre_hourglass
        self.rest = nn.Sequential(*part.hourglasses, part.heads[-1])
        guide: Any = getattr(part, "guide", None)
        self.guide = nn.Sequential() if guide is None else nn.Sequential(guide_convolution(guide))

    def forward(self, volume: Tensor, guidance: Tensor | None) -> Tensor:
        """Scores of a cost volume, both laid out as `ExportableMobileStereoNet` needs them."""
        x = self.pre_hourglass(volume)
        return cast(Tensor, self.rest(x if guidance is None else x + self.guide(guidance)))


class ExportableMobileStereoNet(ExportableNet):
    """`ExportableNet` of a MobileStereoNet, traced at one size for any."""

    any_size = True

    def __init__(
        self,
        net: MobileStereoNet,
        *,
        rgb: bool = False,
        scores: bool = False,
        conv3d_as_2d: bool = False,
    ) -> None:
        self.conv3d_as_2d = conv3d_as_2d and net.config.dims == 3
        super().__init__(net, rgb=rgb, scores=scores)

    def _build(self, net: StereoModel) -> None:
        assert isinstance(net, MobileStereoNet)
        self.regression = ClosedFormSoftArgmax(net.regression, in_tiles=False)
        self.features, self.reduction = net.features, net.reduction
        self.volume = (
            BlockwiseLearnedVolume(net.volume)
            if isinstance(net.volume, LearnedVolume)
            else BlockwiseCorrelation(net.volume, net.config.volume_input, next(net.parameters()))
        )
        self.fine, self.coarse = GuidedAggregation(net), GuidedAggregation(net.coarse_part)
        if self.conv3d_as_2d:
            slice_layers(self)

    def _predict(self, left: Tensor, right: Tensor) -> Prediction:
        scores = self._scores(left, right)
        return Prediction(self.regression(scores), self.regression.confidence(scores))

    def _scores(self, left: Tensor, right: Tensor) -> Tensor:
        views = torch.cat((left, right))
        planes, band = self.config.planes, self.config.band_planes
        if not self.config.levels:
            return self._pass(self.fine, views, planes)
        coarse = self._coarse_scores(views, planes // 2, self.config.levels)
        guidance = guidance_in_four_dimensions(coarse)
        if not band:
            return self._pass(self.fine, views, planes, guidance)
        start = band_start(coarse, band)
        scores = self._pass(self.fine, views, band, cut_band(guidance, start, band), start)
        return spread_band(scores, start, planes)

    def _coarse_scores(self, views: Tensor, planes: int, levels: int) -> Tensor:
        """As `MobileStereoNet.coarse_scores`, of both views."""
        views, guidance = halve(views), None
        if levels > 1:
            coarser = self._coarse_scores(fill_without_sizes(views), planes // 2, levels - 1)
            guidance = guidance_in_four_dimensions(coarser)
            guidance = cut_to(guidance, F.avg_pool2d(views, 4))
        return self._pass(self.coarse, views, planes, guidance)

    def _pass(
        self,
        part: GuidedAggregation,
        views: Tensor,
        planes: int,
        guidance: Tensor | None = None,
        start: Tensor | None = None,
    ) -> Tensor:
        left, right = self.reduction(self.features(views)).split(1)
        if start is None:
            blocks = list(self.volume(left, right, planes))
        else:
            blocks = list(banded([*self.volume(left, right, self.config.planes)], start, planes))
        if self.conv3d_as_2d:
            volume = torch.cat(blocks)
            guidance = None if guidance is None else guidance.transpose(0, 1)
        else:
            volume = torch.cat([block.transpose(0, 1) for block in blocks], dim=1)  # (C, D, H, W)
            if self.config.dims == 3:
                volume = volume.unsqueeze(0)
                guidance = None if guidance is None else guidance.unsqueeze(1)
            elif len(volume) > 1:
                volume = torch.cat(volume.split(1), dim=1)
        scores: Tensor = part(volume, guidance)
        return scores.unsqueeze(0) if scores.ndim == 3 else scores
