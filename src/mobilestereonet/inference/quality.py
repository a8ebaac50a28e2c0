"""Quality levels: named choices of network, planes, hourglasses and size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mobilestereonet.errors import InputError

DEFAULT_QUALITY = "balanced"


@dataclass(frozen=True)
class Quality:
    """A trade between error and time, with weights that come with the package.

    Attributes:
        model: Name of the weights.
        config: Values of the network's config in place of the weights' own.
        scale: Factor of the views' height and width, see `ScaledEngine`.
    """

    model: str
    config: Mapping[str, Any] = field(default_factory=dict, hash=False)
    scale: float = 1.0


QUALITIES = {
    "fast": Quality("msnet3d-cascade", {"coarse_levels": 1}, scale=0.75),
    "balanced": Quality("msnet3d-cascade"),
    "best": Quality("msnet3d"),
}
"""Quality levels by name, from the least time to the least error."""

DEFAULT_MODEL = QUALITIES[DEFAULT_QUALITY].model
"""The network of the default quality."""


def find_quality(name: str) -> Quality:
    """A quality level.

    Raises:
        InputError: If there is none of that name.
    """
    if name not in QUALITIES:
        raise InputError(f"quality must be one of {', '.join(QUALITIES)}, got {name!r}")
    return QUALITIES[name]
