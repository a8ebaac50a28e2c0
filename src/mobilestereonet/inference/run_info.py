"""`RunInfo`: how a result was computed, and how long it took."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RunInfo:
    """How a result was computed, and how long it took.

    Attributes:
        model: Name of the model.
        engine: Name of the engine that ran it.
        precision: Precision that it computed in, such as ``fp32`` or ``bf16``.
        device: Device that it ran on, such as ``cpu``.
        refined: Whether the disparity was refined, see `mobilestereonet.inference.predict`.
        width: Width of the views in px.
        height: Height of the views in px.
        seconds: Time from the checked pair to the maps, in s: a pair's share of its batch.
        quality: Quality level that chose the model and its settings; None where none did.
        scale: Factor of height and width in which the pair was matched.
        shift: Disparity from which the search began, in px.
        confidence_fitted: Whether its confidence is the probability of an error below 3 px, or
            would be.
    """

    model: str
    engine: str
    precision: str
    device: str
    refined: bool
    width: int
    height: int
    seconds: float
    quality: str | None = None
    scale: float = 1.0
    shift: int = 0
    confidence_fitted: bool = False

    def __str__(self) -> str:
        model = f"{self.quality} ({self.model})" if self.quality else self.model
        if self.scale != 1:
            model += f" at {self.scale:g} of the size"
        if self.shift:
            model += f" shifted by {self.shift} px"
        return f"{model} on {self.engine} {self.precision}, {self.width}x{self.height}"
