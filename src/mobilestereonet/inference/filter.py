"""Filter of everything metric: which pixels have a depth in maps, points, meshes and messages."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mobilestereonet.errors import InputError


@dataclass(frozen=True)
class MetricFilter:
    """What a pixel must fulfil to have a depth; what fails is unknown everywhere alike.

    The left-right check, where the matcher makes it, always counts.

    Attributes:
        min_confidence: Less confident pixels fail, 0..1.
        max_depth: Farther ones fail, in metres.
        edges: Whether pixels at depth edges, which mix two surfaces (see `depth_edges`), pass;
            None: in maps they do, as points they do not.

    Raises:
        InputError: If a limit is none.
    """

    min_confidence: float = 0.0
    max_depth: float = math.inf
    edges: bool | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.min_confidence <= 1:
            raise InputError(f"min_confidence must be in 0..1, got {self.min_confidence}")
        if not self.max_depth > 0:
            raise InputError(f"max_depth must be positive, in metres, got {self.max_depth}")

    def stricter(self, min_confidence: float, max_depth: float, edges: bool) -> MetricFilter:
        """The filter with limits of one call on top; ``edges`` where the filter leaves it open."""
        return MetricFilter(
            max(self.min_confidence, min_confidence),
            min(self.max_depth, max_depth),
            edges if self.edges is None else self.edges,
        )


NO_LIMITS = MetricFilter()
"""What the left-right check does not find passes."""
