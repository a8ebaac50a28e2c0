"""Runs that differ by their seed alone, and labels that tell the others apart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mobilestereonet.settings import UNSET
from mobilestereonet.training.recipe import Recipe, changed_values


def group_by_seed(recipes: Mapping[str, Recipe]) -> dict[str, list[str]]:
    """Group runs that differ by their seed alone.

    Args:
        recipes: Recipes by the names of their runs.

    Returns:
        Names of the runs by the label of their group: the network, and the values in which it
        differs from other groups with this network, such as ``msnet2d, lr=0.0005``. Labels that
        would be the same, as of two files with classes of one name, are numbered.
    """
    groups: list[list[str]] = []
    for name, recipe in recipes.items():
        for group in groups:
            if not _changed(recipes[group[0]], recipe):
                group.append(name)
                break
        else:
            groups.append([name])
    firsts = [recipes[group[0]] for group in groups]
    labelled: dict[str, list[str]] = {}
    for group in groups:
        label = unique = _label(recipes[group[0]], firsts)
        number = 1
        while unique in labelled:
            number += 1
            unique = f"{label} ({number})"
        labelled[unique] = group
    return labelled


def variation_label(model: str, values: Mapping[str, Any]) -> str:
    """Label of a run: its network and the values that tell it apart."""
    texts = (f"{name}={value}" for name, value in values.items() if value != UNSET)
    return ", ".join([Path(model).name, *texts])


def _changed(one: Recipe, other: Recipe) -> dict[str, tuple[Any, Any]]:
    """Values in which two runs differ, seeds and places of files apart."""
    changed = changed_values(one, other)
    changed.pop("seed", None)
    return changed


def _label(recipe: Recipe, others: list[Recipe]) -> str:
    values: dict[str, Any] = {}
    for other in others:
        changed = _changed(recipe, other)
        if "model" not in changed:
            values |= {name: own for name, (own, _) in changed.items()}
    return variation_label(recipe.model, values)
