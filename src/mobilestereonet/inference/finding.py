"""`Finding`: what a check says about a pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Level: TypeAlias = Literal["good", "fixed", "warning", "problem", "unknown"]


@dataclass(frozen=True)
class Finding:
    """Result of one check of a pair: level, text and advice.

    Attributes:
        check: What was looked at, such as ``rectified``.
        level: ``good``, ``fixed`` (it was put right), ``warning`` (worse results), ``problem`` (no
            sensible result) or ``unknown`` (it could not be told).
        text: What was found, with the figure.
        advice: What to do; empty where nothing is to be done.
    """

    check: str
    level: Level
    text: str
    advice: str = ""

    def __str__(self) -> str:
        return f"{self.check}: {self.text}" + (f"; {self.advice}" if self.advice else "")
