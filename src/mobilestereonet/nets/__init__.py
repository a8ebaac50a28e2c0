"""The networks: configs, blocks, cost volumes, hourglasses and their assembly."""

from mobilestereonet.nets.config import NetConfig
from mobilestereonet.nets.stereo_net import StereoNet
from mobilestereonet.nets.zoo import create_model, is_model, list_models, model_config, model_name

__all__ = [
    "NetConfig",
    "StereoNet",
    "create_model",
    "is_model",
    "list_models",
    "model_config",
    "model_name",
]
