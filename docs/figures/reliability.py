"""Reliability diagram: what the confidence says, against the share of pixels that is right."""

from __future__ import annotations

import json
from pathlib import Path

from boxes import QUIET, save
from matplotlib.figure import Figure

MEASURED = json.loads(Path(__file__).with_name("reliability.json").read_text("utf-8"))

COLOURS = {"msnet2d": "#c4501b", "msnet3d-cascade": "#2f855a", "msnet3d": "#2b6cb0"}
STYLES = {"own": ":", "fitted": "-"}
MIN_SHARE = 0.002
"""Share of the pixels below which a bin's share is left out, for it is too uncertain."""


def draw_reliability(path: Path) -> None:
    """A panel per set; the network's own confidence is dotted, the fitted one on the diagonal."""
    figure = Figure(figsize=(8, 4.2), layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(MEASURED), sharey=True)
    for axes, (title, models) in zip(panels, MEASURED.items(), strict=True):
        axes.plot((0, 1), (0, 1), color=QUIET, lw=0.8)
        for model, curves in models.items():
            for name, curve in curves.items():
                rows = curve["table"]
                least = MIN_SHARE * sum(row["pixels"] for row in rows)
                rows = [row for row in rows if row["pixels"] >= least]
                axes.plot(
                    [row["said"] for row in rows],
                    [row["true"] for row in rows],
                    STYLES[name] + "o",
                    ms=4,
                    color=COLOURS.get(model),
                    label=f"{model}, {name}: error {100 * curve['error']:.1f} %",
                )
        axes.set(title=title, xlabel="confidence", xlim=(0, 1), ylim=(0, 1), aspect="equal")
        axes.legend(loc="lower right", frameon=False, fontsize=7)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("share of pixels within 3 px")
    save(figure, path)
