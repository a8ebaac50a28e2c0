"""Passes at a half and a quarter of the resolution guide the full one (not in the paper).

A network's receptive field does not grow with the image. Inside a large surface without texture it
must guess; at half resolution the surface's borders are twice as near.

In a cascade (Gu et al., "Cascade Cost Volume for High-Resolution Multi-View Stereo and Stereo
Matching", CVPR 2020) the coarse pass also narrows the search: the fine pass looks at a band of
planes around the coarse answer of each pixel.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

MIN_LOG_PROBABILITY = -8.0
"""Logarithm of a probability at which, and below which, guidance is 0."""

BAND_STEP = 8
"""Bands start at multiples of so many planes, so that most neighbours have the same band.

A convolution takes the i-th plane of a pixel's band with the i-th of its neighbours'. With steps of
4 planes, which is what the hourglasses reduce to one, more pixels are wrong.
"""

BAND_MARGIN = 2
"""Planes at either end of a band whose probability counts less when a band is chosen."""

BAND_WINDOW = 3
"""Pixels of the coarse pass, in height and width, whose probability is averaged."""

AGREEMENT_WINDOW = 9
"""Pixels of the coarse pass, in height and width, that a pixel's band agrees with."""

AGREEMENT_ROUNDS = 4
"""How often bands are chosen anew after those of their neighbours."""

AGREEMENT_SHARPNESS = 8.0
"""Factor of a band's rating before the softmax over the bands."""

OUTSIDE_BAND = -2.0
"""Score of planes outside of a pixel's band, relative to the lowest inside."""


def halve(views: Tensor) -> Tensor:
    """Views (B, 3, H, W), H and W even, at half resolution: means of 2 x 2 pixels."""
    return F.avg_pool2d(views, 2)


def fill(views: Tensor) -> Tensor:
    """Repeat the last row and column of views up to multiples of 32.

    Args:
        views: (B, 3, H, W), H and W multiples of 16.
    """
    height, width = views.shape[-2:]
    more = F.pad(views, (0, 16, 0, 16), mode="replicate")
    return more[..., : height + height % 32, : width + width % 32]


def scaled_log_probability(scores: Tensor) -> Tensor:
    """Log-softmax of scores (B, D, H, W), mapped from -8 and below .. 0 to 0 .. 1; float32."""
    dtype = torch.promote_types(scores.dtype, torch.float32)
    logarithm = torch.log_softmax(scores.to(dtype), dim=1)
    return 1 - logarithm.clamp(min=MIN_LOG_PROBABILITY) / MIN_LOG_PROBABILITY


def guidance_from_scores(scores: Tensor) -> Tensor:
    """Log-probabilities of the coarse pass, upsampled to the planes and pixels of the fine pass.

    Args:
        scores: Scores of the coarse pass, (B, D / 2, H / 8, W / 8): half as many planes cover the
            same range, since disparities halve with the resolution.

    Returns:
        (B, D, H / 4, W / 4), interpolated between 1 (probability 1) and 0 (e^-8 and below), in the
        dtype of the scores.
    """
    return upsample_coarse(scaled_log_probability(scores)).to(scores.dtype)


def upsample_coarse(values: Tensor) -> Tensor:
    """Values of the coarse pass (B, D / 2, H, W) on the planes and pixels of the fine pass."""
    fine = F.interpolate(values.unsqueeze(1), scale_factor=2, mode="trilinear", align_corners=False)
    return fine.squeeze(1)


def band_start(scores: Tensor, planes: int) -> Tensor:
    """Where the band of each pixel starts: around the likeliest disparities of the coarse pass.

    A band's rating is the probability that it holds, on the mean over 3 x 3 pixels of the coarse
    pass; the two outermost planes on either side count a quarter and three quarters. Where several
    bands hold a surface, neighbours choose the same one: a few rounds of mean field inference in a
    Potts model, in which the share of each band among the neighbours is added to its rating
    (Kraehenbuehl and Koltun, NeurIPS 2011, here with 9 x 9 equal neighbours).

    Args:
        scores: Scores of the coarse pass, (B, D / 2, H / 8, W / 8).
        planes: Planes of a band, a multiple of 8 up to D.

    Returns:
        First planes, (B, H / 4, W / 4) int64, multiples of 8 in 0 .. D - planes.
    """
    dtype = torch.promote_types(scores.dtype, torch.float32)
    weights = band_weights(2 * scores.shape[1], planes).to(scores.device, dtype)
    # A plane of the coarse pass counts as the two that it covers.
    weights = F.interpolate(weights[:, None], scale_factor=0.5, mode="linear")[:, 0]
    held = F.conv2d(scores.to(dtype).softmax(dim=1), weights[..., None, None])
    rating = held = _neighbours_mean(held, BAND_WINDOW)
    for _ in range(AGREEMENT_ROUNDS):
        shares = (AGREEMENT_SHARPNESS * rating).softmax(dim=1)
        rating = held + _neighbours_mean(shares, AGREEMENT_WINDOW)
    rating = F.interpolate(rating, scale_factor=2.0, mode="bilinear", align_corners=False)
    return BAND_STEP * rating.argmax(dim=1)


def _neighbours_mean(values: Tensor, window: int) -> Tensor:
    return F.avg_pool2d(values, window, 1, window // 2, count_include_pad=False)


def band_weights(planes: int, band: int) -> Tensor:
    """Weight of each of the planes in each possible band: (number of bands, planes)."""
    inner = [min(1.0, (min(i, band - 1 - i) + 0.5) / BAND_MARGIN) for i in range(band)]
    starts = range(0, planes - band + 1, BAND_STEP)
    rows = [[0.0] * start + inner + [0.0] * (planes - band - start) for start in starts]
    return torch.tensor(rows, dtype=torch.float64)


def cut_band(volume: Tensor, start: Tensor, planes: int) -> Tensor:
    """A band of each pixel's planes: (B, D, H, W) and starts (B, H, W) -> (B, planes, H, W)."""
    offsets = torch.arange(planes, device=start.device)[:, None, None]
    return volume.gather(1, start.unsqueeze(1) + offsets)


def places_in_band(start: Tensor, planes: int) -> Tensor:
    """Place of each plane in each pixel's band: starts (B, H, W) -> (B, D, H, W), < 0 before it."""
    return torch.arange(planes, device=start.device)[:, None, None] - start.unsqueeze(1)


def spread_band(scores: Tensor, start: Tensor, planes: int) -> Tensor:
    """Scores of all planes from those of each pixel's band.

    Args:
        scores: Scores of the band, (B, N, H, W).
        start: First plane of each pixel's band, (B, H, W) int64.
        planes: Planes D of the whole range.

    Returns:
        (B, D, H, W), 2 below the pixel's lowest score outside of its band, without a gradient
        there: that of all planes outside would go to the lowest one alone.
    """
    place = places_in_band(start, planes)
    spread = scores.gather(1, place.clamp(0, scores.shape[1] - 1))
    outside = scores.detach().amin(dim=1, keepdim=True) + OUTSIDE_BAND
    return torch.where((place >= 0) & (place < scores.shape[1]), spread, outside)


class Guide(nn.Conv3d):
    """Adds a 3x3x3 convolution of the guidance, initialised with zeros, to a volume.

    It is a convolution itself, so that its parameter is called ``guide.weight`` in weights files.
    """

    def __init__(self, width: int) -> None:
        super().__init__(1, width, 3, padding=1, bias=False)
        nn.init.zeros_(self.weight)

    def forward(self, x: Tensor, guidance: Tensor) -> Tensor:  # type: ignore[override]
        """(B, width, D, H, W) and guidance (B, D, H, W) -> (B, width, D, H, W)."""
        return x + super().forward(guidance.unsqueeze(1))
