"""Export to ONNX, checked with ONNX Runtime."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.engines.onnxruntime import open_session, to_onnx
from mobilestereonet.export.base import INPUTS, Format, Job, Run
from mobilestereonet.export.quantise import float_nodes, quantise
from mobilestereonet.nets.model import Prediction


class ONNX(Format):
    """One ``.onnx`` file, with its metadata as ``metadata_props``."""

    name = "onnx"
    ending = ".onnx"
    extra = "onnx"
    packages = ("onnx", "onnxscript", "onnxruntime")
    precisions = ("fp32", "fp16", "int8")
    dynamic = True
    note = "any ONNX runtime; fp16 computes in half precision up to the scores"

    def write(self, job: Job, path: Path) -> None:
        """Convert, quantise where asked to, add the metadata."""
        import onnx

        network = copy.deepcopy(job.network).half() if job.precision == "fp16" else job.network
        model = to_onnx(network, job.size)
        for node in model.graph.node:  # where in this package each comes from, a megabyte in all
            node.ClearField("metadata_props")
        if job.precision == "int8":
            nodes = list(model.graph.node)
            keep = float_nodes([(node.name, node.op_type) for node in nodes], "Resize", "Conv")
            model = quantise(model, job.calibration, keep)
        onnx.helper.set_model_props(model, dict(job.metadata))
        onnx.checker.check_model(model)
        onnx.save_model(model, path)

    def open(self, path: Path) -> Run:
        """Load into ONNX Runtime, on the CPU."""
        session = open_session(path, "cpu", torch.get_num_threads())

        def run(left: Tensor, right: Tensor) -> Prediction:
            views = dict(zip(INPUTS, (left.numpy(), right.numpy()), strict=True))
            return Prediction(*map(torch.from_numpy, session.run(None, views)))

        return run

    def read_metadata(self, path: Path) -> dict[str, str]:
        """The file's ``metadata_props``."""
        import onnx

        model: Any = onnx.load_model(path, load_external_data=False)
        return {item.key: item.value for item in model.metadata_props}
