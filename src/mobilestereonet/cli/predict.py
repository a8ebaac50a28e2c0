"""``msnet predict``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.calibration import WAYS_TO_METRES, CalibrationOptions
from mobilestereonet.cli.early import (
    DEPTH_ENDINGS,
    FLOAT_ENDINGS,
    MESH_ENDINGS,
    POINTS_ENDINGS,
    ends_in,
)
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.filters import FilterOptions
from mobilestereonet.cli.options import AsJson, LeftView, SecondView, new_output
from mobilestereonet.cli.sinks import Rerun
from mobilestereonet.cli.views import ViewFlags
from mobilestereonet.errors import InputError


def predict(
    left: LeftView,
    right: SecondView = None,
    *,
    output: Annotated[Path, new_output("out", "Folder to write to.")],
    views: ViewFlags,
    options: MatcherOptions,
    confidence: Annotated[
        bool, typer.Option("--confidence", help="How sure the network is, as picture and NPY.")
    ] = False,
    filters: FilterOptions,
    cameras: CalibrationOptions,
    depth: Annotated[
        list[Path] | None,
        typer.Option(
            help="Depth file: .png (16-bit mm), .npy or .tiff (m). Repeat for more. The folder of "
            "--output gets it in colours, with a bar in metres.",
            callback=ends_in(DEPTH_ENDINGS, "depth is"),
        ),
    ] = None,
    depth_std: Annotated[
        list[Path] | None,
        typer.Option(
            help="Standard deviation of the depth, from the confidence: .npy or .tiff (m).",
            callback=ends_in(FLOAT_ENDINGS, "a standard deviation is"),
        ),
    ] = None,
    points: Annotated[
        list[Path] | None,
        typer.Option(
            help="Point cloud: .ply or .glb. Repeat for more.",
            callback=ends_in(POINTS_ENDINGS, "points are"),
        ),
    ] = None,
    mesh: Annotated[
        list[Path] | None,
        typer.Option(
            help="Textured surface: .glb (Blender), .obj or .stl. Repeat for more.",
            callback=ends_in(MESH_ENDINGS, "meshes are"),
        ),
    ] = None,
    rerun: Rerun = None,
    tile: Annotated[
        tuple[int, int] | None,
        typer.Option(help="Height and width of tiles. Default: 1088 1920, above Full HD."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Match a pair: disparity and picture, with --rig depth, points and mesh.

    The disparity is written as 16-bit PNG (x 256, as KITTI's), PFM and NPY.
    """
    import json
    import sys
    from dataclasses import asdict

    depth_files, std_files = depth or [], depth_std or []
    point_files, mesh_files = points or [], mesh or []
    metric_files = [*depth_files, *std_files, *point_files, *mesh_files]
    if not cameras.given and metric_files:
        raise InputError(f"depth, points and meshes need {WAYS_TO_METRES}")
    if cameras.given and not (cameras.rig or metric_files or rerun):
        raise InputError(
            "a calibration is for --depth, --points, --mesh or --rerun FILE: add one of them"
        )
    filters.require(bool(metric_files or rerun))

    from mobilestereonet.atomic import check_outputs, make_folder
    from mobilestereonet.data.depth_files import write_depth
    from mobilestereonet.data.files import write_png
    from mobilestereonet.engines.base import confidence_fit
    from mobilestereonet.inference import load_pair
    from mobilestereonet.inference.deviation import check_fitted
    from mobilestereonet.inference.first_look import put_right
    from mobilestereonet.inference.map_files import MAP_FILES
    from mobilestereonet.inference.span import Span
    from mobilestereonet.plots import depth_picture
    from mobilestereonet.streams import RerunLog, StereoFrame

    maps = (output / f"{left.stem}_{name}" for name in MAP_FILES.values())
    pictured = [output / f"{left.stem}_depth_picture.png"] if depth_files else []
    check_outputs(*maps, *pictured, *metric_files)
    rectifier = cameras.read()
    pair = load_pair(left, right, layout=views.layout)
    pair = put_right(pair, views.views, rectifier, shift=options.shift)
    deep = cameras.given and bool(metric_files or rerun)
    sound = views.report(pair.findings, metric=deep)
    cameras.check_size(pair.width, pair.height)
    calibration = pair.calibration
    matcher = filters.open_matcher(
        options, tile=tile or "auto", confidence=confidence or bool(std_files)
    )
    if std_files:
        check_fitted(confidence_fit(matcher.engine) is not None, matcher.model)
    log = None if rerun is None else RerunLog(rerun)
    for folder in {output, *(path.parent for path in metric_files)}:
        make_folder(folder)
    result = matcher.match(pair)
    calibration = calibration or cameras.scaled(result)
    files = {kind: str(path) for kind, path in result.save(output, left.stem).items()}
    spans = {"disparity": Span.of(result.disparity[result.valid])}
    if calibration is not None and sound:
        metres = result.depth(calibration)
        spans["depth"] = Span.of(metres[metres > 0])
        if not metres.any():
            print("msnet: no pixel has a depth: see the limits and the cameras", file=sys.stderr)
        for file in depth_files:
            write_depth(file, metres)
            _list(files, f"depth{file.suffix}", file)
        for file in pictured:
            write_png(file, depth_picture(metres))
            files["depth_picture"] = str(file)
        if std_files:
            deviation = result.depth_std(calibration)
            for file in std_files:
                write_depth(file, deviation)
                _list(files, f"depth_std{file.suffix}", file)
    if calibration is not None and point_files:
        cloud = result.points(calibration)
        for file in point_files:
            cloud.save(file)
            _list(files, f"points{file.suffix}", file)
    if calibration is not None and mesh_files:
        surface = result.mesh(calibration)
        for file in mesh_files:
            surface.save(file)
            _list(files, f"mesh{file.suffix}", file)
    if log is not None:
        with log:
            log.write(StereoFrame(0, left.stem, 0.0, pair), result, calibration)
        files["rerun"] = str(rerun)
    info = result.info
    assert info is not None  # the matcher's results have one
    if as_json:
        findings = [asdict(finding) for finding in result.findings]
        figures = {name: span and asdict(span) for name, span in spans.items()}
        facts = {**asdict(info), **figures, "findings": findings, "files": files}
        print(json.dumps(facts, indent=2))
        return
    units = {"disparity": "px", "depth": "m"}
    found = (f"{name} {span.within(units[name])}" for name, span in spans.items() if span)
    print("; ".join([f"{info}: {info.seconds:.2f} s", *found]))
    for path in files.values():
        print(path)


def _list(files: dict[str, str], kind: str, path: Path) -> None:
    """Add a file to those by kind; a second one of its kind as kind_2 and so on."""
    alike = sum(name == kind or name.startswith(f"{kind}_") for name in files)
    files[f"{kind}_{alike + 1}" if alike else kind] = str(path)
