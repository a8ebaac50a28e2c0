"""Export to LiteRT, formerly TensorFlow Lite."""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.engines.tracing import example_pair
from mobilestereonet.export.base import Format, Job, Run
from mobilestereonet.nets.model import Prediction

_METADATA = "mobilestereonet"
_FILE_IDENTIFIER = b"TFL3"


class LiteRT(Format):
    """``.tflite`` file with the signature left, right -> disparity, confidence."""

    name = "litert"
    ending = ".tflite"
    extra = "litert"
    packages = ("litert-torch", "ai-edge-litert")
    conv3d_as_2d = True
    note = "fixed size"

    def write(self, job: Job, path: Path) -> None:
        """Convert; the metadata go into the file's own, as JSON under ``mobilestereonet``."""
        import litert_torch

        network = copy.deepcopy(job.network)
        _crop_transposed(network)
        left, right = example_pair(network, job.size)
        views = {"left": left, "right": right}
        litert_torch.convert(network, sample_kwargs=views).export(str(path))
        text = json.dumps(dict(job.metadata))
        path.write_bytes(_describe(path.read_bytes(), text, network.outputs))

    def open(self, path: Path) -> Run:
        """Load into LiteRT's interpreter."""
        from ai_edge_litert.interpreter import Interpreter

        signature = Interpreter(str(path), num_threads=torch.get_num_threads())
        runner = signature.get_signature_runner()

        def run(left: Tensor, right: Tensor) -> Prediction:
            found = runner(left=left.numpy(), right=right.numpy())
            return Prediction(**{name: torch.from_numpy(map_) for name, map_ in found.items()})

        return run

    def read_metadata(self, path: Path) -> dict[str, str]:
        """The file's own metadata."""
        model = _parse(path.read_bytes())
        index = next(item.buffer for item in model.metadata if item.name == _METADATA.encode())
        return cast(dict[str, str], json.loads(bytes(model.buffers[index].data)))


class _CroppedTranspose(nn.Module):
    """Transposed convolution of stride 2 without padding, then a crop.

    LiteRT's converter refuses an output padding; without padding there is one row and one column
    more at the beginning, and none is missing at the end.
    """

    def __init__(self, conv: nn.ConvTranspose2d) -> None:
        super().__init__()
        self.weight, self.bias = conv.weight, conv.bias

    def forward(self, x: Tensor) -> Tensor:
        return F.conv_transpose2d(x, self.weight, self.bias, stride=2)[..., 1:, 1:]


def _crop_transposed(network: nn.Module) -> None:
    for module in list(network.modules()):
        for name, child in module.named_children():
            if isinstance(child, nn.ConvTranspose2d):
                setattr(module, name, _CroppedTranspose(child))


def _parse(content: bytes) -> Any:
    from ai_edge_litert import schema_py_generated as schema

    return schema.ModelT.InitFromObj(schema.Model.GetRootAs(content, 0))


def _describe(content: bytes, text: str, outputs: Sequence[str]) -> bytes:
    """Add metadata to a file, and name its outputs."""
    import flatbuffers
    from ai_edge_litert import schema_py_generated as schema

    model = _parse(content)
    for output, name in zip(model.signatureDefs[0].outputs, outputs, strict=True):
        output.name = name
    model.buffers.append(schema.BufferT(data=list(text.encode())))
    model.metadata.append(schema.MetadataT(name=_METADATA, buffer=len(model.buffers) - 1))
    builder = flatbuffers.Builder(len(content))
    builder.Finish(model.Pack(builder), _FILE_IDENTIFIER)
    return bytes(builder.Output())
