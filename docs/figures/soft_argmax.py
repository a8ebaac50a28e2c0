"""Why 48 scores are enough: the fine scores are straight lines between the coarse ones."""

from __future__ import annotations

from pathlib import Path

import torch
import torch.nn.functional as F
from boxes import INK, QUIET, save
from matplotlib.figure import Figure

from mobilestereonet.nets.soft_argmax import SoftArgmax

_SCORES = (0.2, 0.9, 3.4, 2.6, 0.8, 0.1)


def draw_soft_argmax(path: Path) -> None:
    """Coarse and fine scores of six planes, their softmax, and the closed form's disparity.

    Args:
        path: Picture to write.
    """
    coarse = torch.tensor(_SCORES)
    fine = F.interpolate(coarse[None, None], scale_factor=4, mode="linear")[0, 0]
    probability = fine.softmax(0).numpy()
    disparity = float(SoftArgmax(4)(coarse[None, :, None, None])[0, 0, 0])
    figure = Figure(figsize=(7.6, 4.3), facecolor="white")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    bins = range(len(fine))
    places = [4 * plane + 1.5 for plane in range(len(coarse))]
    above.plot(places, _SCORES, "o-", color="#2b6cb0", ms=8, lw=1, label="scores of 6 planes")
    above.plot(bins, fine.numpy(), ".", color="#c05621", label="24 upsampled scores")
    for plane in range(len(coarse) - 1):
        above.axvspan(4 * plane + 1.5, 4 * plane + 5.5, color="#e4e7eb" if plane % 2 else "white")
    above.set_ylabel("score")
    above.legend(frameon=False, loc="upper right")
    below.bar(bins, probability, color="#f6ad55", width=0.8)
    below.axvline(disparity, color=INK, lw=1)
    below.text(disparity + 0.3, float(probability.max()), f"disparity {disparity:.2f} px", va="top")
    below.set(xlabel="disparity, px", ylabel="probability", xticks=range(0, len(fine), 2))
    for axes in (above, below):
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(colors=QUIET)
    figure.tight_layout()
    save(figure, path)
