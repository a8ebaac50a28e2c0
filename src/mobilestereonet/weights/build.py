"""From the content of a weights file to the network that it holds."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.nets import (
    StereoModel,
    build_model,
    free_fields,
    is_model,
    list_models,
    model_config,
    model_info,
    model_name,
)
from mobilestereonet.settings import differences
from mobilestereonet.weights.checkpoints import strip_prefixes
from mobilestereonet.weights.files import COUNTER, WeightsFile
from mobilestereonet.weights.shapes import registered_shapes, shapes

_SEARCH = ("max_disparity", "coarse_levels")
"""Values of a config that may be overridden without losing the fit of the confidence."""

_RESEMBLANCE = 0.5
"""Share of the tensors that fit, from which on a network is worth naming."""


def build_from(weights: WeightsFile, model: str | None, overrides: dict[str, Any]) -> StereoModel:
    """Build the network of a weights file and load its state.

    Args:
        weights: Content of the file.
        model: Name or class reference of the network, where the file does not tell; or to check.
        overrides: Values of the network's config that replace those of the file.

    Returns:
        The network in eval mode, float32.

    Raises:
        InputError: If the file does not tell the network and ``model`` is None, holds another
            network than ``model``, or its tensors do not fit or are not finite.
    """
    name = _network_name(weights, model)
    model_config(name)  # an unknown name has an error of its own
    bare = weights.model is None and not weights.config
    values = _told(name, weights.state) | _config_values(name, weights.config)
    try:
        config = model_config(name, **values)
    except (InputError, TypeError, ValueError) as error:
        raise InputError(
            f"{weights.source}: its network config does not fit this version: {error}"
        ) from None
    # A class of the user's own takes any config.
    named = None if model is None or ":" in model else model
    if named and weights.model is not None and not is_model(config, named):
        held = model_name(config)
        if held == "custom":
            held = f"a variant of {name} ({config_differences(config, model_config(name))})"
        raise InputError(f"{weights.source}: holds {held}, not {model}: leave the model out")
    net = build_model(name, **(values | overrides)).float().eval()
    own = net.state_dict()
    state = strip_prefixes(weights.state, own)
    if overrides:
        state = net.state_of_config(net.config, state)
    if shapes(state) != shapes(own):
        raise InputError(f"{weights.source}: {_misfit(state, shapes(own), name, overrides)}")
    _check_values(weights.source, state, own)
    counters = {key: value for key, value in own.items() if key.endswith(COUNTER)}
    net.load_state_dict(counters | state)
    searched = {name: overrides[name] for name in _SEARCH if name in overrides}
    if replace(config, **searched) == net.config:
        net.confidence_fit = weights.confidence_fit  # of another estimator it does not hold
    if bare and not overrides:
        _warn_of_defaults(weights.source, net, values)
    elif not bare and not weights.config:
        _warn_of_the_untold(weights.source, net, overrides)
    return net


def _check_values(source: str, state: dict[str, Tensor], own: dict[str, Tensor]) -> None:
    """Refuse values that no training gives: maps made with them would be nonsense."""
    integers = [
        key
        for key, value in state.items()
        if key in own and own[key].is_floating_point() and not value.is_floating_point()
    ]
    if integers:
        raise InputError(
            f"{source}: {integers[0]} is {state[integers[0]].dtype}, quantised: save the weights "
            "as floating point"
        )
    # All at once: some thousand small checks would take longer than reading the file.
    values = torch.cat([value.flatten().float() for value in state.values()])
    if not values.isfinite().all():
        key = next(key for key, value in state.items() if not value.isfinite().all())
        raise InputError(
            f"{source}: {key} is not finite: the training diverged, or the file is corrupted; take "
            "an earlier checkpoint"
        )
    if not values.any():
        raise InputError(f"{source}: all its values are 0: take another checkpoint")
    for key, value in state.items():
        if key.endswith("running_var") and (value < 0).any():
            raise InputError(f"{source}: {key} has variances below 0: the file is corrupted")


def _warn_of_the_untold(source: str, net: StereoModel, overrides: dict[str, Any]) -> None:
    """Say which values a checkpoint of a network's authors does not tell, where none was given."""
    untold: dict[str, str] = getattr(net.config, "untold", {})
    for name in untold.keys() - overrides.keys():
        default = json.dumps(getattr(net.config, name))
        warnings.warn(
            f"{source}: does not tell {name}: {default} by default, but {untold[name]}: "
            f"--set net.{name}=VALUE",
            stacklevel=4,
        )


def _warn_of_defaults(source: str, net: StereoModel, told: dict[str, Any]) -> None:
    """Say which values a state dict without its config was given, and how to give others."""
    free = [name for name in free_fields(net.config) if name not in told]
    defaults = ", ".join(f"{name}={json.dumps(getattr(net.config, name))}" for name in free)
    other = "estimator=mode --refine" if "estimator" in free else f"{free[0]}=VALUE"
    warnings.warn(
        f"{source}: a state dict does not hold its config: {defaults} by default; give what it was "
        f"trained with, such as --set net.{other}",
        stacklevel=4,
    )


def _network_name(weights: WeightsFile, model: str | None) -> str:
    """Which network a file holds, so that the config in the file has its class."""
    held = weights.model
    if held is None:
        return model or _fitting_network(weights)
    if model is not None:
        model_config(model)  # a class of the user's own may register the name
    if model is not None and ":" in model and ":" not in held:
        return model  # a class that was asked for, such as one that extends what the file names
    names = list_models(imported=True)
    known = [name for name in names if Path(name).name == Path(held).name]
    if known:
        return known[-1]
    if model is None:
        raise InputError(
            f"{weights.source}: holds {held}, which is none of the registered networks: import "
            "the module that registers it, or give the class, such as --model "
            f"{held if ':' in held else 'my_net.py:MyNet'} (that file is not run unasked)"
        )
    if ":" in held and held.rpartition(":")[2] != model.rpartition(":")[2]:
        raise InputError(f"{weights.source}: holds {held}, not {model}")
    return model


def _fitting_network(weights: WeightsFile) -> str:
    """The one registered network that a state dict without a name fits."""
    fitting = [name for name in list_models() if _fits(weights.state, name)]
    configs = [model_config(name) for name in fitting]
    if not fitting:
        raise InputError(
            f"{weights.source}: {_unlike(weights.state)}: name its network, such as --model "
            f"{_named_with_values(_resembling(weights.state))}"
        )
    if any(config != configs[0] for config in configs):
        raise InputError(
            f"{weights.source}: fits {' and '.join(fitting)} alike: choose one, such as --model "
            f"{fitting[0]}"
        )
    return fitting[0]


def _named_with_values(name: str | None) -> str:
    """Example of ``--model`` for what fits no registered config, with another value of it."""
    if name is None:
        return "my_net.py:MyNet"
    return f"{name}, with the values of its config, such as --set net.max_disparity=VALUE"


def _told(name: str, state: dict[str, Tensor]) -> dict[str, Any]:
    """Values of a network's config that the names of a state dict tell."""
    state = strip_prefixes(state, registered_shapes(name))
    return model_info(name).network.config_of_state(model_config(name), state)


def _config_values(name: str, values: dict[str, Any]) -> dict[str, Any]:
    """Values of a config from JSON, which has lists where the config has tuples."""
    default = model_config(name)
    return {
        key: tuple(value) if isinstance(getattr(default, key, None), tuple) else value
        for key, value in values.items()
    }


def _misfit(
    state: dict[str, Tensor],
    expected: dict[str, torch.Size],
    name: str,
    overrides: dict[str, Any],
) -> str:
    """Why tensors do not fit a network, in words."""
    found = shapes(state)
    wrong = {key for key, _ in found.items() ^ expected.items()}
    key = min(wrong)
    if key not in found:
        example = f"{key} is missing"
    elif key not in expected:
        example = f"{key} is unknown"
    else:
        example = f"{key} has shape {tuple(found[key])}, not {tuple(expected[key])}"
    many = "tensor does not" if len(wrong) == 1 else "tensors do not"
    text = f"{len(wrong)} {many} fit {name}, such as: {example}"
    if overrides:
        given = ", ".join(f"{key}={value!r}" for key, value in overrides.items())
        return f"{text}, with {given}: leave out what these weights were not trained with"
    like = _resembling(state, better_than=_likeness(state, expected))
    return text + (f"; they resemble {like}" if like is not None else "")


def _unlike(state: dict[str, Tensor]) -> str:
    like = _resembling(state)
    if like is None:
        return f"its tensors, such as {min(state)!r}, are those of no registered network"
    expected = registered_shapes(like, **_told(like, state))
    return _misfit(strip_prefixes(state, expected), expected, like, {})


def _fits(state: dict[str, Tensor], name: str) -> bool:
    expected = registered_shapes(name, **_told(name, state))
    return shapes(strip_prefixes(state, expected)) == expected


def _resembling(state: dict[str, Tensor], better_than: float = 0.0) -> str | None:
    """The registered network that a state dict is most like; None if it is like none."""
    likeness = {
        name: _likeness(state, registered_shapes(name, **_told(name, state)))
        for name in list_models()
    }
    best = max(likeness, key=lambda name: likeness[name])
    return best if likeness[best] > max(better_than, _RESEMBLANCE) else None


def _likeness(state: dict[str, Tensor], expected: dict[str, torch.Size]) -> float:
    """Share of the tensors, of both sides together, that have the same name and shape."""
    found = shapes(strip_prefixes(state, expected))
    both = len(found.items() & expected.items())
    return both / (len(found) + len(expected) - both)


def config_differences(config: Any, other: Any) -> str:
    """Values that two configs do not share, in words."""
    if type(config) is not type(other):
        return f"{type(config).__name__}, not {type(other).__name__}"
    pairs = differences(config, other).items()
    return ", ".join(f"{name} {one}, not {two}" for name, (one, two) in pairs)
