"""torch.export's own file, ``.pt2``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import cast

import torch
from torch import Tensor

from mobilestereonet.accelerate.export import exportable_form
from mobilestereonet.export.base import Format, Job, Run

_METADATA = "metadata.json"


class PT2(Format):
    """For PyTorch without this package, and for AOTInductor."""

    name = "pt2"
    ending = ".pt2"
    extra = "export"
    packages = ("torch",)
    note = "torch.export.load, without this package"

    def write(self, job: Job, path: Path) -> None:
        """Export and save, with the metadata as an extra file inside."""
        files = {_METADATA: json.dumps(dict(job.metadata))}
        torch.export.save(exported(job), path, extra_files=files)

    def open(self, path: Path) -> Run:
        """Load as a module."""
        module = torch.export.load(path).module()

        def run(left: Tensor, right: Tensor) -> Tensor:
            with torch.inference_mode():
                return cast(Tensor, module(left, right))

        return run

    def read_metadata(self, path: Path) -> dict[str, str]:
        """The extra file."""
        files = {_METADATA: ""}
        torch.export.load(path, extra_files=files)
        return cast(dict[str, str], json.loads(files[_METADATA]))


def exported(job: Job) -> torch.export.ExportedProgram:
    """The network with the normalisation inside, as torch.export's graph of a fixed size."""
    left, right = torch.zeros(2, 1, 3, *job.size)  # two tensors: one would be taken as one input
    return torch.export.export(exportable_form(job.net, rgb=True, conv3d_as_2d=True), (left, right))
