"""Weights that come with the package, in versions, each with a card."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from mobilestereonet.errors import InputError
from mobilestereonet.nets import model_config

_FOLDER = Path(__file__).parent


def embedded_models() -> list[str]:
    """Names of the networks whose weights come with the package."""
    return sorted({version.partition(".")[0] for version in _versions()})


def embedded_versions(model: str) -> list[str]:
    """Versions of a network's embedded weights, oldest first: "msnet2d.procedural-1" and so on.

    Each is a name that `load_model` and `card` take; the network's own name means the last one.

    Args:
        model: Name of a network, such as "msnet2d".
    """
    return sorted((name for name in _versions() if name.partition(".")[0] == model), key=_age)


def is_embedded(name: str) -> bool:
    """Whether a name is that of embedded weights: a network's, or a version's."""
    return name in _versions() or name in embedded_models()


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
        return _FOLDER / f"{name}.safetensors"
    if versions:
        raise InputError(f"no version {name!r} comes with the package: only {', '.join(versions)}")
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
    file = embedded_file(name).with_suffix(".json")
    content: dict[str, Any] = json.loads(file.read_text("utf-8"))
    return content


def _versions() -> list[str]:
    return [path.stem for path in _FOLDER.glob("*.*.safetensors")]


def _age(version: str) -> tuple[str, int, str]:
    """Sorts versions: by the date in the card, then by the number at the end of the tag."""
    number = re.search(r"(\d+)$", version)
    date = json.loads((_FOLDER / f"{version}.json").read_text("utf-8")).get("date", "")
    return date, int(number[1]) if number else 0, version
