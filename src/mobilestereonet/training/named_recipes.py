"""Recipes by name: the published schedules of the networks, and this project's own."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel, VolumeModel, model_config, model_info
from mobilestereonet.nets.model import fitting_side
from mobilestereonet.settings import build, choice_hint
from mobilestereonet.text import parse_json, parse_yaml, read_text
from mobilestereonet.training.recipe import Recipe, absolute_reference, net_names

RECIPE_FILES = sorted(Path(__file__).with_name("recipes").glob("*.yaml"))
"""The named recipes as commented files."""


def _named_recipes() -> dict[str, Recipe]:
    """The recipes of the folder ``recipes``; one may name another as its ``base``."""
    records = {path.stem: parse_yaml(read_text(path), path.name) for path in RECIPE_FILES}

    def complete(record: Mapping[str, Any]) -> dict[str, Any]:
        base = record.get("base")
        values = {key: value for key, value in record.items() if key != "base"}
        return (complete(records[base]) if base else {}) | values

    return {name: build(Recipe, complete(record), name) for name, record in records.items()}


RECIPES = _named_recipes()
"""Recipes by name. "procedural-plain" asks nothing of a network but its own loss."""


def get_recipe(name: str) -> Recipe:
    """A recipe by its name, or a run's by the path of its ``recipe.json``.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the name is unknown, or the file is no recipe.
    """
    if name.endswith(".json"):
        return read_recipe(Path(name))
    if name not in RECIPES:
        raise InputError(f"unknown recipe {name!r}: {choice_hint(name, RECIPES)}")
    return RECIPES[name]


def default_recipe(*models: str) -> Recipe:
    """The recipe "procedural" if networks take all of its values, else "procedural-plain".

    The crop is the recipe's, enlarged to the sizes that the networks take.

    Args:
        *models: Names of the networks, see `Recipe`; the recipe has the first one's.

    Raises:
        FileNotFoundError: If there is no such file of a network of the user's own.
        InputError: If a name is unknown.
    """
    recipe = RECIPES["procedural" if all(map(_takes_procedural, models)) else "procedural-plain"]
    augment = recipe.augment
    for model in models:
        augment = _enlarged_crop(augment, model_info(model).network)
    return dataclasses.replace(recipe, model=models[0], augment=augment)


def _takes_procedural(model: str) -> bool:
    """Whether a network takes all values of the recipe "procedural"."""
    network = model_info(model).network
    known = {part.name for part in dataclasses.fields(model_config(model))}
    has_zero_residuals = network.zero_residuals is not StereoModel.zero_residuals
    fits = issubclass(network, VolumeModel) and has_zero_residuals
    return fits and RECIPES["procedural"].net.keys() <= known


def _enlarged_crop(augment: AugmentConfig, network: type[StereoModel]) -> AugmentConfig:
    assert augment.height is not None and augment.width is not None
    height, width = (fitting_side(network, side) for side in (augment.height, augment.width))
    return dataclasses.replace(augment, height=height, width=width)


def read_recipe(path: Path, *, trusted: Collection[str] = ()) -> Recipe:
    """The recipe that a run wrote beside its checkpoints.

    Args:
        path: The ``recipe.json``.
        trusted: References such as ``my_net.py:MyNet`` that the user gave.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no recipe, or names code in its own folder that is not
            ``trusted``: who got the folder from somebody has not asked for that to be run.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path.parent} holds no run: there is no {path.name} in it")
    record = _of_older_versions(parse_json(read_text(path), f"{path}: not a recipe"))
    if isinstance(record, dict):
        _refuse_code(record, path, trusted)
    try:
        return build(Recipe, record, "recipe", also_known=net_names(record))
    except InputError as error:
        raise InputError(f"{path}: not a recipe: {error}") from None


def _refuse_code(record: dict[str, Any], path: Path, trusted: Collection[str]) -> None:
    known = {absolute_reference(reference) for reference in trusted}
    for name, option in _NAMED_BY.items():
        reference = absolute_reference(str(record.get(name)))
        file = Path(reference.rpartition(":")[0])
        is_beside = file.suffix == ".py" and path.parent.resolve() in file.parents
        if is_beside and reference not in known:
            raise InputError(
                f"{path}: its {name} is code that lies beside it, {reference}, and is not run "
                f"unasked: if you trust it, name it by {option}"
            )


_NAMED_BY = {
    "model": "--model of `msnet train` or, with --weights, `msnet evaluate`",
    "loss": "--set loss= of `msnet train`",
}
"""Where users name code of their own: what a recipe calls it, and the option."""

_NET_VALUES = {"max_disparity": 192, "estimator": "mean", "coarse_pass": False}
"""Values of the network that recipes of version 0.1.0 held themselves, and their defaults."""


def _of_older_versions(record: Any) -> Any:
    """A recipe's JSON with what older versions called otherwise in its place of now."""
    if not isinstance(record, dict) or not _NET_VALUES.keys() & record.keys():
        return record
    record = {"full_heads": 4, **record}
    old = {name: record.pop(name) for name in _NET_VALUES if name in record}
    net = {name: value for name, value in old.items() if value != _NET_VALUES[name]}
    # Their networks had four heads at most.
    if record["full_heads"] == 4:
        record["full_heads"] = None
    return {**record, "net": net | record.get("net", {})}
