"""The page of recipes: all values from the dataclasses, and the named recipes as their files."""

from __future__ import annotations

import inspect
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any

import griffe

from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.scenes import SceneConfig
from mobilestereonet.training.named_recipes import RECIPE_FILES
from mobilestereonet.training.recipe import Recipe

PATH = "reference/recipes.md"

_INTRODUCTION = """# Recipes

A recipe is everything that decides a training run but the machine. `msnet train --recipe NAME`
takes one of those [below](#named-recipes), or another run's `recipe.json`; `--set NAME=VALUE`
replaces a value, such as `--set lr=5e-4`, `--set scenes.seed=7` or `--set augment.noise=0.02`.
[Train](../training.md) says which to take.
"""


def recipe_page() -> dict[str, str]:
    """Markdown by path in the docs."""
    lines = [_INTRODUCTION]
    for kind, title, prefix in (
        (Recipe, "Values", ""),
        (SceneConfig, "Scenes", "scenes."),
        (AugmentConfig, "Augmentation", "augment."),
    ):
        lines += [f"## {title}", "", *_table(kind, prefix), ""]
    lines += ["## Named recipes", ""]
    for file in RECIPE_FILES:
        lines += [f"### {file.stem}", "", "```yaml", file.read_text("utf-8").strip(), "```", ""]
    return {PATH: "\n".join(lines)}


def _table(kind: type[Any], prefix: str) -> list[str]:
    texts = _attribute_texts(kind)
    lines = ["| value | default | |", "| --- | --- | --- |"]
    for field in fields(kind):
        text = " ".join(texts[field.name].split()).replace("|", "\\|").replace("``", "`")
        lines.append(f"| `{prefix}{field.name}` | {_default(field)} | {text} |")
    return lines


def _attribute_texts(kind: type[Any]) -> dict[str, str]:
    """What a dataclass's docstring says of each of its fields."""
    docstring = griffe.Docstring(inspect.getdoc(kind) or "", parser="google")
    sections = (part for part in docstring.parse(warnings=False) if part.kind.value == "attributes")
    return {attribute.name: attribute.description for part in sections for attribute in part.value}


def _default(field: Field[Any]) -> str:
    value = field.default if field.default_factory is MISSING else field.default_factory()
    if is_dataclass(value):
        return f"see [below](#{'scenes' if field.name == 'scenes' else 'augmentation'})"
    text = "null" if value is None else str(value).lower() if isinstance(value, bool) else value
    return f"`{text}`" if text != "" else ""
