"""Example pairs: a real one and rendered ones."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.resources import files

import numpy as np
from PIL import Image

from mobilestereonet.data.images import image_to_tensor
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.data.sample import Calibration, StereoSample


def examples() -> list[StereoSample]:
    """Read the examples, each with its calibration and a name to show.

    The first one is Middlebury's Motorcycle from scikit-image's wheel; the others are procedural
    scenes, which benchmarks/web_examples.py rendered.
    """
    pairs = files(__package__).joinpath("pairs")
    cameras = json.loads(pairs.joinpath("cameras.json").read_text("utf-8"))
    found = [replace(motorcycle(), name="Motorcycle")]
    for name, numbers in cameras.items():
        with pairs.joinpath(f"{name}.webp").open("rb") as file:
            views = np.split(np.asarray(Image.open(file).convert("RGB")), 2, axis=1)
        left, right = map(image_to_tensor, views)
        found.append(StereoSample(left, right, calibration=Calibration(**numbers), name=name))
    return found
