"""Weights: the embedded ones and their cards, weights files, the authors' checkpoints."""

from mobilestereonet.weights.authors import load_authors_checkpoint
from mobilestereonet.weights.files import (
    card,
    embedded_models,
    load_pretrained,
    load_weights,
    save_weights,
)

__all__ = [
    "card",
    "embedded_models",
    "load_authors_checkpoint",
    "load_pretrained",
    "load_weights",
    "save_weights",
]
