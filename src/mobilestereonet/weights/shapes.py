"""Shapes of registered networks, without the time and the memory of their weights."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from mobilestereonet.nets import StereoModel, model_config, model_info
from mobilestereonet.weights.files import COUNTER

_FILLING = {"fill_", "kaiming_normal_", "kaiming_uniform_", "normal_", "uniform_", "zero_"}


class _NoFilling(TorchFunctionMode):
    """Leaves out the initialisation of weights, which takes most of the time on meta tensors."""

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Iterable[type],
        args: tuple[Any, ...] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        kwargs = kwargs or {}
        if getattr(func, "__name__", "") in _FILLING:
            return args[0] if args else kwargs["tensor"]
        return func(*args, **kwargs)


def count_parameters(name: str) -> int:
    """Number of parameters of a registered network."""
    info = model_info(name)
    net = _meta_network(info.network, info.config)
    return sum(parameter.numel() for parameter in net.parameters())


def registered_shapes(name: str, **values: Any) -> dict[str, torch.Size]:
    """Shapes by name of the state dict of a registered network.

    Args:
        name: The network.
        **values: Values of its config to change.
    """
    network: Any = model_info(name).network
    return _registered_shapes(network, model_config(name, **values))


@lru_cache(maxsize=256)
def _registered_shapes(network: Any, config: Any) -> dict[str, torch.Size]:
    return shapes(_meta_network(network, config).state_dict())


def _meta_network(network: type[StereoModel], config: Any) -> StereoModel:
    """A network of meta tensors, which have shapes and no values."""
    with torch.device("meta"), _NoFilling():
        return network(config)


def shapes(state: dict[str, Tensor]) -> dict[str, torch.Size]:
    """Shapes by name of what a weights file holds of a state dict."""
    return {name: value.shape for name, value in state.items() if not name.endswith(COUNTER)}
