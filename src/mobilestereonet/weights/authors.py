"""The authors' released checkpoints: their names of tensors, translated to ours."""

from __future__ import annotations

import re
from typing import Any

from mobilestereonet.errors import InputError
from mobilestereonet.nets import model_config
from mobilestereonet.weights.files import COUNTER, WeightsFile
from mobilestereonet.weights.shapes import registered_shapes

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
_MARK = "feature_extraction."
"""Names in the authors' checkpoints begin with it, those in ours never hold it."""


def authors_key(key: str, config: Any) -> str:
    """The authors' name for a name in our state dict, for networks made of v2 blocks.

    Args:
        key: Our name.
        config: Config of an MSNet network.
    """
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


def from_authors(weights: WeightsFile) -> WeightsFile:
    """Translate a checkpoint of MobileStereoNet's authors; any other is given back as it is.

    The authors' file is ``{"model": {"module.<name>": tensor}}``, or the state dict alone, with or
    without the prefix: `msnet2d` or `msnet3d-authors`, told from the names.

    Raises:
        InputError: If most names are the authors', but not all, or there are more.
    """
    prefix = next((key.partition(_MARK)[0] for key in weights.state if _MARK in key), None)
    if prefix is None:
        return weights
    state = {key.removeprefix(prefix): value for key, value in weights.state.items()}
    name = "msnet2d" if any(key.startswith("preconv11.") for key in state) else "msnet3d-authors"
    config = model_config(name)
    expected = {authors_key(key, config): key for key in registered_shapes(name)}
    state = {key: value for key, value in state.items() if not key.endswith(COUNTER)}
    missing, unknown = expected.keys() - state.keys(), state.keys() - expected.keys()
    if len(missing) > len(expected) / 2:  # others' names begin alike
        return weights
    if missing or unknown:
        example = min(missing or unknown)
        raise InputError(
            f"{weights.source}: not the authors' {name.removesuffix('-authors')}: {len(missing)} "
            f"keys missing, {len(unknown)} unknown, such as {example!r}"
        )
    translated = {own: state[released] for released, own in expected.items()}
    return WeightsFile(weights.source, translated, name)
