"""Exact accelerations: one door, `accelerate`, to the fast forms of a network.

``nets/`` holds the networks as their papers write them. Each rewriting here is tested to give what
they give.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

from torch import nn

from mobilestereonet.accelerate.export import ExportableNet, exportable_form
from mobilestereonet.accelerate.inference import inference_form
from mobilestereonet.accelerate.training import training_form
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import StereoModel

Purpose = Literal["inference", "training", "export"]

__all__ = ["ExportableNet", "Purpose", "accelerate"]

_FORMS: dict[str, Callable[..., nn.Module]] = {
    "inference": inference_form,
    "training": training_form,
    "export": exportable_form,
}


def accelerate(net: StereoModel, purpose: Purpose, **options: Any) -> nn.Module:
    """The fast form of a network for a purpose.

    Args:
        net: The network, with any weights, in any mode.
        purpose: "inference": a copy in eval mode for the device on which the network is, see
            `accelerate.inference`. "training": a network that shares the parameters, so that
            training one trains the other, see `accelerate.training`. "export": a graph of plain
            operators for converters, see `ExportableNet`.
        **options: For "export": those of `ExportableNet`.

    Returns:
        A `StereoModel`; for "export" an `ExportableNet`.

    Raises:
        InputError: If the purpose is unknown.
    """
    if purpose not in _FORMS:
        known = ", ".join(get_args(Purpose))
        raise InputError(f"unknown purpose {purpose!r}: choose one of {known}")
    return _FORMS[purpose](net, **options)
