"""Convert, run, compare, and only then put the file in its place."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from uuid import uuid4

import torch
from torch import Tensor

from mobilestereonet.data.motorcycle import motorcycle_views
from mobilestereonet.engines.compare import times_in_turns
from mobilestereonet.errors import InputError
from mobilestereonet.export.base import Format, Job, Pair, Run
from mobilestereonet.export.coreml import CoreML
from mobilestereonet.export.executorch import ExecuTorch
from mobilestereonet.export.litert import LiteRT
from mobilestereonet.export.metadata import check_size, describe
from mobilestereonet.export.onnx import ONNX
from mobilestereonet.export.openvino import OpenVINO
from mobilestereonet.export.pairs import calibration_pairs
from mobilestereonet.export.pt2 import PT2
from mobilestereonet.nets import StereoModel
from mobilestereonet.nets.model import IMAGENET

FORMATS: dict[str, Format] = {
    format_.name: format_
    for format_ in (ONNX(), OpenVINO(), ExecuTorch(), LiteRT(), PT2(), CoreML())
}
"""Every format by its name."""

TOLERANCE = {"fp32": 1e-3, "fp16": 0.05, "int8": 0.5}
"""Largest mean difference to torch, in px, with which an export succeeds."""

_RUNS = 3


@dataclass(frozen=True)
class Export:
    """A file that was written, run and compared.

    Attributes:
        path: The file.
        size: Bytes of the file and of what belongs to it.
        versions: Of the packages that wrote it.
        shape: Height and width at which it was run.
        mean: Mean absolute difference to torch in px; None, as the following, if it was not run.
        largest: Largest difference in px.
        seconds: Median time of a run.
        ratio: That time over that of torch, in fp32 and eager mode, in turns with it.
    """

    path: Path
    size: int
    versions: dict[str, str | None]
    shape: tuple[int, int]
    mean: float | None = None
    largest: float | None = None
    seconds: float | None = None
    ratio: float | None = None


def export_model(
    format_: str,
    net: StereoModel,
    output: str | Path,
    *,
    model: str,
    embedded: bool = False,
    precision: str | None = None,
    size: tuple[int, int] = (256, 512),
    calibration: str | Path | None = None,
) -> Export:
    """Write a network as a file for another runtime.

    The file is run in its own runtime on scikit-image's Motorcycle and compared with torch; only
    if they agree it takes its place.

    Args:
        format_: One of `FORMATS`.
        net: The network.
        output: The file to write.
        model: What the network is called in the file's metadata.
        embedded: Whether its weights are those that come with the package, whose licence is known.
        precision: One of the format's; its first one by default.
        size: Height and width of a file of fixed size; others are compared at this one and at one
            that is one multiple higher and two wider.
        calibration: Folder of pairs for "int8"; see `calibration_pairs`.

    Returns:
        What was written and how it compares.

    Raises:
        InputError: If an argument is refused, a package is missing, the conversion fails, or the
            file's disparity differs from torch's. ``output`` is then as it was.
        FileNotFoundError: If the folder of pairs does not exist or holds none.
    """
    format_of_file = find_format(format_)
    precision = precision or format_of_file.precisions[0]
    format_of_file.check(precision)
    check_size(net, size)
    output = Path(output)
    if output.suffix != format_of_file.ending:
        raise InputError(f"{output}: a file for {format_} must end in {format_of_file.ending}")
    if calibration is not None and precision != "int8":
        raise InputError(f"calibration pairs are for precision int8, not {precision}")
    pairs: tuple[Pair, ...] = ()
    if precision == "int8":
        pairs = tuple(calibration_pairs(size, None if calibration is None else Path(calibration)))
    net = net.eval()
    metadata = describe(
        net.config,
        model,
        embedded=embedded,
        precision=precision,
        size=None if format_of_file.dynamic else size,
    )
    with _temporary(output) as path:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the converters' own business
                format_of_file.write(Job(net, size, precision, metadata, pairs), path)
            run = format_of_file.open(path)
        except Exception as error:
            reason = str(error).strip().split("\n")[0]
            raise InputError(
                f"{format_}: conversion failed: {type(error).__name__}: {reason}"
            ) from error
        export = Export(
            output,
            sum(file.stat().st_size for file in path.parent.rglob("*") if file.is_file()),
            format_of_file.versions(precision),
            size,
        )
        if run is None:
            return export
        if format_of_file.dynamic:
            multiple = net.config.size_multiple
            larger = (size[0] + multiple, size[1] + 2 * multiple)
            _compare(run, net, motorcycle_views(larger), format_, TOLERANCE[precision])
        pair = motorcycle_views(size)
        difference = _compare(run, net, pair, format_, TOLERANCE[precision])
        seconds, torch_seconds = times_in_turns(
            lambda: run(*pair), lambda: _reference(net, pair), repeats=_RUNS
        )
        return replace(
            export,
            mean=difference.mean().item(),
            largest=difference.max().item(),
            seconds=seconds,
            ratio=seconds / torch_seconds,
        )


def find_format(name: str) -> Format:
    """A format by its name.

    Raises:
        InputError: If there is none.
    """
    if name not in FORMATS:
        raise InputError(f"unknown format {name!r}, choose one of {', '.join(FORMATS)}")
    return FORMATS[name]


@contextmanager
def _temporary(output: Path) -> Iterator[Path]:
    """A path of the same name in a new folder beside; what is there on success moves out."""
    folder = output.parent / f".{uuid4().hex[:12]}"
    folder.mkdir(parents=True)
    try:
        yield folder / output.name
        # What belongs to the file comes before it.
        for path in sorted(folder.iterdir(), key=lambda path: path.name == output.name):
            target = output.parent / path.name
            if target.is_dir():
                shutil.rmtree(target)
            path.replace(target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _reference(net: StereoModel, pair: Pair) -> Tensor:
    with torch.inference_mode():
        disparity: Tensor = net(*map(IMAGENET, pair)).disparity
        return disparity


def _compare(run: Run, net: StereoModel, pair: Pair, name: str, tolerance: float) -> Tensor:
    expected, found = _reference(net, pair), run(*pair)
    if found.shape != expected.shape:
        raise InputError(
            f"{name}: the file gives {tuple(found.shape)} where torch gives "
            f"{tuple(expected.shape)}: nothing written"
        )
    difference = (found - expected).abs()
    if not difference.mean() <= tolerance:  # NaN, too
        raise InputError(
            f"{name}: the file's disparity differs from torch's by {difference.mean():.4g} px on "
            f"average, above {tolerance} px: nothing written"
        )
    return difference
