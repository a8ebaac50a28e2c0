"""Entry points of `torch.hub`: ``torch.hub.load(repository, "msnet3d")``."""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "src"))  # torch.hub does not install the package

from mobilestereonet.nets import StereoModel
from mobilestereonet.weights import create_model

dependencies = ["torch", "safetensors", "lazy_loader"]


def msnet2d(pretrained: bool = True, **overrides: Any) -> StereoModel:
    """2D-MobileStereoNet; in eval mode ``net(left, right)`` is a `Prediction`.

    Args:
        pretrained: With the weights of the package, else with fresh ones.
        **overrides: Values of its config, such as ``max_disparity=256``.
    """
    return create_model("msnet2d", pretrained, **overrides)


def msnet3d(pretrained: bool = True, **overrides: Any) -> StereoModel:
    """3D-MobileStereoNet; see `msnet2d`."""
    return create_model("msnet3d", pretrained, **overrides)


def msnet3d_cascade(pretrained: bool = True, **overrides: Any) -> StereoModel:
    """3D-MobileStereoNet that searches in two steps, the default network; see `msnet2d`."""
    return create_model("msnet3d-cascade", pretrained, **overrides)
