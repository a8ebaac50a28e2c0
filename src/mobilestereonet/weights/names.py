"""Translation of tensors' names: a release's name for each of ours."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

Rule = tuple[str, Callable[..., str]]
"""A pattern of our names' beginnings, and the release's text for its numbers."""


def substituted(name: str, rules: Sequence[tuple[str, Any]]) -> str:
    """A name after all substitutions of `re.sub`, one after the other.

    Args:
        name: The name.
        rules: Patterns, and what takes their place.
    """
    for pattern, replacement in rules:
        name = re.sub(pattern, replacement, name)
    return name


def translated_name(name: str, rules: Sequence[Rule]) -> str:
    """A release's name for one of ours.

    Args:
        name: Our name.
        rules: The first whose pattern stands at the beginning holds; what follows stays.
    """
    for pattern, text in rules:
        if match := re.match(pattern, name):
            return text(*map(int, match.groups())) + name[match.end() :]
    raise AssertionError(f"no rule for {name}")
