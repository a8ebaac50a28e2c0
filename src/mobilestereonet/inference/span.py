"""`Span`: where most values of a map lie."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

SPAN_PERCENTILES = (1, 50, 99)


@dataclass(frozen=True)
class Span:
    """Median of a map's known values, and the range without the lowest and the highest percent.

    Attributes:
        low: Percentile 1.
        median: Percentile 50.
        high: Percentile 99.
    """

    low: float
    median: float
    high: float

    @classmethod
    def of(cls, known: NDArray[Any]) -> Span | None:
        """The span of the known values of a map, (N,); None if there are none."""
        if not known.size:
            return None
        return cls(*(float(value) for value in np.percentile(known, SPAN_PERCENTILES)))

    def within(self, unit: str) -> str:
        """In words, such as "8.4 to 60.9 px (median 24.1)"."""
        return f"{self.low:.4g} to {self.high:.4g} {unit} (median {self.median:.4g})"
