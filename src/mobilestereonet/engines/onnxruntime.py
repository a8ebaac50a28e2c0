"""ONNX Runtime as an engine."""

from __future__ import annotations

import logging
from typing import Any, cast

import torch
from numpy.typing import NDArray

from mobilestereonet.accelerate.export import example_pair, exportable_form
from mobilestereonet.engines.converted import ConvertedRuntime, Scores
from mobilestereonet.nets import StereoModel

_OPSET = 20


def to_onnx(net: StereoModel, *, rgb: bool = False, head: bool = True) -> Any:
    """Convert a network to ONNX in memory.

    Args:
        net: The network, with any weights.
        rgb: See `ExportableNet`.
        head: See `ExportableNet`.

    Returns:
        An ``onnx.ModelProto`` of any height and width, with inputs ``left`` and ``right`` and the
        output ``disparity``.
    """
    # It says that torchvision, whose operators the networks do without, is not installed.
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    program = torch.onnx.export(
        exportable_form(net, rgb=rgb, scores=not head),
        example_pair(net),
        dynamo=True,
        verbose=False,
        input_names=["left", "right"],
        output_names=["disparity"],
        opset_version=_OPSET,
    )
    model = cast(Any, program).model_proto
    # The graph serves any size, though it was traced at one: only its description says otherwise.
    del model.graph.value_info[:]
    for value in (*model.graph.input, *model.graph.output):
        sizes = value.type.tensor_type.shape.dim[-2:]
        for size, name in zip(sizes, ("height", "width"), strict=True):
            size.dim_param = name
    return model


class ONNXRuntime(ConvertedRuntime):
    """Runs a network in ONNX Runtime's CPU provider."""

    name = "onnxruntime"
    extra = "onnx"
    packages = ("onnxruntime", "onnx", "onnxscript")
    precisions = ("fp32",)

    def _convert(self, net: StereoModel) -> bytes:
        model: bytes = to_onnx(net, head=False).SerializeToString()
        return model

    def _load(self, model: bytes) -> Scores:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3  # it warns of operators that it does not fold
        options.intra_op_num_threads = self.threads or 0
        session = onnxruntime.InferenceSession(model, options, ["CPUExecutionProvider"])

        def scores(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
            return cast(NDArray[Any], session.run(None, {"left": left, "right": right})[0])

        return scores
