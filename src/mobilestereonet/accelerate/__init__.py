"""Exact accelerations: one door, `accelerate`, to the fast forms of a network.

``nets/`` holds the networks as their papers write them. Each rewriting here is tested to give what
they give.
"""

from __future__ import annotations

from typing import Any, Literal, get_args, overload

from torch import nn

from mobilestereonet.accelerate.export import ExportableNet, exportable_form
from mobilestereonet.accelerate.inference import inference_form
from mobilestereonet.accelerate.training import training_form
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import StereoModel

Purpose = Literal["inference", "training", "export"]

__all__ = ["ExportableNet", "Purpose", "accelerate"]


@overload
def accelerate(net: StereoModel, purpose: Literal["inference", "training"]) -> StereoModel: ...


@overload
def accelerate(
    net: StereoModel,
    purpose: Literal["export"],
    *,
    rgb: bool = False,
    scores: bool = False,
    conv3d_as_2d: bool = False,
) -> ExportableNet: ...


def accelerate(net: Any, purpose: Purpose, **options: Any) -> nn.Module:
    """The fast form of a network for a purpose.

    Layers that a form does not know, such as those with hooks and subclasses of PyTorch's, stay as
    they are.

    Args:
        net: The plain network, with any weights, in any mode.
        purpose: "inference": a copy in eval mode for the device on which the network is, see
            `accelerate.inference`. "training": a network that shares the parameters, so that
            training one trains the other, see `accelerate.training`. "export": a graph of plain
            operators for converters, see `ExportableNet`.
        **options: For "export": those of `ExportableNet`.

    Returns:
        A `StereoModel`; for "export" an `ExportableNet`.

    Raises:
        InputError: If the purpose is unknown, or the network is a fast form already.
    """
    if purpose not in get_args(Purpose):
        known = ", ".join(get_args(Purpose))
        raise InputError(f"unknown purpose {purpose!r}: choose one of {known}")
    if hasattr(net, "accelerated_for"):
        raise InputError(f"the network is its form for {net.accelerated_for}: give the plain one")
    form: nn.Module
    if purpose == "export":
        form = exportable_form(net, **options)
    else:
        form = inference_form(net) if purpose == "inference" else training_form(net)
    form.accelerated_for = purpose  # type: ignore[assignment]
    return form
