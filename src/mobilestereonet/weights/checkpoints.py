"""PyTorch's own files: checkpoints of a training run, and state dicts of `torch.save`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.text import read_json
from mobilestereonet.weights.files import WeightsFile

_WRAPPERS = ("state_dict", "model_state_dict", "model")
"""Keys under which others put the state dict beside an optimizer's, an epoch and the like."""
_PREFIXES = ("module.", "net.", "model.")
"""What DataParallel, our training module and others put before every name."""
_COMPILED = "_orig_mod."
"""What `torch.compile` puts into names, wherever it was called."""
_FLAT_VALUES = ("max_disparity", "estimator", "coarse_pass")
"""Values of the network's config in recipes from before these had a part ``net``."""


def read_checkpoint(path: Path) -> WeightsFile:
    """Read a state dict, bare or wrapped, or a checkpoint of a training run.

    Nothing but tensors and plain data is read, so that no code of the file can run. A run's
    checkpoint holds the moving average of its weights, as its ``weights.safetensors`` does, where
    the recipe has one; the network's config is in the ``recipe.json`` beside it.

    Raises:
        InputError: If the file is cut off, needs code, or holds no state dict.
    """
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever an unpickler makes of any bytes
        raise InputError(f"{path}: not a readable PyTorch checkpoint: {_reason(error)}") from error
    of_run = isinstance(content, Mapping) and "pytorch-lightning_version" in content
    state = content
    for wrapper in _WRAPPERS:
        if isinstance(state, Mapping) and isinstance(state.get(wrapper), Mapping):
            state = state[wrapper]
    if (
        not isinstance(state, Mapping)
        or not state
        or not all(isinstance(k, str) and isinstance(v, Tensor) for k, v in state.items())
    ):
        raise InputError(
            f"{path}: holds no state dict: expected tensors by name, alone or under one of "
            f"{', '.join(_WRAPPERS)}"
        )
    state = {key.replace(_COMPILED, ""): value for key, value in state.items()}
    recipe = path.with_name("recipe.json")
    model, config = _read_recipe(recipe) if of_run and recipe.is_file() else (None, {})
    return WeightsFile(str(path), state, model, config)


def strip_prefixes(state: dict[str, Tensor], names: Iterable[str]) -> dict[str, Tensor]:
    """A state dict without what wrappers put before its names.

    Args:
        state: Tensors by name. Where some have such a prefix, what lacks it is left out: it
            belongs to the wrapper, such as the counters of a training module.
        names: Names in the network, which may begin like a wrapper's: the state dict that shares
            most of them is taken.
    """
    expected = set(names)
    best, wrapped = state, [state]
    for _ in range(len(_PREFIXES)):  # they may be nested
        wrapped = [
            {key[len(prefix) :]: value for key, value in outer.items() if key.startswith(prefix)}
            for outer in wrapped
            for prefix in _PREFIXES
        ]
        best = max([best, *wrapped], key=lambda found: len(found.keys() & expected))
        wrapped = [inner for inner in wrapped if inner]
    return best


def _reason(error: Exception) -> str:
    """First line of an error, or what stands in the way of a file that needs code."""
    text = str(error)
    if "Unsupported global: GLOBAL " in text:
        name = text.split("Unsupported global: GLOBAL ")[1].split()[0]
        return f"it needs code ({name}), which is not run: save its state_dict() alone"
    return text.split("\n")[0]


def _read_recipe(path: Path) -> tuple[str | None, dict[str, Any]]:
    """Network and config of a run: what its recipe says of them."""
    recipe = read_json(path)
    try:
        model = recipe.get("model")
        config = {key: recipe[key] for key in _FLAT_VALUES if key in recipe}
        config |= recipe.get("net") or {}
    except (AttributeError, TypeError) as error:
        raise InputError(f"{path}: not a recipe: {error}") from None
    return model, config
