"""Export to Core ML, for Apple's devices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from mobilestereonet.export.base import Format, Job
from mobilestereonet.export.pt2 import exported


class CoreML(Format):
    """ML program in an ``.mlpackage`` folder."""

    name = "coreml"
    ending = ".mlpackage"
    extra = "coreml"
    packages = ("coremltools",)
    precisions = ("fp16", "fp32")
    conv3d_as_2d = True
    note = "fixed size; converted only: Core ML runs on Apple's devices alone"

    def write(self, job: Job, path: Path) -> None:
        """Convert; the metadata are the model's user-defined ones."""
        import coremltools as ct

        precision = ct.precision.FLOAT16 if job.precision == "fp16" else ct.precision.FLOAT32
        model = ct.convert(
            _without_aliases(exported(job)),
            outputs=[ct.TensorType(name) for name in job.network.outputs],
            minimum_deployment_target=ct.target.iOS17,
            compute_precision=precision,
        )
        model.user_defined_metadata.update(job.metadata)
        model.save(str(path))

    def open(self, path: Path) -> None:
        """None: there is nothing to run it with."""

    def read_metadata(self, path: Path) -> dict[str, str]:
        """The user-defined metadata."""
        import coremltools as ct

        return dict(ct.models.MLModel(str(path), skip_model_load=True).user_defined_metadata)


def _without_aliases(program: torch.export.ExportedProgram) -> Any:
    """In core ATen, without the aliases of tensors, which coremltools 9.0 does not know."""
    program = program.run_decompositions({})
    for node in list(program.graph.nodes):
        if node.target is torch.ops.aten.alias.default:
            node.replace_all_uses_with(node.args[0])
            program.graph.erase_node(node)
    program.graph_module.recompile()
    return program
