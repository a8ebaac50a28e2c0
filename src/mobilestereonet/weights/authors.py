"""The authors' released checkpoints: their key names, and a loader."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from mobilestereonet.nets.msnet import StereoNet
from mobilestereonet.nets.msnet_config import NetConfig

_PREFIXES = (
    (r"features\.first\.(\d)\.0\.", "feature_extraction.firstconv.{0}."),
    (r"features\.stage(\d)\.", "feature_extraction.layer{0}."),
    (r"reduction\.(\d)\.", "preconv11.{0}."),
    (r"volume\.conv\.(\d)\.", "conv3d.{0}."),
    (r"volume\.norm\.(\d)\.", "conv3d.{0}."),
    (r"volume\.squeeze\.", "volume11.0."),
    (r"pre_hourglass\.first\.(\d)\.0\.", "dres0.{0}."),
    (r"pre_hourglass\.second\.(\d)\.0\.", "dres1.{0}."),
    (r"hourglasses\.(\d)\.(?:conv|up)(\d)\.", "encoder_decoder{0}.conv{1}."),
    (r"hourglasses\.(\d)\.redirect(\d)\.", "encoder_decoder{0}.redir{1}."),
    (r"heads\.(\d)\.conv\.", "classif{0}.0."),
    (r"heads\.(\d)\.score\.", "classif{0}.2."),
)


def authors_key(key: str, config: NetConfig) -> str:
    """The authors' name for a key of our state dict, for networks made of v2 blocks."""
    # Their indices count the activations between the layers, ours don't.
    relu = 2 if config.v2_relu else 1
    scale = {"firstconv": relu, "dres0": relu, "dres1": relu, "preconv11": 2, "conv3d": 3}
    for pattern, template in _PREFIXES:
        match = re.match(pattern, key)
        if match is None:
            continue
        name = next((name for name in scale if name in template), "")
        first, *others = (int(group) for group in match.groups() or ("0",))
        first = first * scale.get(name, 1) + (
            "norm" in pattern or template.startswith("encoder_decoder")
        )
        return template.format(first, *others) + key[match.end() :]
    raise AssertionError(f"no rule for {key}")


def _read_state(path: Path) -> dict[str, Tensor]:
    """State dict of a checkpoint, without the authors' wrapper and DataParallel's prefix."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such weights file")
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise InputError(
            f"{path}: not a readable PyTorch checkpoint: {error}".split("\n")[0]
        ) from error
    if isinstance(content, Mapping) and isinstance(content.get("model"), Mapping):
        content = content["model"]
    if not isinstance(content, Mapping) or not all(
        isinstance(key, str) and isinstance(value, Tensor) for key, value in content.items()
    ):
        raise InputError(f"{path}: holds no state dict: expected the authors' {{'model': ...}}")
    return {key.removeprefix("module."): value for key, value in content.items()}


def load_authors_checkpoint(path: str | Path) -> StereoNet:
    """Read a checkpoint of the authors' release.

    Args:
        path: Their file: ``{"model": {"module.<key>": tensor}}``, or the state dict alone, with or
            without the prefix. Read with ``weights_only=True``.

    Returns:
        `msnet2d` or `msnet3d-authors`, told from the keys, in eval mode, float32.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If it is no checkpoint, or its keys or shapes are not those of either network.
    """
    path = Path(path)
    state = _read_state(path)
    name = "msnet2d" if any(key.startswith("preconv11.") for key in state) else "msnet3d-authors"
    net = cast(StereoNet, build_model(name)).eval()
    expected = {authors_key(key, net.config): key for key in net.state_dict()}
    missing, unknown = expected.keys() - state.keys(), state.keys() - expected.keys()
    if missing or unknown:
        example = min(missing or unknown)
        raise InputError(
            f"{path}: not the authors' {name.removesuffix('-authors')}: {len(missing)} keys "
            f"missing, {len(unknown)} unknown, such as {example!r}"
        )
    try:
        net.load_state_dict({ours: state[theirs] for theirs, ours in expected.items()})
    except RuntimeError as error:
        raise InputError(f"{path}: shapes differ from {name}: {error}".replace("\n", " ")) from None
    return net
