"""`NetConfig`: a network of the MobileStereoNet family as data."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar, Literal, get_args

from mobilestereonet.errors import InputError
from mobilestereonet.nets.blocks import Block
from mobilestereonet.nets.coarse_pass import BAND_STEP
from mobilestereonet.nets.cost_volumes import REDUCED_CHANNELS, CostVolume
from mobilestereonet.nets.soft_argmax import Estimator

FEATURE_CHANNELS = 320
"""Channels of the feature extraction: stages 2, 3 and 4 concatenated (64 + 128 + 128)."""


@dataclass(frozen=True, kw_only=True)
class NetConfig:
    """A network of the family, such as one row of the paper's tables.

    Every field but those of the coarse pass, which is for 3D networks, means the same in 2D and 3D.

    Attributes:
        dims: 2 or 3, the dimensions of the encoder-decoder's convolutions.
        first_conv: The three first convolutions: 3x3 convolutions ("conv") or v2 blocks ("v2").
        features: The residual stages: standard convolutions, v1 blocks in place of each 3x3
            convolution, or one v2 block in place of each residual block.
        channel_reduction: 1x1 convolutions from 320 to 32 channels per view before the volume.
        cost_volume: "interlaced-i" (i channels of each view per kernel), "correlation",
            "concatenation" or "groupwise" (correlation in groups).
        groups: Groups of the group-wise correlation; other volumes ignore it.
        pre_hourglass: Blocks before the hourglasses, "conv" or "v2".
        hourglass: Blocks of the hourglasses, "conv", "v1" or "v2".
        hourglasses: Number of stacked hourglasses, at least 1.
        width: Channels of the pre-hourglass and of the hourglasses at their full resolution.
        first_expansion: Expansion factor t of v2 blocks in the first convolutions.
        features_expansion: Expansion factor of v2 blocks in the residual stages.
        pre_expansion: Expansion factor of v2 blocks in the pre-hourglass.
        hourglass_expansion: Expansion factor of v2 blocks in the hourglasses.
        max_disparity: Disparities 0 .. max_disparity - 1 are searched; a multiple of 16 in 32..512.
        v2_skip: v2 blocks of the pre-hourglass and the hourglasses add their input where shapes
            allow it. The paper describes it; the authors' released 3D weights do without.
            (Those of the features always add it, in both of the authors' networks.)
        v2_relu: A ReLU after each v2 block of the first convolutions and of the pre-hourglass
            (but its last), as in the authors' 2D network.
        estimator: How a disparity comes from its distribution: "mean" as in the paper, "mode" for
            sharp edges (see `nets.soft_argmax`). In training every head takes the mean.
        coarse_pass: A first pass at half of the size guides the second (see `nets.coarse_pass`):
            for large surfaces without texture. Not in the paper; 3D alone.
        coarse_levels: Coarse passes: 1 at a half of the size, 2 at a half and at a quarter, and so
            on; each guides the next finer one. Where the planes cannot be halved so often there
            are fewer, see `levels`.
        coarse_hourglasses: Hourglasses of an encoder-decoder of the first pass alone; 0: it has
            the weights of the second one.
        band: Planes that the second pass searches around each pixel's answer of the first, a
            multiple of 8; 0: all. For correlation volumes, with ``coarse_hourglasses``.
    """

    dims: Literal[2, 3]
    first_conv: Literal["conv", "v2"] = "v2"
    features: Block = "v1"
    channel_reduction: bool = True
    cost_volume: CostVolume = "interlaced-4"
    groups: int = 40
    pre_hourglass: Literal["conv", "v2"] = "v2"
    hourglass: Block = "v2"
    hourglasses: int = 3
    width: int = 48
    first_expansion: int = 3
    features_expansion: int = 2
    pre_expansion: int = 3
    hourglass_expansion: int = 2
    max_disparity: int = 192
    v2_skip: bool = True
    v2_relu: bool = True
    estimator: Estimator = "mean"
    coarse_pass: bool = False
    coarse_levels: int = 1
    coarse_hourglasses: int = 0
    band: int = 0

    free_fields: ClassVar[tuple[str, ...]] = (
        "max_disparity",
        "estimator",
        "coarse_pass",
        "coarse_levels",
        "coarse_hourglasses",
        "band",
    )
    """Fields that do not change what a network is called, see `model_name`."""

    def __post_init__(self) -> None:
        choices: dict[str, tuple[object, ...]] = {
            "dims": (2, 3),
            "first_conv": ("conv", "v2"),
            "features": get_args(Block),
            "cost_volume": get_args(CostVolume),
            "pre_hourglass": ("conv", "v2"),
            "hourglass": get_args(Block),
            "estimator": get_args(Estimator),
        }
        for name, allowed in choices.items():
            value = getattr(self, name)
            if value not in allowed:
                listed = ", ".join(map(str, allowed))
                raise InputError(f"{name} must be one of {listed}, got {value!r}")
        positive = ("groups", "hourglasses", "width", "first_expansion", "features_expansion")
        for name in (*positive, "pre_expansion", "hourglass_expansion", "coarse_levels"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.max_disparity % 16 or not 32 <= self.max_disparity <= 512:
            raise InputError(
                f"max_disparity must be a multiple of 16 in 32..512, got {self.max_disparity}"
            )
        if self.coarse_pass and (self.dims == 2 or self.max_disparity % 32):
            raise InputError(
                "coarse_pass needs dims=3 and max_disparity a multiple of 32, "
                f"got dims={self.dims} and {self.max_disparity}"
            )
        if self.coarse_levels > 1 and not self.coarse_pass:
            raise InputError(
                f"coarse_levels={self.coarse_levels} needs coarse_pass=true; without a coarse pass "
                "it is 1"
            )
        if self.coarse_hourglasses < 0 or (self.coarse_hourglasses and not self.coarse_pass):
            raise InputError(
                "coarse_hourglasses must be 0, or at least 1 in a network with coarse_pass, "
                f"got {self.coarse_hourglasses}"
            )
        if self.band and (
            not self.coarse_hourglasses or self.learns_volume or self.band % BAND_STEP
        ):
            raise InputError(
                "band must be 0, or a multiple of 8 in a network with a correlation "
                f"volume and coarse_hourglasses from 1 on, got {self.band} with "
                f"{self.cost_volume} and {self.coarse_hourglasses}"
            )
        if self.cost_volume == "groupwise" and self.volume_input % self.groups:
            raise InputError(
                f"groups must divide the {self.volume_input} channels of a view, got {self.groups}"
            )
        if self.learns_volume and not self.channel_reduction:
            raise InputError(
                f"cost volume {self.cost_volume} takes {REDUCED_CHANNELS} channels per view: "
                "set channel_reduction=True"
            )

    def differences(self, other: NetConfig) -> str:
        """Values that another config does not share, in words."""
        pairs = [(f.name, getattr(self, f.name), getattr(other, f.name)) for f in fields(self)]
        return ", ".join(f"{name} {own}, not {its}" for name, own, its in pairs if own != its)

    @property
    def planes(self) -> int:
        """Disparities of the cost volume, at a quarter of the resolution."""
        return self.max_disparity // 4

    @property
    def levels(self) -> int:
        """Coarse passes: at most ``coarse_levels``, each with a multiple of 4 planes.

        The hourglasses halve the planes twice.
        """
        if not self.coarse_pass:
            return 0
        possible = range(1, self.coarse_levels + 1)
        return max(level for level in possible if self.planes % (4 << level) == 0)

    @property
    def band_planes(self) -> int:
        """Planes of a pixel's band, at most all; 0: there are no bands."""
        return min(self.band, self.planes)

    @property
    def size_multiple(self) -> int:
        """Height and width of an input are multiples of this."""
        return 32 if self.coarse_pass else 16

    @property
    def learns_volume(self) -> bool:
        """Whether the cost volume has weights: interlaced and concatenation."""
        return self.cost_volume not in ("correlation", "groupwise")

    @property
    def volume_input(self) -> int:
        """Channels per view that enter the cost volume."""
        return REDUCED_CHANNELS if self.channel_reduction else FEATURE_CHANNELS

    @property
    def volume_channels(self) -> int:
        """Channels of the cost volume per disparity."""
        return self.groups if self.cost_volume == "groupwise" else 1
