"""Copying networks and replacing their modules."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import torch
from torch import nn

Net = TypeVar("Net", bound=nn.Module)


def inference_copy(net: Net) -> Net:
    """A copy in eval mode, whose parameters take no gradient."""
    return copy.deepcopy(net).eval().requires_grad_(False)


def sharing_copy(net: Net) -> Net:
    """A copy that shares the parameters and buffers: training one trains the other."""
    shared = {id(tensor): tensor for tensor in (*net.parameters(), *net.buffers())}
    return copy.deepcopy(net, shared)


def is_plain(module: nn.Module, kinds: Any) -> bool:
    """Whether a module is exactly of one of these classes and has no hooks.

    Only then is it known what it computes: subclasses, and parametrised modules, which are such,
    may do anything.
    """
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    hooks = (
        module._forward_hooks
        or module._forward_pre_hooks
        or module._backward_hooks
        or module._backward_pre_hooks
    )
    return type(module) in kinds and not hooks


def without_identities(layers: Iterable[nn.Module]) -> list[nn.Module]:
    """Layers but `torch.nn.Identity`, which takes the place of what was fused into another layer.

    (A layer is not deleted: the network may take slices of its sequences.)
    """
    return [layer for layer in layers if type(layer) is not nn.Identity]


def device_of(net: nn.Module) -> torch.device:
    """Device of a network's parameters or buffers; the CPU for one that has neither."""
    tensor = next(itertools.chain(net.parameters(), net.buffers()), None)
    return torch.device("cpu") if tensor is None else tensor.device


def replace_modules(net: nn.Module, kind: Any, replacement: Callable[[Any], nn.Module]) -> None:
    """Replace the modules of a kind, in place; what a replacement holds is left as it is.

    Args:
        net: The network.
        kind: A class of modules, or several, see `is_plain`.
        replacement: Such a module to what takes its place, perhaps the module itself.
    """
    for name, child in list(net.named_children()):
        if is_plain(child, kind):
            setattr(net, name, replacement(child))
        else:
            replace_modules(child, kind, replacement)
