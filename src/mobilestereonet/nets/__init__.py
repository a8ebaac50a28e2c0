"""The networks as their papers describe them, behind one interface: `StereoModel`."""

from mobilestereonet.nets import (  # they register their names
    autodispnet,
    crl,
    deeppruner,
    dispnet,
    fast_ds_cs,
    ganet,
    gcnet,
    gwcnet,
    iresnet,
    mccnn,
    msnet,
    psmnet,
)
from mobilestereonet.nets.confidence import ConfidenceFit
from mobilestereonet.nets.model import (
    IMAGENET,
    Prediction,
    Preprocessing,
    StereoModel,
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
from mobilestereonet.nets.volume_model import VolumeModel, VolumeOutputs

__all__ = [
    "IMAGENET",
    "ConfidenceFit",
    "ModelInfo",
    "Prediction",
    "Preprocessing",
    "StereoModel",
    "VolumeModel",
    "VolumeOutputs",
    "autodispnet",
    "build_model",
    "crl",
    "deeppruner",
    "dispnet",
    "fast_ds_cs",
    "free_fields",
    "ganet",
    "gcnet",
    "gwcnet",
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
