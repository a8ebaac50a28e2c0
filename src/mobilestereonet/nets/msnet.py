"""MobileStereoNet (Shamsafar et al., WACV 2022): the networks of the paper and of its ablations.

Both views go through the features one after the other, a loop over the disparities builds the
cost volume (Sec. 3.2), and an encoder-decoder (a pre-hourglass and stacked hourglasses, in 2D or
3D) turns it into matching scores per head (Figs. 4 and A1). The paper does not describe the heads
and the regression; they follow the authors' release.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace
from typing import Any, cast, get_args

import torch
from torch import Tensor, nn

from mobilestereonet.nets.blocks import Block, V2Block, initialise
from mobilestereonet.nets.coarse_pass import (
    Guide,
    band_start,
    cut_band,
    fill,
    guidance_from_scores,
    halve,
    spread_band,
    upsample_coarse,
)
from mobilestereonet.nets.cost_volumes import Correlation, CostVolume, LearnedVolume
from mobilestereonet.nets.features import FeatureExtraction, ResidualBlock, channel_reduction
from mobilestereonet.nets.hourglass import (
    Aggregation,
    EncoderDecoder,
    Head,
    Hourglass,
    PreHourglass,
)
from mobilestereonet.nets.msnet_config import NetConfig
from mobilestereonet.nets.operations import eval_mode
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.soft_argmax import SoftArgmax
from mobilestereonet.nets.volume_model import Band, VolumeModel, VolumeOutputs

SMALL_VIEW_PIXELS = 75_000
"""Views of up to so many pixels go through the features together in eval mode.

One after the other, half of their time would go into calling the layers."""

UNGUIDED_STEPS = 4
"""Every n-th training step runs unguided, so that the network also learns the coarse pass."""


_COARSE_GUIDE = "coarse.guide.weight"


class MobileStereoNet(Aggregation, VolumeModel):
    """Stereo matching network (the paper's Fig. 4), assembled from a config."""

    config: NetConfig
    head_weights = (0.5, 0.5, 0.7, 1.0)  # the authors' release

    def __init__(self, config: NetConfig) -> None:
        super().__init__(config)
        self.size_multiple = config.size_multiple
        self.features = FeatureExtraction(config)
        self.reduction = channel_reduction() if config.channel_reduction else nn.Identity()
        self.volume = (
            LearnedVolume(config.cost_volume)
            if config.learns_volume
            else Correlation(groups=config.volume_channels)
        )
        inputs = config.volume_channels * (config.planes if config.dims == 2 else 1)
        self.pre_hourglass = PreHourglass(config, inputs)
        self.hourglasses = nn.ModuleList(Hourglass(config) for _ in range(config.hourglasses))
        self.heads = nn.ModuleList(Head(config) for _ in range(config.hourglasses + 1))
        self.regression = SoftArgmax(4, config.estimator)
        initialise(self)
        if config.coarse_pass:
            self.guide = Guide(config.width)
        if config.coarse_hourglasses:
            self.coarse = EncoderDecoder(config, config.volume_channels, config.coarse_hourglasses)
            initialise(self.coarse)
            if config.levels > 1:
                self.coarse.guide = Guide(config.width)
        self._guided = True

    @classmethod
    def config_of_state(cls, config: NetConfig, names: Container[str]) -> dict[str, Any]:
        """A guide is that of a coarse pass, which a cascade always has; see `StereoModel`.

        A cascade's coarse pass that has a guide of its own is guided by a coarser one.
        """
        if config.dims == 3 and "guide.weight" in names:
            lone = config.coarse_hourglasses and _COARSE_GUIDE not in names
            return {"coarse_pass": True} | ({"coarse_levels": 1} if lone else {})
        if config.band:
            return {}
        return {"coarse_pass": False, "coarse_levels": 1, "coarse_hourglasses": 0, "band": 0}

    @classmethod
    def state_of_config(cls, config: NetConfig, state: dict[str, Tensor]) -> dict[str, Tensor]:
        """Fewer hourglasses, or a coarse pass that starts as the fine one; see `StereoModel`.

        Without the last hourglasses the network ends in the head before them.
        """
        coarse = {name: value for name, value in state.items() if name.startswith("coarse.")}
        fine = {name: value for name, value in state.items() if name not in coarse}
        if not config.coarse_hourglasses:
            return _first_hourglasses(fine, config.hourglasses)
        if not coarse:
            first = _first_hourglasses(fine, config.coarse_hourglasses)
            parts = ("pre_hourglass.", "hourglasses.", "heads.")
            coarse = {
                f"coarse.{name}": value for name, value in first.items() if name.startswith(parts)
            }
        guide = coarse.pop(_COARSE_GUIDE, fine.get("guide.weight"))
        if config.levels > 1 and guide is not None:
            coarse[_COARSE_GUIDE] = guide
        return _first_hourglasses(fine, config.hourglasses) | coarse

    def outputs(self, left: Tensor, right: Tensor) -> VolumeOutputs:
        """Cost volume and scores, see `VolumeModel`."""
        self.check_views(left, right)
        planes, band = self.config.planes, self.config.band_planes
        coarse = self.coarse_scores(left, right)
        guidance = start = None
        if coarse:
            guidance = guidance_from_scores(coarse[-1].detach())
        elif self.config.coarse_pass:
            guidance = _no_guidance(left, planes)
        if band and guidance is not None:
            start = band_start(coarse[-1].detach(), band)
            guidance = cut_band(guidance, start, band)
        volume = self.cost_volume(left, right, planes if start is None else band, start)
        if self.config.dims == 2:
            volume = volume.flatten(1, 2)
        scores = self.aggregate(volume, guidance)
        outputs = VolumeOutputs(scores, volume, self.regression)
        if start is not None:
            outputs.scores = [spread_band(each, start, planes) for each in scores]
            outputs.band = Band(start, band)
        if self.training and self.config.coarse_hourglasses:
            upsampled = [upsample_coarse(each) for each in coarse]
            outputs.coarse = VolumeOutputs(upsampled, None, self.regression)
        return outputs

    def cost_volume(
        self, left: Tensor, right: Tensor, planes: int, start: Tensor | None = None
    ) -> Tensor:
        """Cost volume of a pair.

        Args:
            left: Left views (B, 3, H, W), preprocessed.
            right: Right views, likewise.
            planes: Disparities D at a quarter of the resolution.
            start: First of the disparities at each pixel, (B, H / 4, W / 4); None: 0.

        Returns:
            (B, C, D, H / 4, W / 4).
        """
        band = () if start is None else (start,)
        return cast(Tensor, self.volume(*self.view_features(left, right), planes, *band))

    def view_features(self, left: Tensor, right: Tensor) -> Sequence[Tensor]:
        """Features of both views, (B, C, H / 4, W / 4) each, as the cost volume takes them."""
        if not self.training and left.shape[-2:].numel() <= SMALL_VIEW_PIXELS:
            return cast(Tensor, self.reduction(self.features(torch.cat((left, right))))).chunk(2)
        return [self.reduction(self.features(view)) for view in (left, right)]

    @property
    def coarse_part(self) -> Aggregation:
        """The encoder-decoder of the coarse pass: its own, or the network's."""
        return self.coarse if self.config.coarse_hourglasses else self

    def coarse_scores(self, left: Tensor, right: Tensor) -> list[Tensor]:
        """What the coarse pass at half of the size says (see `nets.coarse_pass`).

        With weights of its own it learns in the same steps as the fine pass. With those of the
        fine pass it is in eval mode, and has no gradient; unguided steps teach it.

        Args:
            left: Left views (B, 3, H, W), preprocessed.
            right: Right views, likewise.

        Returns:
            Scores (B, D / 2, H / 8, W / 8): of all heads where it learns, else the last one's
            alone. An empty list from a network without a coarse pass, and in unguided training
            steps of one whose passes share weights.
        """
        views, planes, levels = (left, right), self.config.planes // 2, self.config.levels
        if self.config.coarse_hourglasses:
            return self._coarse_scores(*views, planes, levels)
        if not levels or (self.training and not self._guided):
            return []
        with torch.no_grad(), eval_mode(self):
            return self._coarse_scores(*views, planes, levels)

    def _coarse_scores(self, left: Tensor, right: Tensor, planes: int, levels: int) -> list[Tensor]:
        """Scores of the pass at half of the size of these views, guided by the coarser ones."""
        left, right, guidance = halve(left), halve(right), None
        if levels > 1 and self.training and not self._guided:
            guidance = _no_guidance(left, planes)
        elif levels > 1:
            with torch.no_grad(), eval_mode(self):
                filled = fill(left), fill(right)
                coarser = self._coarse_scores(*filled, planes // 2, levels - 1)[-1]
            height, width = left.shape[-2] // 4, left.shape[-1] // 4
            guidance = guidance_from_scores(coarser)[..., :height, :width]
        return self.coarse_part.aggregate(self.cost_volume(left, right, planes), guidance)

    def set_step(self, step: int) -> None:
        """Every fourth training step is unguided, so that what guides learns without guidance.

        Unguided is the fine pass where all passes share weights, else the pass at half of the size.
        """
        self._guided = step % UNGUIDED_STEPS != 0

    def zero_residuals(self) -> None:
        """Start every residual branch at zero: the last batch norm's scale in each.

        Fresh weights as the authors draw them amplify rounding errors so much from input to scores
        that in reduced precision the gradients of the first layers are noise. (Not in the paper.)
        """
        for module in self.modules():
            if isinstance(module, ResidualBlock):
                nn.init.zeros_(cast(nn.BatchNorm2d, module.conv2[-1]).weight)
            elif isinstance(module, V2Block) and module.skip:
                nn.init.zeros_(cast(nn.BatchNorm2d, module.conv[-1]).weight)


def _no_guidance(views: Tensor, planes: int) -> Tensor:
    """Zeros as guidance, (B, planes, H / 4, W / 4), so that the guide has a gradient anyhow."""
    batch, _, height, width = views.shape
    return views.new_zeros(batch, planes, height // 4, width // 4)


def _first_hourglasses(state: dict[str, Tensor], count: int) -> dict[str, Tensor]:
    """The tensors of a network that ends after so many hourglasses."""
    kept = {"heads": count + 1, "hourglasses": count}
    parts = {name: name.split(".") for name in state}
    return {
        name: value
        for name, value in state.items()
        if parts[name][0] not in kept or int(parts[name][1]) < kept[parts[name][0]]
    }


MSNET2D = NetConfig(dims=2)
MSNET3D = NetConfig(
    dims=3, channel_reduction=False, cost_volume="groupwise", width=32, v2_relu=False
)
CASCADE3D = replace(MSNET3D, coarse_pass=True, coarse_levels=2, coarse_hourglasses=1, band=16)

# The baselines have standard convolutions and one hourglass (3D: GwcNet-g with one hourglass; 2D:
# width 48, as the printed counts say); v2 blocks that the ablations put into them have t = 2.
_BASELINE: dict[str, Any] = {
    "first_conv": "conv",
    "features": "conv",
    "pre_hourglass": "conv",
    "hourglass": "conv",
    "hourglasses": 1,
    "first_expansion": 2,
    "pre_expansion": 2,
}
BASELINE2D = replace(MSNET2D, **_BASELINE)
BASELINE3D = replace(MSNET3D, **_BASELINE)


def _ablations() -> dict[str, NetConfig]:
    """The rows of the paper's ablation tables by name; some of them are the same network.

    ``table2-<cost volume>``; ``table3a-<features>-<hourglass>`` (2D) and ``table3b-...`` (3D);
    ``appendix2d-<first convolutions>-<pre-hourglass>`` and ``appendix3d-...`` (Tables A1, A2).
    """
    volumes: list[CostVolume] = ["concatenation", "correlation"]
    volumes += [kind for kind in get_args(CostVolume) if kind.startswith("interlaced")]
    rows = {f"table2-{kind}": replace(BASELINE2D, cost_volume=kind) for kind in volumes}
    blocks: tuple[Block, ...] = get_args(Block)
    for table, baseline in (("table3a", BASELINE2D), ("table3b", BASELINE3D)):
        for features in blocks:
            for hourglass in blocks:
                row = replace(baseline, features=features, hourglass=hourglass)
                rows[f"{table}-{features}-{hourglass}"] = row
    for dims, best in (("2d", rows["table3a-v1-v2"]), ("3d", rows["table3b-v1-v2"])):
        for first_conv in ("conv", "v2"):
            for pre_hourglass in ("conv", "v2"):
                row = replace(best, first_conv=first_conv, pre_hourglass=pre_hourglass)
                rows[f"appendix{dims}-{first_conv}-{pre_hourglass}"] = row
    return rows


_INFORMATION: dict[str, Any] = {
    "paper": "Shamsafar et al., MobileStereoNet, WACV 2022",
    "recipes": ("paper-sceneflow", "paper-kitti2015"),
}
_RELEASE = {
    **_INFORMATION,
    "licence": "see the authors' repository; SceneFlow's and KITTI's terms apply to the weights",
    "checkpoints": "cogsys-tuebingen/mobilestereonet on GitHub",
    "trained_on": "SceneFlow finalpass; that and KITTI 2015",
}
register_model(
    "msnet2d",
    config=MSNET2D,
    published={"SceneFlow EPE, px": 1.14, "KITTI 2015 validation D1, %": 2.53},
    **_RELEASE,
)(MobileStereoNet)
# With the skip in its 3D blocks that the paper describes; the release does without.
register_model("msnet3d", config=MSNET3D, **_INFORMATION)(MobileStereoNet)
register_model(
    "msnet3d-cascade",
    config=CASCADE3D,
    paper=f"{_INFORMATION['paper']}; searched in two steps after Gu et al., CVPR 2020",
)(MobileStereoNet)
register_model(
    "msnet3d-authors",
    config=replace(MSNET3D, v2_skip=False),
    published={"SceneFlow EPE, px": 0.8, "KITTI 2015 validation D1, %": 1.59},
    **_RELEASE,
)(MobileStereoNet)
for _name, _config in {"baseline2d": BASELINE2D, "baseline3d": BASELINE3D, **_ablations()}.items():
    register_model(_name, config=_config, **_INFORMATION)(MobileStereoNet)
