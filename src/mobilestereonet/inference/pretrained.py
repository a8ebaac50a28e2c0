"""What `StereoMatcher.from_pretrained` takes: names, files and addresses of models."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from inspect import signature
from pathlib import Path
from typing import Any

import torch

from mobilestereonet.engines.base import Engine
from mobilestereonet.engines.choose import open_standalone
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel
from mobilestereonet.weights import load_model


def open_model(
    source: str | Path,
    *,
    model: str | None,
    revision: str | None,
    engine: str,
    precision: str,
    device: str | torch.device,
    threads: int | None,
    config: Mapping[str, Any],
) -> tuple[StereoModel | Engine, dict[str, Any]]:
    """Open a model; see `StereoMatcher.from_pretrained`.

    Returns:
        A network or an engine, and the arguments of `StereoMatcher` that go with it.

    Raises:
        FileNotFoundError: If there is no such weights file.
        InputError: If a name or a value is refused, or an engine by itself is given what only a
            network has.
    """
    where: dict[str, Any] = {"device": device, "threads": threads}
    alone = open_standalone(source, **where, options=config) if isinstance(source, str) else None
    if alone is None:
        net = load_model(source, model=model, revision=revision, config=config)
        return net, {"name": model, "engine": engine, "precision": precision, **where}
    given = {"model": model, "revision": revision, "engine": engine, "precision": precision}
    defaults = (None, "torch", "fp32", "auto")
    if chosen := [key for key, value in given.items() if value not in defaults]:
        raise InputError(f"{source} runs by itself: leave {', '.join(chosen)} out")
    return alone, {"name": Path(str(source).partition(",")[0]).name}  # no options of an ONNX file


@contextmanager
def misspelt_options(function: Callable[..., Any], overrides: Mapping[str, Any]) -> Iterator[None]:
    """Context in which further arguments are used, which may be meant for the function itself.

    Args:
        function: The function that took them.
        overrides: They by name.

    Raises:
        InputError: If the context fails and one is nearly the name of a parameter.
    """
    try:
        yield
    except (InputError, TypeError) as error:
        own = list(signature(function).parameters)
        for name in overrides:
            if near := difflib.get_close_matches(name, own, n=1, cutoff=0.75):
                raise InputError(
                    f"from_pretrained has no option {name!r}: did you mean {near[0]}? ({error})"
                ) from error
        raise
