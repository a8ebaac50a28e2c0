"""What an exported file says about itself."""

from __future__ import annotations

from typing import Any

import mobilestereonet
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel
from mobilestereonet.nets.model import IMAGENET
from mobilestereonet.weights import card, is_embedded


def describe(
    config: Any, model: str, *, embedded: bool, precision: str, size: tuple[int, int] | None
) -> dict[str, str]:
    """Everything that is needed to use a file without this package.

    Args:
        config: The network's config.
        model: What the network is called.
        embedded: Whether the weights are those that come with the package.
        precision: Precision of the file.
        size: Height and width that the file takes; None if it takes any.

    Returns:
        Texts by key.
    """
    known = embedded and is_embedded(model)
    return {
        "model": model,
        "package": f"mobilestereonet {mobilestereonet.__version__}",
        "licence": str(card(model)["licence"]) if known else "that of the weights file",
        "precision": precision,
        "inputs": "left, right: rectified views, float32, (1, 3, height, width)",
        "colour_order": "RGB",
        "value_range": "0..1",
        "normalisation": "inside the graph: (value - mean) / std per channel",
        "mean": _numbers(IMAGENET.mean),
        "std": _numbers(IMAGENET.std),
        "size": "any" if size is None else "{} x {} (height x width)".format(*size),
        "size_multiple": str(config.size_multiple),
        "smallest_width": str(config.max_disparity + config.size_multiple),
        "padding": "above and on the right with the border's pixels; crop the disparity likewise",
        "output": "disparity of the left view, float32, (1, height, width), in pixels",
        "disparity_range": f"0..{config.max_disparity - 1}",
    }


def check_size(net: StereoModel, size: tuple[int, int]) -> None:
    """Check the height and width of an export.

    Raises:
        InputError: If they are no positive multiples of the network's, or the width is too small.
    """
    smallest, multiple = net.max_disparity + net.size_multiple, net.size_multiple
    for name, value, least in zip(("height", "width"), size, (multiple, smallest), strict=True):
        if value < multiple or value % multiple:
            below = max(value // multiple * multiple, least)
            raise InputError(
                f"{name} must be a multiple of {multiple}, got {value}: take {below} or "
                f"{below + multiple}"
            )
    if size[1] < smallest:
        raise InputError(
            f"width must be at least {smallest} for {net.config.max_disparity} disparities, "
            f"got {size[1]}"
        )


def _numbers(values: tuple[float, ...]) -> str:
    return ", ".join(map(str, values))
