"""PyTorch's own files: checkpoints of a training run, and state dicts of `torch.save`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.text import read_json
from mobilestereonet.weights.files import WeightsFile

_WRAPPERS = ("state_dict", "model_state_dict", "model", "net", "network", "module", "weights")
"""Keys under which others put the state dict beside an optimizer's, an epoch and the like; what
lies under another one is taken where none of these holds tensors."""
_MAX_DEPTH = 4
"""Wrappers inside one another, and prefixes before one another."""
_PREFIXES = ("module.", "net.", "model.", "network.")
"""What DataParallel, our training module and others put before every name."""
_COMPILED = "_orig_mod."
"""What `torch.compile` puts into names, wherever it was called."""
_FLAT_VALUES = ("max_disparity", "estimator", "coarse_pass")
"""Values of the network's config in recipes from before these had a part ``net``."""


def read_checkpoint(path: Path) -> WeightsFile:
    """Read a state dict, bare or wrapped, or a checkpoint of a training run.

    Nothing but tensors and plain data is read, so that no code of the file can run: what would
    need any, such as the options of a training script, is left out. A run's checkpoint holds the
    moving average of its weights, as its ``weights.safetensors`` does, where the recipe has one;
    the network's config is in the ``recipe.json`` beside it.

    Raises:
        InputError: If the file is cut off, is a network with its code, or holds no state dict.
    """
    content = _load(path)
    if isinstance(content, _LeftOut):
        raise InputError(
            f"{path}: holds an object that needs code, which is not run: load it where that code "
            "is, and save its state_dict() alone"
        )
    of_run = isinstance(content, Mapping) and "pytorch-lightning_version" in content
    found = list(_state_dicts(content))
    most = max(map(len, found), default=0)
    if not most:
        raise InputError(
            f"{path}: holds no state dict: expected tensors by name, alone or under a key such as "
            f"{', '.join(_WRAPPERS)}"
        )
    # The likeliest one that is no small record, such as an optimizer has for each parameter.
    state = next(state for state in found if 2 * len(state) > most)
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
    for _ in range(_MAX_DEPTH):  # they may be nested
        wrapped = [
            {key[len(prefix) :]: value for key, value in outer.items() if key.startswith(prefix)}
            for outer in wrapped
            for prefix in _PREFIXES
        ]
        best = max([best, *wrapped], key=lambda found: len(found.keys() & expected))
        wrapped = [inner for inner in wrapped if inner]
    return best


class _LeftOut:
    """What stands in a checkpoint's place of an object that needs code."""

    def __new__(cls, *_: object, **__: object) -> _LeftOut:
        """Take any arguments, and forget them."""
        return super().__new__(cls)

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def __setstate__(self, _: object) -> None:
        pass


def _plain_dict(*_: object) -> dict[Any, Any]:
    """What takes a defaultdict's place, whose factory may be any code."""
    return {}


def _load(path: Path) -> Any:
    """Content of a file of `torch.save`, with `_LeftOut` for what PyTorch does not take unasked."""
    left_out: set[str] = set()
    while True:
        # Python's own are told without their module, which has a name per version.
        names = {f"{m}{n}" for n in left_out for m in ("", "builtins.", "__builtin__.")}
        stand_ins: list[Any] = [(_LeftOut, name) for name in names]
        stand_ins.append((_plain_dict, "collections.defaultdict"))
        try:
            with torch.serialization.safe_globals(stand_ins):
                return torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # whatever an unpickler makes of any bytes
            match = re.search(r"Unsupported global: GLOBAL (\S+)", str(error))
            if match is None or match[1] in left_out:
                reason = re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split("\n")[0]
                raise InputError(f"{path}: not a readable PyTorch checkpoint: {reason}") from error
            left_out.add(match[1])


def _state_dicts(content: object, depth: int = _MAX_DEPTH) -> Iterator[dict[str, Tensor]]:
    """Tensors by name in a checkpoint, the likeliest first; what lies beside them is left out."""
    if not isinstance(content, Mapping) or depth == 0:
        return
    for key in (*_WRAPPERS, *(key for key in content if key not in _WRAPPERS)):
        yield from _state_dicts(content.get(key), depth - 1)
    yield {k: v for k, v in content.items() if isinstance(k, str) and isinstance(v, Tensor)}


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
