"""Metadata of exported files."""

from __future__ import annotations

import json
from dataclasses import asdict

import mobilestereonet
from mobilestereonet.engines.tracing import Size
from mobilestereonet.errors import InputError
from mobilestereonet.nets.confidence import MIN_PROBABILITY
from mobilestereonet.nets.model import StereoModel
from mobilestereonet.nets.volume_model import VolumeModel
from mobilestereonet.weights import card, is_embedded
from mobilestereonet.weights.files import CONFIDENCE_FIT


def describe(
    net: StereoModel,
    model: str,
    *,
    embedded: bool,
    precision: str,
    size: Size | None,
    min_width: int,
    refined: bool = False,
) -> dict[str, str]:
    """Everything that is needed to use a file without this package.

    Args:
        net: The network.
        model: Name of the network.
        embedded: Whether the weights are those that come with the package.
        precision: Number format of the file.
        size: Height and width that the file takes; None if it takes any.
        min_width: Smallest width in pixels that the network's graph takes.
        refined: Whether the graph refines the disparity.

    Returns:
        Texts by key.
    """
    known = embedded and is_embedded(model)
    preprocessing = net.preprocessing
    confidence = {
        "confidence": "the network's own: probability that the disparity is within 2 px of its "
        "estimate, float32, (1, height, width)"
    }
    if net.confidence_fit is not None:
        confidence[CONFIDENCE_FIT] = json.dumps(asdict(net.confidence_fit))
        confidence["confidence_probability"] = (
            "of an error below 3 px: sigmoid(rise * log(c) - fall * log(1 - c) + offset), with c "
            f"clamped to {MIN_PROBABILITY:g}..{1 - MIN_PROBABILITY:g}"
        )
    return {
        "model": model,
        "package": f"mobilestereonet {mobilestereonet.__version__}",
        "licence": str(card(model)["licence"]) if known else "that of the weights file",
        "precision": precision,
        "inputs": "left, right: rectified views, float32, (1, 3, height, width)",
        "colour_order": "RGB",
        "value_range": "0..1",
        "normalisation": "inside the graph: (scale * value - mean) / std per channel"
        + (", then by each image's own mean and std" if preprocessing.per_image else ""),
        "scale": str(preprocessing.scale),
        "mean": _numbers(preprocessing.mean),
        "std": _numbers(preprocessing.std),
        "size": "any" if size is None else "{} x {} (height x width)".format(*size),
        "size_multiple": str(net.size_multiple),
        "smallest_width": str(min_width),
        "padding": "above and on the right with the border's pixels; crop the disparity likewise",
        "refinement": "inside the graph" if refined else "none",
        "output": "disparity of the left view, float32, (1, height, width), in pixels",
        "disparity_range": f"0..{net.max_disparity - 1}",
        **(confidence if isinstance(net, VolumeModel) else {}),
    }


def check_size(net: StereoModel, size: Size, min_width: int) -> None:
    """Check a height and width for a network.

    Args:
        net: The network.
        size: Height and width.
        min_width: Smallest width of its graph.

    Raises:
        InputError: If they are no positive multiples of the network's, or the width is too small.
    """
    multiple = net.size_multiple
    min_width = max(min_width, net.min_side)
    for name, value, least in zip(("height", "width"), size, (multiple, min_width), strict=True):
        if value < multiple or value % multiple:
            below = max(value // multiple * multiple, least)
            raise InputError(
                f"{name} must be a multiple of {multiple}, got {value}: take {below} or "
                f"{below + multiple}"
            )
    if size[0] < net.min_side:
        raise InputError(f"height must be at least {net.min_side}, got {size[0]}")
    if size[1] < min_width:
        raise InputError(
            f"width must be at least {min_width} for {net.max_disparity} disparities, got {size[1]}"
        )


def _numbers(values: tuple[float, ...]) -> str:
    return ", ".join(map(str, values))
