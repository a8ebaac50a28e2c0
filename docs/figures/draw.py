"""Draws the figures of the pages, from the networks' configs, their code and their costs.

python docs/figures/draw.py [FOLDER] [--png]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
from boxes import STYLE
from levels import draw_pareto, draw_speed
from networks import draw_network
from peers import MEASURED, draw_figure_1, draw_measured
from reliability import draw_reliability
from soft_argmax import draw_soft_argmax
from volume import draw_interlacing

IMAGES = Path(__file__).parents[1] / "images"


def draw(folder: Path, ending: str = ".svg") -> None:
    """Write all of them to a folder."""
    with matplotlib.rc_context(STYLE):
        for model in ("msnet2d", "msnet3d"):
            draw_network(model, folder / f"{model}{ending}")
        draw_interlacing(folder / f"interlacing{ending}")
        draw_soft_argmax(folder / f"soft_argmax{ending}")
        draw_speed(folder / f"speed{ending}")
        draw_pareto(folder / f"pareto{ending}")
        draw_reliability(folder / f"reliability{ending}")
        draw_figure_1(folder / f"figure_1{ending}")
        if MEASURED.is_file():
            draw_measured(folder / f"figure_1_measured{ending}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=IMAGES)
    parser.add_argument("--png", action="store_true", help="as PNG, to look at")
    options = parser.parse_args()
    draw(options.folder, ".png" if options.png else ".svg")
