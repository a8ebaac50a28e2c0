"""The optimizers of recipes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import nn

from mobilestereonet.errors import InputError
from mobilestereonet.settings import check_arguments
from mobilestereonet.training.muon import Muon

OPTIMIZERS: dict[str, Any] = {
    "adam": torch.optim.Adam,
    "muon": Muon,
    "rmsprop": torch.optim.RMSprop,
    "sgd": torch.optim.SGD,
}
"""Optimizer classes by their names in recipes."""


def make_optimizer(
    name: str, parameters: Iterable[nn.Parameter], lr: float, options: Mapping[str, Any]
) -> torch.optim.Optimizer:
    """Create the optimizer that a recipe names.

    Args:
        name: One of `OPTIMIZERS`.
        parameters: What it trains.
        lr: Learning rate.
        options: Other arguments of its class.

    Raises:
        InputError: If the name or an option is unknown, or a value is refused.
    """
    if name not in OPTIMIZERS:
        raise InputError(f"recipe: optimizer must be {' or '.join(OPTIMIZERS)}, got {name!r}")
    kind = OPTIMIZERS[name]
    reserved = ("params", "parameters", "lr")
    checked = check_arguments(kind.__init__, options, f"recipe: {name}", reserved=reserved)
    try:
        optimizer: torch.optim.Optimizer = kind(parameters, lr=lr, **checked)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"recipe: optimizer_options: {error}") from None
    return optimizer


def check_optimizer(name: str, options: Mapping[str, Any]) -> None:
    """Check an optimizer and its options before there is a network.

    Raises:
        InputError: See `make_optimizer`.
    """
    make_optimizer(name, [nn.Parameter(torch.zeros(1))], 1e-3, options)
