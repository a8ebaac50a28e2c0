"""Names of networks, data sets and values, read from source files without importing PyTorch."""

from __future__ import annotations

import ast
import re
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]

RECIPES = tuple(sorted(path.stem for path in (_PACKAGE / "training/recipes").glob("*.yaml")))

_RECIPE_PARTS = {
    "recipe": ("training/recipe.py", "Recipe"),
    "augment": ("data/augment.py", "AugmentConfig"),
    "scenes": ("scenes/config.py", "SceneConfig"),
}
"""Parts of a recipe, and where their dataclasses are."""


def networks() -> list[str]:
    """Names of the networks, without those that are composed, as the ablations' are."""
    return _found("nets", r'register_model\(\s*"([^"]+)"')


def words_of_networks() -> list[str]:
    """All words in quotes in the networks' files, among which each network's name is."""
    return _found("nets", r'"([\w.-]+)"')


def data_sets() -> list[str]:
    """Names of the data sets that can be opened."""
    return _found("data/scanners", r'@register_data_set\("([^"]+)"')


def recipe_fields() -> dict[str, list[str]]:
    """Fields of a recipe and of its parts."""
    return {part: _fields(*where) for part, where in _RECIPE_PARTS.items()}


def network_fields() -> list[str]:
    """Fields of the configs of all networks."""
    files = sorted((_PACKAGE / "nets").glob("*.py"))
    return sorted({name for file in files for name in _fields(file, r"\w*Config")})


def _found(folder: str, pattern: str) -> list[str]:
    """What a pattern finds in a folder's source files."""
    sources = (path.read_text("utf-8") for path in (_PACKAGE / folder).glob("*.py"))
    return sorted({name for source in sources for name in re.findall(pattern, source)})


def _fields(file: str | Path, pattern: str) -> list[str]:
    """Fields of the dataclasses of a source file whose names match."""
    return [
        line.target.id
        for node in ast.parse((_PACKAGE / file).read_text("utf-8")).body
        if isinstance(node, ast.ClassDef) and re.fullmatch(pattern, node.name)
        for line in node.body
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
        if not ast.unparse(line.annotation).startswith("ClassVar")
    ]
