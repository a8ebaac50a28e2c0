"""OpenVINO as an engine."""

from __future__ import annotations

from typing import Any

import torch

from mobilestereonet.nets import StereoNet
from mobilestereonet.runtimes.graph import Graph, example_pair


def to_openvino(net: StereoNet, *, rgb: bool = False, head: bool = True) -> Any:
    """Convert a network to OpenVINO's form in memory.

    Args:
        net: The network, with any weights.
        rgb: See `Graph`.
        head: See `Graph`.

    Returns:
        An ``openvino.Model`` of any height and width, with inputs ``left`` and ``right`` and the
        output ``disparity``.
    """
    import openvino

    pair = example_pair(net)
    program = torch.export.export(Graph(net, rgb=rgb, head=head).eval(), pair)
    model = openvino.convert_model(program)
    for port, name in zip(
        (*model.inputs, *model.outputs), ("left", "right", "disparity"), strict=True
    ):
        port.tensor.set_names({name})
    model.reshape({name: [1, 3, -1, -1] for name in ("left", "right")})
    return model
