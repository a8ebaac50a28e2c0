"""Weights that come with the package, in versions, each with a card."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mobilestereonet.errors import InputError
from mobilestereonet.nets import model_config
from mobilestereonet.text import read_json
from mobilestereonet.versions import explain_missing, packaged_file, packaged_versions


def embedded_models() -> list[str]:
    """Names of the networks whose weights come with the package."""
    return sorted({version.partition(".")[0] for version in packaged_versions()})


def embedded_versions(model: str) -> list[str]:
    """Versions of a network's embedded weights, oldest first: "msnet2d.procedural-1" and so on.

    Each is a name that `load_model` and `card` take; the network's own name means the last one.

    Args:
        model: Name of a network, such as "msnet2d".
    """
    return sorted(packaged_versions(model), key=_age)


def is_embedded(name: str) -> bool:
    """Whether a name is that of embedded weights: a network's, or a version's."""
    return name in packaged_versions() or name in embedded_models()


def embedded_file(name: str) -> Path:
    """The weights file of an embedded network or version.

    Raises:
        InputError: If the package has no such weights.
    """
    model = name.partition(".")[0]
    versions = embedded_versions(model)
    if name == model and versions:
        name = versions[-1]
    if name in versions:
        return packaged_file(name)
    if versions:
        raise InputError(explain_missing(name))
    model_config(name)  # an unknown name has an error of its own
    raise InputError(
        f"no weights of {name!r} come with the package (of "
        f"{', '.join(embedded_models()) or 'none'}, they do): pass a weights file"
    )


def card(name: str) -> dict[str, Any]:
    """Model card of embedded weights.

    Args:
        name: "msnet2d", or a version such as "msnet2d.procedural-1".

    Returns:
        ``preprocessing`` (mean and standard deviation of RGB in 0..1), ``metrics``, ``licence``
        and ``training``: the stages, each with the values of its recipe and the weights that it
        started from.

    Raises:
        InputError: If the name is unknown, or the package has no weights for it.
    """
    content: dict[str, Any] = read_json(embedded_file(name).with_suffix(".json"))
    return content


def _age(version: str) -> tuple[str, int, str]:
    """Sorts versions: by the date in the card, then by the number at the end of the tag."""
    number = re.search(r"(\d+)$", version)
    date = read_json(packaged_file(version).with_suffix(".json")).get("date", "")
    return date, int(number[1]) if number else 0, version
