"""Render the example pairs of `msnet web` into the package: python benchmarks/web_examples.py."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

import mobilestereonet.web
from mobilestereonet.data.images import to_picture
from mobilestereonet.scenes import ProceduralScenes, SceneConfig

CONFIG = SceneConfig(
    height=320,
    width=512,
    max_disparity=96,
    min_disparity=32,
    kinds={"street": 1, "room": 1, "table": 1, "park": 1},
    noise_textures=32,
)
SCENES = {"Street": 0, "Room": 3, "Table": 5, "Park": 9, "Traffic": 11}
QUALITY = 90
"""Of WebP, of 100."""


def main() -> None:
    """Write one side-by-side picture per scene, and the calibrations."""
    folder = Path(mobilestereonet.web.__file__).parent / "pairs"
    folder.mkdir(exist_ok=True)
    scenes = ProceduralScenes(CONFIG)
    cameras = {}
    for name, index in SCENES.items():
        sample = scenes[index]
        both = np.hstack([to_picture(view) for view in (sample.left, sample.right)])
        Image.fromarray(both).save(folder / f"{name}.webp", quality=QUALITY, method=6)
        known = sample.calibration
        assert known is not None  # rendered scenes have one
        cameras[name] = {key: getattr(known, key) for key in ("focal", "baseline", "doffs")}
    (folder / "cameras.json").write_text(json.dumps(cameras, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
