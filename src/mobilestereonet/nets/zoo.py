"""Named networks: the two of the paper, their baselines and every row of its ablation tables."""

from __future__ import annotations

import difflib
from dataclasses import replace
from typing import Any, get_args

from mobilestereonet.errors import InputError
from mobilestereonet.nets.config import Block, CostVolume, NetConfig
from mobilestereonet.nets.stereo_net import StereoNet

MSNET2D = NetConfig(dims=2)
MSNET3D = NetConfig(
    dims=3, channel_reduction=False, cost_volume="groupwise", width=32, v2_relu=False
)

# The baselines have standard convolutions and one hourglass; v2 blocks that the ablations put
# into them have t = 2 everywhere.
_BASELINE: dict[str, Any] = {
    "first_conv": "conv",
    "features": "conv",
    "pre_hourglass": "conv",
    "hourglass": "conv",
    "hourglasses": 1,
    "first_expansion": 2,
    "pre_expansion": 2,
}
BASELINE2D = replace(MSNET2D, **_BASELINE)
BASELINE3D = replace(MSNET3D, **_BASELINE)


def _named() -> dict[str, NetConfig]:
    models = {
        "msnet2d": MSNET2D,
        "msnet3d": MSNET3D,
        "msnet3d-authors": replace(MSNET3D, v2_skip=False),
        "baseline2d": BASELINE2D,
        "baseline3d": BASELINE3D,
    }
    volumes: list[CostVolume] = ["concatenation", "correlation"]
    volumes += [kind for kind in get_args(CostVolume) if kind.startswith("interlaced")]
    for volume in volumes:
        models[f"table2-{volume}"] = replace(BASELINE2D, cost_volume=volume)
    blocks: tuple[Block, ...] = get_args(Block)
    for table, baseline in (("table3a", BASELINE2D), ("table3b", BASELINE3D)):
        for features in blocks:
            for hourglass in blocks:
                models[f"{table}-{features}-{hourglass}"] = replace(
                    baseline, features=features, hourglass=hourglass
                )
    for dims in ("2d", "3d"):
        best = models["table3a-v1-v2" if dims == "2d" else "table3b-v1-v2"]
        for first_conv in ("conv", "v2"):
            for pre_hourglass in ("conv", "v2"):
                models[f"appendix{dims}-{first_conv}-{pre_hourglass}"] = replace(
                    best,
                    first_conv=first_conv,
                    pre_hourglass=pre_hourglass,
                )
    return models


_MODELS = _named()


def list_models() -> list[str]:
    """Names that `create_model` knows.

    ``table2-<cost volume>``, ``table3a-<features>-<hourglass>`` (2D), ``table3b-...`` (3D) and
    ``appendix2d-<first convolutions>-<pre-hourglass>`` (and 3d) are the rows of the paper's tables.
    """
    return list(_MODELS)


def model_config(name: str, **overrides: Any) -> NetConfig:
    """Config of a named network.

    Args:
        name: One of `list_models`.
        **overrides: Fields of `NetConfig` to change.

    Raises:
        InputError: If the name or a field is unknown, or a value is refused.
    """
    if name not in _MODELS:
        near = difflib.get_close_matches(name, _MODELS, n=3) or ["msnet2d", "msnet3d"]
        raise InputError(
            f"unknown model {name!r}: did you mean {', '.join(near)}? `msnet models` lists all"
        )
    try:
        return replace(_MODELS[name], **overrides)
    except TypeError as error:
        raise InputError(f"model {name}: {error}") from None


def is_model(config: NetConfig, name: str) -> bool:
    """Whether a config is a named model's, whatever its range, estimator and coarse pass.

    Raises:
        InputError: If the name is unknown.
    """
    named = model_config(name)
    return named == replace(
        config, max_disparity=named.max_disparity, estimator="mean", coarse_pass=False
    )


def model_name(config: NetConfig) -> str:
    """The first named model that a config is, see `is_model`; "custom" if it is none."""
    return next((name for name in _MODELS if is_model(config, name)), "custom")


def create_model(name: str, **overrides: Any) -> StereoNet:
    """A named network with fresh weights, in training mode.

    Args:
        name: One of `list_models`.
        **overrides: Fields of `NetConfig` to change, such as ``max_disparity=256``.

    Raises:
        InputError: If the name or a field is unknown, or a value is refused.
    """
    return StereoNet(model_config(name, **overrides))
