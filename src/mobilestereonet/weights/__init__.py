"""Trained weights: one loader for every source, embedded versions with cards, files to write."""

from mobilestereonet.weights.average import average_weights
from mobilestereonet.weights.embedded import card, embedded_models, embedded_versions, is_embedded
from mobilestereonet.weights.files import save_weights
from mobilestereonet.weights.hub import save_pretrained
from mobilestereonet.weights.load import create_model, load_model
from mobilestereonet.weights.shapes import count_parameters

__all__ = [
    "average_weights",
    "card",
    "count_parameters",
    "create_model",
    "embedded_models",
    "embedded_versions",
    "is_embedded",
    "load_model",
    "save_pretrained",
    "save_weights",
]
