"""ONNX Runtime as an engine."""

from __future__ import annotations

from typing import Any

import torch

from mobilestereonet.nets import StereoNet
from mobilestereonet.runtimes.graph import Graph, example_pair


def to_onnx(net: StereoNet, *, rgb: bool = False, head: bool = True) -> Any:
    """Convert a network to ONNX in memory.

    Args:
        net: The network, with any weights.
        rgb: See `Graph`.
        head: See `Graph`.

    Returns:
        An ``onnx.ModelProto`` of any height and width, with inputs ``left`` and ``right`` and the
        output ``disparity``.
    """
    program = torch.onnx.export(
        Graph(net, rgb=rgb, head=head).eval(),
        example_pair(net),
        dynamo=True,
        verbose=False,
        input_names=["left", "right"],
        output_names=["disparity"],
        opset_version=20,
    )
    assert program is not None  # dynamo's exporter always gives one
    model = program.model_proto
    del model.graph.value_info[:]
    for value in (*model.graph.input, *model.graph.output):
        for size, name in zip(
            value.type.tensor_type.shape.dim[-2:], ("height", "width"), strict=True
        ):
            size.dim_param = name
    return model
