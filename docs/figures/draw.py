"""Draws the diagrams of docs/how-it-works.md, from the networks' configs and their own code.

python docs/figures/draw.py [FOLDER] [--png]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
from boxes import STYLE
from networks import draw_network
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=IMAGES)
    parser.add_argument("--png", action="store_true", help="as PNG, to look at")
    options = parser.parse_args()
    draw(options.folder, ".png" if options.png else ".svg")
