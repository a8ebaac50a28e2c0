"""Example pairs: photographs whose licences allow it, and rendered scenes."""

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
    """Read the examples, each with a name to show, and its calibration if that is known.

    Middlebury's Motorcycle comes from scikit-image's wheel; benchmarks/web_examples.py says where
    the others are from.
    """
    pairs = files(__package__).joinpath("pairs")
    cameras = json.loads(pairs.joinpath("cameras.json").read_text("utf-8"))
    found = [replace(motorcycle(), name="Motorcycle")]
    for name, numbers in cameras.items():
        with pairs.joinpath(f"{name}.webp").open("rb") as file:
            views = np.split(np.asarray(Image.open(file).convert("RGB")), 2, axis=1)
        left, right = map(image_to_tensor, views)
        known = Calibration(**numbers) if numbers else None
        found.append(StereoSample(left, right, calibration=known, name=name))
    return found
