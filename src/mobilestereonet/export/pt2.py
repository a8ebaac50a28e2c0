"""Export to torch.export's own file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import cast

import torch
from torch import Tensor

from mobilestereonet.engines.tracing import example_pair
from mobilestereonet.export.base import Format, Job, Run
from mobilestereonet.nets.model import Prediction

_METADATA = "metadata.json"


class PT2(Format):
    """``.pt2`` file for PyTorch without this package, and for AOTInductor."""

    name = "pt2"
    ending = ".pt2"
    extra = "export"
    packages = ("torch",)
    conv3d_as_2d = True
    note = "torch.export.load, without this package"

    def write(self, job: Job, path: Path) -> None:
        """Export and save, with the metadata as an extra file inside."""
        files = {_METADATA: json.dumps(dict(job.metadata))}
        torch.export.save(exported(job), path, extra_files=files)

    def open(self, path: Path) -> Run:
        """Load as a module."""
        module = torch.export.load(path).module()

        def run(left: Tensor, right: Tensor) -> Prediction:
            with torch.inference_mode():
                found = module(left, right)
            return Prediction(*(found if isinstance(found, tuple) else (found,)))

        return run

    def read_metadata(self, path: Path) -> dict[str, str]:
        """The extra file."""
        files = {_METADATA: ""}
        torch.export.load(path, extra_files=files)
        return cast(dict[str, str], json.loads(files[_METADATA]))


def exported(job: Job) -> torch.export.ExportedProgram:
    """Program of fixed size with the preprocessing inside, by torch.export."""
    return torch.export.export(job.network, example_pair(job.network, job.size))
