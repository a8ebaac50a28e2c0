"""Names of networks: `register_model` and what looks them up.

A name is a registered one or a class of the user's own, written ``my_net.py:MyNet``.
"""

from __future__ import annotations

import difflib
import fnmatch
import hashlib
import importlib.util
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from mobilestereonet.errors import InputError
from mobilestereonet.nets.limits import check_size
from mobilestereonet.nets.model import StereoModel
from mobilestereonet.settings import differences, override

Network = TypeVar("Network", bound=type[StereoModel])


@dataclass(frozen=True, kw_only=True)
class ModelInfo:
    """A registered network.

    Attributes:
        name: What `build_model` and the command line call it.
        network: Its class, which takes the config.
        config: Its config.
        paper: Where it is described.
        licence: Licence of public weights, in plain words.
        checkpoints: Where public checkpoints are found.
        trained_on: What those were trained on.
        published: Errors that the paper prints, by what they are.
        recipes: Names of the recipes that are its authors' training schedule, in the order in
            which they follow each other (see `training.named_recipes`).
    """

    name: str
    network: type[StereoModel]
    config: Any
    paper: str = ""
    licence: str = ""
    checkpoints: str = ""
    trained_on: str = ""
    published: Mapping[str, float] = field(default_factory=dict)
    recipes: tuple[str, ...] = ()


_MODELS: dict[str, ModelInfo] = {}


def register_model(
    name: str, *, config: Any = None, **information: Any
) -> Callable[[Network], Network]:
    """Class decorator that gives a network a name.

    Args:
        name: The name. One that is taken already is replaced.
        config: The network's config, a frozen dataclass with a field ``max_disparity``. By default
            the class's own: the type of its annotation ``config``, without arguments.
        **information: Further attributes of `ModelInfo`.

    Returns:
        A function that takes a subclass of `StereoModel` and returns it.
    """

    def register(network: Network) -> Network:
        own = _default_config(network) if config is None else config
        before = _MODELS.get(name)
        if before is not None and before.network.__module__ != network.__module__:
            warnings.warn(
                f"model {name!r} of {before.network.__module__} is replaced by that of "
                f"{network.__module__}",
                stacklevel=2,
            )
        _MODELS[name] = ModelInfo(name=name, network=network, config=own, **information)
        return network

    return register


def _default_config(network: type[StereoModel]) -> Any:
    kind = get_type_hints(network).get("config")
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise InputError(
            f"{network.__name__}: annotate its config with a frozen dataclass, such as "
            "`config: MyConfig`, or give register_model a config"
        )
    try:
        return kind()
    except TypeError as error:
        raise InputError(
            f"{network.__name__}: every field of its config needs a default: {error}"
        ) from None


def list_models(pattern: str = "*", *, imported: bool = False) -> list[str]:
    """Registered names that match a shell pattern, such as ``msnet*``, in order of registration.

    Args:
        pattern: The pattern.
        imported: Also list the classes of the user's own, ``my_net.py:MyNet``, that were imported.
    """
    names = [name for name in _MODELS if imported or ".py:" not in name]
    return fnmatch.filter(names, pattern)


def model_info(name: str) -> ModelInfo:
    """What is registered under a name, or a class of the user's own.

    Args:
        name: One of `list_models`, or ``my_net.py:MyNet``: the file is imported.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the name is unknown, or the file has no such network.
    """
    if name not in _MODELS and ".py:" in name:
        path, _, attribute = name.rpartition(":")
        network = _import_network(Path(path), attribute)
        # The file may register its class with a config.
        own = [info.config for info in _MODELS.values() if info.network is network]
        register_model(name, config=own[-1] if own else None)(network)
    if name not in _MODELS:
        near = difflib.get_close_matches(name, _MODELS, n=3) or ["msnet2d", "msnet3d"]
        raise InputError(
            f"unknown model {name!r}: did you mean {', '.join(near)}? `msnet models` lists all"
        )
    return _MODELS[name]


def _import_network(path: Path, attribute: str) -> type[StereoModel]:
    network = import_from_file(path, attribute)
    if not (isinstance(network, type) and issubclass(network, StereoModel)):
        raise InputError(f"{path}: {attribute} is no subclass of mobilestereonet.StereoModel")
    return network


def import_from_file(path: Path, attribute: str) -> Any:
    """An attribute of a Python file of the user's own, which is run; None if it has none such.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If it cannot be imported.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file to import {attribute} from")
    digest = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]
    module_name = f"mobilestereonet_user_{path.stem}_{digest}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses and pickles look their module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[module_name]
        raise InputError(f"{path}: cannot be imported: {type(error).__name__}: {error}") from error
    return getattr(module, attribute, None)


def model_config(name: str, /, **overrides: Any) -> Any:
    """Config of a named network.

    Args:
        name: See `model_info`.
        **overrides: Fields of its config to change, such as ``max_disparity=256``.

    Raises:
        FileNotFoundError: See `model_info`.
        InputError: If the name or a field is unknown, or a value is refused.
    """
    return override(model_info(name).config, overrides, f"model {name}")


def build_model(name: str, /, **overrides: Any) -> StereoModel:
    """A named network with fresh weights, in training mode.

    Args:
        name: See `model_info`.
        **overrides: Fields of its config to change, such as ``max_disparity=256``.

    Raises:
        FileNotFoundError: See `model_info`.
        InputError: If the name or a field is unknown, or a value is refused.
    """
    network, named, config = (
        model_info(name).network,
        model_config(name),
        model_config(name, **overrides),
    )
    if any(_is_more(value, getattr(named, key, 0)) for key, value in overrides.items()):
        check_size(network, config, name)
    return network(config)


def _is_more(value: Any, default: Any) -> bool:
    return isinstance(value, int) and (not isinstance(default, int) or value > default)


def is_model(config: Any, name: str) -> bool:
    """Whether a config is a named model's, whatever its disparity range.

    The config's class may name more ``free_fields`` that do not change the name.

    Raises:
        FileNotFoundError: See `model_info`.
        InputError: If the name is unknown.
    """
    named = model_config(name)
    if type(config) is not type(named):
        return False
    free = free_fields(named)
    return all(
        getattr(config, each.name) == getattr(named, each.name)
        for each in fields(named)
        if each.name not in free
    )


def free_fields(config: Any) -> tuple[str, ...]:
    """Fields of a config that do not change the network's name; its class may name them."""
    fields: tuple[str, ...] = getattr(config, "free_fields", ("max_disparity",))
    return fields


def model_name(config: Any) -> str:
    """The registered model that a config is, see `is_model`; "custom" if it is none.

    Of several the one from which it differs in the fewest free fields, the first of equals.
    """
    names = [name for name in _MODELS if is_model(config, name)]
    return min(
        names, key=lambda name: len(differences(config, model_config(name))), default="custom"
    )
