"""Export to OpenVINO's intermediate representation."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from mobilestereonet.engines.openvino import openvino_core, to_openvino
from mobilestereonet.export.base import INPUTS, Format, Job, Run
from mobilestereonet.export.quantise import float_nodes, quantise
from mobilestereonet.nets.model import Prediction

_METADATA = "mobilestereonet"


class OpenVINO(Format):
    """``.xml`` and ``.bin`` file, with the metadata as runtime information."""

    name = "openvino"
    ending = ".xml"
    extra = "openvino"
    packages = ("openvino",)
    precisions = ("fp32", "fp16", "int8")
    dynamic = True
    note = ".xml and .bin; fp16 stores the weights in half precision"

    def write(self, job: Job, path: Path) -> None:
        """Convert, quantise where asked to, add the metadata."""
        import openvino

        model = to_openvino(job.network, job.size)
        if job.precision == "int8":
            nodes = [(op.get_friendly_name(), op.get_type_name()) for op in model.get_ordered_ops()]
            keep = float_nodes(nodes, "Interpolate", "Convolution")
            model = quantise(model, job.calibration, keep)
        for key, text in job.metadata.items():
            model.set_rt_info(text, [_METADATA, key])
        openvino.save_model(model, path, compress_to_fp16=job.precision != "fp32")

    def open(self, path: Path) -> Run:
        """Compile for the CPU, with float32 where the file has it."""
        options = {
            "INFERENCE_NUM_THREADS": torch.get_num_threads(),
            "INFERENCE_PRECISION_HINT": "f32",  # some processors would take bfloat16
        }
        model = openvino_core().compile_model(path, "CPU", options)

        def run(left: Tensor, right: Tensor) -> Prediction:
            found = model(dict(zip(INPUTS, (left.numpy(), right.numpy()), strict=True)))
            return Prediction(*(torch.from_numpy(map_.copy()) for map_ in found.to_tuple()))

        return run

    def read_metadata(self, path: Path) -> dict[str, str]:
        """The runtime information under ``mobilestereonet``."""
        information = openvino_core().read_model(path).get_rt_info([_METADATA])
        return {key: value.astype(str) for key, value in information.astype(dict).items()}
