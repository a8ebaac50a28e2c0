"""Sub-pixel refinement: fits nearly right disparities to the views, with nothing learned.

The networks score every fourth disparity, and their answers lean towards some fractions between
these planes. The views at full resolution tell better: warped by the right disparity, the right
view would be the left one, and what still differs, over the gradient, is how far to go. This is
Lucas and Kanade's registration (IJCAI 1981) along the row, with the mean gradient of both views
(Malis, ICRA 2004), for one shift per window. Within a window every pixel is warped by its own
disparity, so that slanted surfaces and edges keep their shapes.

Everything runs on the device of the disparity.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

MAX_SHIFT_PX = 1.5
"""Largest change of a disparity: the fit looks no further."""

STEPS = 3
"""Gauss-Newton steps."""

CONTRAST_WINDOW_PX = 7
"""Side of the window in which brightness is brought to mean 0 and standard deviation 1; odd."""

SENSOR_NOISE = 0.01
"""Standard deviation of brightness (0..1) that is noise: no contrast is raised above it."""

MISMATCH = 1.0
"""Difference of the normalised views at which a pixel's weight has fallen to a quarter."""

PRIOR = 0.01
"""Weight of staying at 0 px, as a mean squared gradient: the fit moves where texture exceeds it."""

STRIDE_PX = 4
"""Distance of the windows that share a shift; between their centres it is interpolated."""

WINDOW_PX = 3 * STRIDE_PX
"""Side of the windows that share a shift."""


def fit_subpixel(disparity: Tensor, left: Tensor, right: Tensor) -> Tensor:
    """Fit disparities to the views, each within `MAX_SHIFT_PX` of what it was.

    Pixels that do not match, as occluded ones, hardly count; without texture nothing changes.

    Args:
        disparity: Disparity of the left views in px, (B, H, W) float32.
        left: Left views, (B, 3, H, W), RGB in 0..1, on the same device.
        right: Right views, likewise.

    Returns:
        Disparity in px, (B, H, W), on that device.
    """
    left, right = normalise_contrast(left), normalise_contrast(right)
    left_gradient = row_gradient(left)
    right_maps = torch.cat((right, row_gradient(right)), dim=1)
    shift = torch.zeros_like(disparity)
    for _ in range(STEPS):
        warped, inside = _warp(right_maps, disparity + shift)
        sums = _window_means(weighted_products(left, left_gradient, warped, inside, shift))
        shift = _between_windows(sums[:, :1] / (sums[:, 1:] + PRIOR), *disparity.shape[-2:])
        shift = shift.clamp(-MAX_SHIFT_PX, MAX_SHIFT_PX)
    return (disparity + shift).clamp_min(0)


def normalise_contrast(views: Tensor) -> Tensor:
    """Brightness (B, 1, H, W) of RGB views, locally of mean 0 and standard deviation 1."""
    grey = views.mean(dim=1, keepdim=True)
    moments = torch.cat((grey, grey.square()), dim=1)
    moments = F.pad(moments, (CONTRAST_WINDOW_PX // 2,) * 4, mode="replicate")
    for dim in (-1, -2):
        moments = moments.unfold(dim, CONTRAST_WINDOW_PX, 1).mean(dim=-1)
    mean, square = moments.split(1, dim=1)
    variance = (square - mean.square()).clamp(min=0)
    normalised: Tensor = (grey - mean) / (variance + SENSOR_NOISE**2).sqrt()
    return normalised


def weighted_products(
    left: Tensor, left_gradient: Tensor, warped: Tensor, inside: Tensor, shift: Tensor
) -> Tensor:
    """What a least-squares step sums up over a window, mismatches weighing less.

    Args:
        left: Normalised left view, (B, 1, H, W).
        left_gradient: Its gradient along the rows, likewise.
        warped: The right view's value and gradient where the matches are, (B, 2, H, W).
        inside: Whether these are inside of the right view, (B, 1, H, W).
        shift: Shift of the disparity so far, (B, H, W) in px.

    Returns:
        Gradient times target, and gradient squared, both weighted, (B, 2, H, W).
    """
    difference = warped[:, :1] - left
    gradient = (left_gradient + warped[:, 1:]) / 2
    weighted = inside * gradient / (1 + (difference / MISMATCH).square()).square()
    # One more px of disparity changes the difference by minus the gradient.
    target = difference + gradient * shift.unsqueeze(1)
    return torch.cat((weighted * target, weighted * gradient), dim=1)


def row_gradient(image: Tensor) -> Tensor:
    """Central differences along the rows of (B, 1, H, W), per px."""
    padded = F.pad(image, (1, 1, 0, 0), mode="replicate")
    return (padded[..., 2:] - padded[..., :-2]) / 2


def column_gradient(image: Tensor) -> Tensor:
    """Central differences along the columns of (B, 1, H, W), per px."""
    return row_gradient(image.mT).mT


def _warp(maps: Tensor, disparity: Tensor) -> tuple[Tensor, Tensor]:
    """Maps of the right view where the left pixels' matches are, and whether these are inside.

    Args:
        maps: (B, C, H, W).
        disparity: (B, H, W) in px.

    Returns:
        (B, C, H, W), and (B, 1, H, W) bool.
    """
    height, width = disparity.shape[-2:]
    column = torch.arange(width, dtype=disparity.dtype, device=disparity.device) - disparity
    row = torch.linspace(-1, 1, height, dtype=disparity.dtype, device=disparity.device)
    inside = ((column >= 0) & (column <= width - 1)).unsqueeze(1)
    column = 2 * column.nan_to_num().clamp(0, width - 1) / (width - 1) - 1
    grid = torch.stack((column, row[:, None].expand_as(column)), dim=-1)
    return F.grid_sample(maps, grid, align_corners=True), inside


def _window_means(maps: Tensor) -> Tensor:
    """Means of (B, C, H, W) over the windows: (B, C, H / 4, W / 4), rounded up."""
    padding = (WINDOW_PX - STRIDE_PX) // 2
    return F.avg_pool2d(
        maps, WINDOW_PX, STRIDE_PX, padding, ceil_mode=True, count_include_pad=False
    )


def _between_windows(values: Tensor, height: int, width: int) -> Tensor:
    """One value per window, (B, 1, H / 4, W / 4), interpolated to all pixels, (B, H, W)."""
    fine = F.interpolate(values, scale_factor=float(STRIDE_PX), mode="bilinear")
    return fine[:, 0, :height, :width]
