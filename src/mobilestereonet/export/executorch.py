"""Export to ExecuTorch, PyTorch's runtime for phones and boards, with XNNPACK."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.export.base import Format, Job, Run
from mobilestereonet.export.pt2 import exported
from mobilestereonet.nets.model import Prediction

_PREFIX = "metadata_"


class ExecuTorch(Format):
    """``.pte`` program whose convolutions run in XNNPACK."""

    name = "executorch"
    ending = ".pte"
    extra = "executorch"
    packages = ("executorch",)
    conv3d_as_2d = True
    note = "fixed size; XNNPACK for convolutions, portable kernels for the rest"

    def write(self, job: Job, path: Path) -> None:
        """Lower to XNNPACK; the metadata become constant methods, ``metadata_<key>``."""
        from executorch.backends.xnnpack.partition.xnnpack_partitioner import XnnpackPartitioner
        from executorch.exir import to_edge_transform_and_lower

        program = to_edge_transform_and_lower(
            exported(job),
            partitioner=[XnnpackPartitioner()],
            constant_methods={_PREFIX + key: text for key, text in job.metadata.items()},
        ).to_executorch()
        with path.open("wb") as file:
            program.write_to_file(file)

    def open(self, path: Path) -> Run:
        """Load into ExecuTorch's runtime."""
        from executorch.extension.pybindings.portable_lib import _unsafe_reset_threadpool

        _unsafe_reset_threadpool(torch.get_num_threads())
        method = _load(path).load_method("forward")

        def run(left: Tensor, right: Tensor) -> Prediction:
            # The results lie in the runtime's memory, which the next run overwrites.
            return Prediction(*(map_.clone() for map_ in method.execute([left, right])))

        return run

    def read_metadata(self, path: Path) -> dict[str, str]:
        """What the constant methods give."""
        program = _load(path)
        names = [name for name in program.method_names if name.startswith(_PREFIX)]
        return {
            name.removeprefix(_PREFIX): program.load_method(name).execute([])[0] for name in names
        }


def _load(path: Path) -> Any:
    from executorch.runtime import Runtime

    return Runtime.get().load_program(path)
