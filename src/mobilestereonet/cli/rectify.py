"""``msnet rectify``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from mobilestereonet.cli.calibration import RigFiles
from mobilestereonet.cli.early import BAG_ENDINGS, existing_source
from mobilestereonet.cli.options import new_output
from mobilestereonet.cli.sinks import TopicOptions
from mobilestereonet.cli.views import Layout, tell_findings
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.data.images import Array
    from mobilestereonet.data.sample import Calibration
    from mobilestereonet.inference.finding import Finding
    from mobilestereonet.inference.first_look import ViewOptions
    from mobilestereonet.inference.rectify import Rectifier
    from mobilestereonet.streams.pairs import PairFiles
    from mobilestereonet.streams.stereo_bag import BagPair, StereoBag

    _Writer: TypeAlias = Callable[["_Raw", Sequence[Array], Calibration], None]


def rectify(
    left: Annotated[
        str,
        typer.Argument(
            help="Left view as the camera gave it: an image, a folder or pattern of images, or a "
            "video; alone, one with both views (MPO, or see --layout) or a bag (--left, --right).",
            callback=existing_source,
        ),
    ],
    right: Annotated[
        str | None, typer.Argument(help="The right view, likewise.", callback=existing_source)
    ] = None,
    *,
    output: Annotated[
        Path, new_output("rectified", "Folder to write to; of a bag also .mcap or .bag.")
    ],
    layout: Layout = None,
    files: RigFiles,
    topics: TopicOptions,
    whole: Annotated[
        bool, typer.Option("--whole", help="Keep all pixels, with black beyond the borders.")
    ] = False,
) -> None:
    """Rectify a pair, folders, videos or bags by the cameras' calibration.

    A pair gives left.png, right.png, and calib.txt for `msnet predict --rig`. Of folders, videos
    and bags the pairs go to the folders left and right; of a bag also to another one, as
    image_rect and camera_info. A bag's camera_info is its rig unless --rig is given. Exit code 1:
    some failed.
    """
    from mobilestereonet.streams.bags import is_bag

    bag = _open_bag(left, topics) if right is None and is_bag(left) else None
    to_bag = output.suffix.lower() in BAG_ENDINGS
    if bag is None and to_bag:
        raise InputError(f"{output}: a bag is written of a bag alone: name a folder")
    if bag is None and topics != TopicOptions():
        raise InputError("--left, --right and --tolerance are of a bag, which is given alone")
    rectifier = _rectifier(files, bag, whole)
    failed, calibration = 0, None
    with ExitStack() as stack:
        write = _bag_writer(output, bag, stack) if bag and to_bag else _folder_writer(output)
        for raw in _pairs(left, right, layout) if bag is None else _bag_pairs(bag):
            try:
                if raw.views is None:
                    raise InputError(raw.problem)
                *rectified, geometry = rectifier(*raw.views)
            except InputError as error:
                if not raw.name:
                    raise
                failed += 1
                print(f"msnet: {raw.name} skipped: {error}", file=sys.stderr)
                continue
            if calibration is None and rectified[0] is raw.views[0]:
                name = rectifier.rig.name
                print(f"msnet: {name}: the views are rectified already", file=sys.stderr)
            calibration = geometry
            write(raw, rectified, calibration)
        if calibration is None:
            raise InputError("no pair could be rectified")
    if to_bag:
        print(output)
    else:
        _write_calibration(output, calibration)
    if failed:
        sys.exit(1)


@dataclass(frozen=True)
class _Raw:
    """A pair as it was taken.

    Attributes:
        name: What to call it in file names; empty for a single pair.
        views: Both views; None if there is a problem.
        problem: Why there are none.
        pair: The pair of a bag that it is.
    """

    name: str
    views: tuple[Array, Array] | None
    problem: str = ""
    pair: BagPair | None = None


def _open_bag(path: str, topics: TopicOptions) -> StereoBag:
    from mobilestereonet.streams.stereo_bag import StereoBag

    return StereoBag.open(path, topics.left_topic, topics.right_topic, topics.tolerance)


def _rectifier(files: RigFiles, bag: StereoBag | None, whole: bool) -> Rectifier:
    """What rectifies: of a bag by default what its camera_info tells."""
    from mobilestereonet.data.rig import Rig
    from mobilestereonet.inference.rectify import Rectifier

    given = files.read(whole=whole)
    if bag is None:
        if given is None:
            raise InputError("--rig FILE is missing: the calibration of the two cameras")
        return given
    raw, calibration = bag.raw_rig, bag.calibration
    if given is None:
        if calibration is None:
            raise InputError(f"{bag.path}: no calibration in it (camera_info): give --rig FILE")
        return Rectifier(raw or Rig((calibration,), "camera_info"), whole=whole)
    if given.rectifies and raw is None and calibration is not None:
        raise InputError(
            f"{bag.path}: {bag.topics[0]} is rectified already, as its camera_info tells, and "
            f"{given.rig.name} is of raw pictures: leave --rig out"
        )
    return given


def _folder_writer(folder: Path) -> _Writer:
    """What writes pairs as PNG files."""
    from mobilestereonet.atomic import check_outputs, make_folder
    from mobilestereonet.data import write_png

    check_outputs(*(folder / name for name in ("left.png", "right.png", "calib.txt")))

    def write(raw: _Raw, views: Sequence[Array], calibration: Calibration) -> None:
        for side, view in zip(("left", "right"), views, strict=True):
            path = folder / (f"{side}/{raw.name}.png" if raw.name else f"{side}.png")
            make_folder(path.parent)
            write_png(path, view)
            print(path)

    return write


def _write_calibration(folder: Path, calibration: Calibration) -> None:
    from mobilestereonet.data.calibration import write_calibration

    assert calibration.size is not None
    write_calibration(folder / "calib.txt", calibration, calibration.size)
    print(folder / "calib.txt")


def _bag_writer(path: Path, bag: StereoBag, stack: ExitStack) -> _Writer:
    """What writes pairs to a bag, which the stack closes."""
    from mobilestereonet.streams.bag_file import RectifiedBag

    writer = stack.enter_context(RectifiedBag(path, bag.topics))

    def write(raw: _Raw, views: Sequence[Array], calibration: Calibration) -> None:
        assert raw.pair is not None
        writer.write(raw.pair, views, calibration)

    return write


def _bag_pairs(bag: StereoBag) -> Iterator[_Raw]:
    for pair in bag.pairs():
        yield _Raw(f"{pair.index:06d}", pair.pictures, pair.problem, pair)


def _pairs(left: str, right: str | None, layout: str | None) -> Iterator[_Raw]:
    """Pairs of images, folders, videos or cameras."""
    from mobilestereonet.inference.first_look import ViewOptions
    from mobilestereonet.streams import find_pairs, look_at_stream, open_stream
    from mobilestereonet.streams.open import is_still
    from mobilestereonet.streams.pairs import PairFiles

    sources = [source for source in (left, right) if source is not None]
    # Which halves are views is found out; the rig tells the rest.
    options = ViewOptions(layout, order="left-right", rotate=0)
    if all(map(is_still, sources)):
        yield from _image_pairs(
            [PairFiles("", Path(left), None if right is None else Path(right))], options
        )
    elif not any(Path(source).is_file() or "://" in source for source in sources):
        yield from _image_pairs(find_pairs(left, right), options)
    else:
        stream = open_stream(left, right, layout=layout)
        if right is None:
            findings, stream = look_at_stream(stream, options)
            tell_findings(_of_layout(findings))
        for frame in stream.frames:
            seen = frame.pair
            views = None if seen is None else (seen.left_image, seen.right_image)
            yield _Raw(frame.name, views, frame.problem)


def _image_pairs(pairs: Sequence[PairFiles], options: ViewOptions) -> Iterator[_Raw]:
    """Pairs of image files; those that have both views are looked at first."""
    from mobilestereonet.atomic import note_inputs
    from mobilestereonet.streams.look import look_at_pairs

    note_inputs(*(path for pair in pairs for path in pair.files))
    stacked = False
    if any(pair.right is None for pair in pairs):
        findings, arrangement = look_at_pairs(pairs, options)
        tell_findings(_of_layout(findings))
        stacked = arrangement.top_bottom
    for pair in pairs:
        try:
            yield _Raw(pair.name, _read(pair.left, pair.right, stacked))
        except (InputError, OSError) as error:
            if not pair.name:
                raise
            yield _Raw(pair.name, None, str(error))


def _of_layout(findings: Sequence[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.check == "layout"]


def _read(left: Path, right: Path | None, stacked: bool) -> tuple[Array, Array]:
    """Both views, with the bits of their files; without a right one the left file has both."""
    import numpy as np

    from mobilestereonet.data import read_image
    from mobilestereonet.data.image_files import read_frames
    from mobilestereonet.inference.pair import layout_of

    if right is not None:
        return read_image(left), read_image(right)
    frames = read_frames(left)
    if len(frames) == 1:
        height, width = frames[0].shape[:2]
        layout_of((width, height), "top-bottom" if stacked else None, str(left))
        frames = np.split(frames[0], 2, axis=0 if stacked else 1)
    return frames[0], frames[1]
