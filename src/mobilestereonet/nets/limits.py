"""Limits of a network's size, checked before it is built."""

from __future__ import annotations

from threading import get_ident
from typing import Any

import torch
from torch import nn
from torch.nn.modules.module import (
    register_module_module_registration_hook,
    register_module_parameter_registration_hook,
)

from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import StereoModel

MAX_MODULES = 20_000
"""Layers of a network, and modules that hold them: several times those of the largest here."""

MAX_PARAMETERS = 500_000_000
"""Parameters of a network, 2 GB: more than any for stereo matching has."""


def check_size(network: type[StereoModel], config: Any, name: str) -> None:
    """Refuse a network of too many modules or parameters, before it fills the memory.

    Raises:
        InputError: If it has more than `MAX_MODULES` or `MAX_PARAMETERS`.
    """
    modules = parameters = 0
    thread = get_ident()  # the hooks are the process's, and others may build networks, too

    def count_module(*_: Any) -> None:
        nonlocal modules
        if get_ident() == thread:
            modules += 1
            refuse_above(modules, MAX_MODULES, "layers")

    def count_parameter(module: nn.Module, key: str, value: nn.Parameter | None) -> None:
        nonlocal parameters
        if value is not None and get_ident() == thread:
            parameters += value.numel()
            refuse_above(parameters, MAX_PARAMETERS, "parameters")

    def refuse_above(count: int, limit: int, what: str) -> None:
        if count > limit:
            raise InputError(
                f"{name} with these values has more than {limit:,} {what}: take smaller ones"
            )

    hooks = (
        register_module_module_registration_hook(count_module),
        register_module_parameter_registration_hook(count_parameter),
    )
    try:
        with torch.device("meta"):  # tensors without values
            network(config)
    finally:
        for hook in hooks:
            hook.remove()
