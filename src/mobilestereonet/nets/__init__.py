"""The networks as their papers describe them, behind one interface: `StereoModel`."""

from mobilestereonet.nets import (  # they register their names
    autodispnet,
    crl,
    dispnet,
    iresnet,
    mccnn,
    msnet,
    psmnet,
)
from mobilestereonet.nets.model import (
    IMAGENET,
    Prediction,
    Preprocessing,
    StereoModel,
    VolumeModel,
    VolumeOutputs,
    trained_pixels,
)
from mobilestereonet.nets.registry import (
    ModelInfo,
    build_model,
    free_fields,
    is_model,
    list_models,
    model_config,
    model_info,
    model_name,
    register_model,
)

__all__ = [
    "IMAGENET",
    "ModelInfo",
    "Prediction",
    "Preprocessing",
    "StereoModel",
    "VolumeModel",
    "VolumeOutputs",
    "autodispnet",
    "build_model",
    "crl",
    "dispnet",
    "free_fields",
    "iresnet",
    "is_model",
    "list_models",
    "mccnn",
    "model_config",
    "model_info",
    "model_name",
    "msnet",
    "psmnet",
    "register_model",
    "trained_pixels",
]
