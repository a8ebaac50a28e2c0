"""Weights: the embedded ones and their cards, weights files, the authors' checkpoints."""

from mobilestereonet.weights.authors import load_authors_checkpoint
from mobilestereonet.weights.average import average_weights
from mobilestereonet.weights.files import (
    card,
    embedded_models,
    load_pretrained,
    load_weights,
    open_weights,
    save_weights,
)

__all__ = [
    "average_weights",
    "card",
    "embedded_models",
    "load_authors_checkpoint",
    "load_pretrained",
    "load_weights",
    "open_weights",
    "save_weights",
]
