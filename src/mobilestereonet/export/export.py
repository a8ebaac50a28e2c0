"""Export of a network: convert, run, compare, and only then put the file in its place."""

from __future__ import annotations

import copy
import logging
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from uuid import uuid4

import torch
from torch import Tensor

from mobilestereonet.accelerate import accelerate
from mobilestereonet.atomic import check_outputs
from mobilestereonet.data.motorcycle import motorcycle_views
from mobilestereonet.engines.tracing import Size
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
from mobilestereonet.export.refinement import Refinement
from mobilestereonet.inference.refine import refine_disparity
from mobilestereonet.inference.subpixel import fit_subpixel
from mobilestereonet.nets.model import Prediction, StereoModel
from mobilestereonet.nets.volume_model import VolumeModel
from mobilestereonet.timing import long_work, time_interleaved

_LOG = logging.getLogger(__name__)

FORMATS: dict[str, Format] = {
    format_.name: format_
    for format_ in (ONNX(), OpenVINO(), ExecuTorch(), LiteRT(), PT2(), CoreML())
}
"""Every format by its name."""

TOLERANCE_PX = {"fp32": 1e-3, "fp16": 0.05, "int8": 0.5}
"""Largest mean difference to PyTorch's disparity with which an export succeeds, by precision."""

CONFIDENCE_TOLERANCE = {"fp32": 1e-3, "fp16": 0.01, "int8": 0.1}
"""Likewise, to its confidence in 0..1."""

_TIMED_RUNS = 3


@dataclass(frozen=True)
class Export:
    """Record of a file that was written, run and compared.

    Attributes:
        path: The file.
        size: Bytes of the file and of what belongs to it.
        versions: Versions of the packages that wrote it.
        any_size: Whether the file takes any height and width.
        shape: Height and width at which it was run.
        mean: Mean absolute difference to PyTorch in pixels; None, as the following, if it was not
            run.
        largest: Largest difference in pixels.
        seconds: Median time of a run.
        ratio: That time over that of PyTorch, in fp32 and eager mode, in turns with it.
    """

    path: Path
    size: int
    versions: dict[str, str | None]
    any_size: bool
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
    size: Size = (256, 512),
    calibration: str | Path | None = None,
    refine: bool = False,
    fixed: bool = False,
) -> Export:
    """Write a network as a file for another runtime.

    The file is run in its own runtime on scikit-image's Motorcycle and compared with PyTorch; only
    if they agree it takes its place.

    Args:
        format_: One of `FORMATS`.
        net: The network, in any mode and on any device; it stays as it is.
        output: The file to write.
        model: Name of the network in the file's metadata.
        embedded: Whether its weights are those that come with the package, whose licence is known.
        precision: One of the format's; its first one by default.
        size: Height and width of a file of fixed size; others are compared at this one and at one
            that is one multiple higher and two wider.
        calibration: Folder of pairs for "int8"; see `calibration_pairs`.
        refine: Refine the disparity inside the file as `StereoMatcher` does.
        fixed: Write a file of fixed size where one of any size could be.

    Returns:
        What was written and how it compares.

    Raises:
        InputError: If an argument is refused, a package is missing, the conversion fails, or the
            file's disparity differs from PyTorch's. ``output`` is then as it was.
        FileNotFoundError: If the folder of pairs does not exist or holds none.
    """
    kind = find_format(format_)
    precision = precision or kind.precisions[0]
    kind.check(precision)
    output = Path(output)
    _check_output(output, kind)
    if calibration is not None and precision != "int8":
        raise InputError(f"calibration pairs are for precision int8, not {precision}")
    network = accelerate(net, "export", rgb=True, conv3d_as_2d=kind.conv3d_as_2d).float()
    if refine:
        if not isinstance(net, VolumeModel):
            raise InputError(
                f"{model} regresses the disparity without a confidence, which the refinement needs"
            )
        network.finish = Refinement()
    any_size = kind.dynamic and network.any_size and not fixed
    min_width = network.min_width if network.any_size else net.size_multiple
    check_size(net, size, min_width)
    pairs: tuple[Pair, ...] = ()
    if precision == "int8":
        pairs = tuple(calibration_pairs(size, None if calibration is None else Path(calibration)))
    shape = None if any_size else size
    metadata = describe(
        net,
        model,
        embedded=embedded,
        precision=precision,
        size=shape,
        min_width=min_width,
        refined=refine,
    )
    with _temporary(output) as path:
        with long_work(_LOG, f"{kind.name}: converting"):
            run = _convert(kind, Job(network, shape, precision, metadata, pairs), path)
        export = Export(
            output,
            sum(file.stat().st_size for file in path.parent.rglob("*") if file.is_file()),
            kind.versions(precision),
            any_size,
            size,
        )
        if run is None:
            return export
        with long_work(_LOG, f"{kind.name}: running it and comparing it with torch"):
            return _compared(export, run, net, kind, precision, refine)


def _check_output(output: Path, kind: Format) -> None:
    if output.suffix != kind.ending:
        raise InputError(f"{output}: a file for {kind.name} must end in {kind.ending}")
    if output.is_dir():
        raise InputError(f"{output} is a folder, and stays: choose another output")
    check_outputs(output)


def _convert(kind: Format, job: Job, path: Path) -> Run | None:
    """Write and open the file.

    Raises:
        InputError: If the format's converter or its runtime fails.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the converters' own business
            kind.write(job, path)
        return kind.open(path)
    except Exception as error:
        reason = str(error).strip().split("\n")[0]
        raise InputError(
            f"{kind.name}: conversion failed: {type(error).__name__}: {reason}"
        ) from error


def _compared(
    export: Export, run: Run, net: StereoModel, kind: Format, precision: str, refine: bool
) -> Export:
    """The export with how it compares with PyTorch.

    Raises:
        InputError: If they differ.
    """
    plain = copy.deepcopy(net).float().cpu().eval()

    def reference(left: Tensor, right: Tensor) -> Prediction:
        with torch.inference_mode():
            prediction: Prediction = plain(net.preprocessing(left), net.preprocessing(right))
            if not refine:
                return prediction
            disparity, confidence = prediction
            assert confidence is not None
            disparity = refine_disparity(disparity, confidence, left, right)
            disparity = fit_subpixel(disparity, left, right)
            return Prediction(disparity, confidence)

    if export.any_size:
        height, width = export.shape
        larger = motorcycle_views((height + net.size_multiple, width + 2 * net.size_multiple))
        _difference(run(*larger), reference(*larger), kind.name, precision)
    pair = motorcycle_views(export.shape)
    difference = _difference(run(*pair), reference(*pair), kind.name, precision)
    seconds, torch_seconds = time_interleaved(
        lambda: run(*pair), lambda: reference(*pair), repeats=_TIMED_RUNS
    )
    return replace(
        export,
        mean=difference.mean().item(),
        largest=difference.max().item(),
        seconds=seconds,
        ratio=seconds / torch_seconds,
    )


def find_format(name: str) -> Format:
    """Format of a name.

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
        written = sorted(folder.iterdir(), key=lambda path: path.name == output.name)
        targets = [output.parent / path.name for path in written]
        for target in targets:
            if target.is_dir():
                raise InputError(f"{target} is a folder, and stays: choose another output")
        check_outputs(*targets)
        for path, target in zip(written, targets, strict=True):
            path.replace(target.resolve())
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _difference(found: Prediction, expected: Prediction, name: str, precision: str) -> Tensor:
    """Absolute differences of a file's disparity to PyTorch's, in pixels.

    Raises:
        InputError: If they, or those of the confidence where the file gives one, are above the
            tolerance on average, or the shapes differ.
    """
    measured = (("disparity", " px", TOLERANCE_PX), ("confidence", "", CONFIDENCE_TOLERANCE))
    for what, unit, tolerances in measured:
        map_, wanted = getattr(found, what), getattr(expected, what)
        if map_ is None or wanted is None:
            continue
        if map_.shape != wanted.shape:
            raise InputError(
                f"{name}: the file's {what} is {tuple(map_.shape)} where torch's is "
                f"{tuple(wanted.shape)}: nothing written"
            )
        mean, tolerance = (map_ - wanted).abs().mean(), tolerances[precision]
        if not mean <= tolerance:  # NaN, too
            raise InputError(
                f"{name}: the file's {what} differs from torch's by {mean:.4g}{unit} on average, "
                f"above {tolerance}{unit}: nothing written"
            )
    return (found.disparity - expected.disparity).abs()
