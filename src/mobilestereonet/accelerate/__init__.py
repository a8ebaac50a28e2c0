"""Exact accelerations: one door, `accelerate`, to the fast forms of a network.

``nets/`` holds the networks as their papers write them. Each rewriting here is tested to give what
they give.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args, overload

from torch import nn

from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import StereoModel

if TYPE_CHECKING:
    from mobilestereonet.accelerate.export import ExportableNet

Purpose = Literal["inference", "training", "export"]

__all__ = ["Purpose", "accelerate"]


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
    # Imported where they are needed: `msnet predict` does not wait for what only training has.
    if purpose == "export":
        from mobilestereonet.accelerate.export import exportable_form

        form = exportable_form(net, **options)
    elif purpose == "training":
        from mobilestereonet.accelerate.training import training_form

        form = training_form(net)
    else:
        from mobilestereonet.accelerate.inference import inference_form

        form = inference_form(net)
    form.accelerated_for = purpose  # type: ignore[assignment]
    return form
