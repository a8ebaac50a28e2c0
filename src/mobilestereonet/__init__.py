"""Lightweight deep networks for stereo matching (MobileStereoNet)."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.data.sample import Calibration, StereoSample
    from mobilestereonet.inference import StereoMatcher, StereoResult
    from mobilestereonet.nets import StereoModel, list_models, register_model
    from mobilestereonet.nets.msnet import StereoNet
    from mobilestereonet.nets.msnet_config import NetConfig
    from mobilestereonet.weights import create_model, load_model, save_weights

__version__ = "0.1.0"

__all__ = [
    "Calibration",
    "InputError",
    "NetConfig",
    "StereoMatcher",
    "StereoModel",
    "StereoNet",
    "StereoResult",
    "StereoSample",
    "create_model",
    "list_models",
    "load_model",
    "register_model",
    "save_weights",
]

# Loaded at first use: `msnet --help` does not wait for torch.
_ROOMS = {
    "data.sample": ("Calibration", "StereoSample"),
    "inference": ("StereoMatcher", "StereoResult"),
    "nets": ("StereoModel", "list_models", "register_model"),
    "nets.msnet": ("StereoNet",),
    "nets.msnet_config": ("NetConfig",),
    "weights": ("create_model", "load_model", "save_weights"),
}


def __getattr__(name: str) -> Any:
    for room, names in _ROOMS.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{room}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
