"""Copies of networks, and modules of theirs replaced by others."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, TypeVar

from torch import nn

Net = TypeVar("Net", bound=nn.Module)


def inference_copy(net: Net) -> Net:
    """A copy in eval mode, whose parameters take no gradient."""
    return copy.deepcopy(net).eval().requires_grad_(False)


def sharing_copy(net: Net) -> Net:
    """A copy that shares the parameters and buffers: training one trains the other."""
    shared = {id(tensor): tensor for tensor in (*net.parameters(), *net.buffers())}
    return copy.deepcopy(net, shared)


def replace_modules(net: nn.Module, kind: Any, replacement: Callable[[Any], nn.Module]) -> None:
    """Replace the modules of a kind, in place; what a replacement holds is left as it is.

    Args:
        net: The network.
        kind: A class of modules, or several.
        replacement: Such a module to what takes its place, perhaps the module itself.
    """
    for name, child in list(net.named_children()):
        if isinstance(child, kind):
            setattr(net, name, replacement(child))
        else:
            replace_modules(child, kind, replacement)
