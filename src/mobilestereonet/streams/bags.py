"""Bags of ROS 1 and ROS 2 as streams."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier
from mobilestereonet.streams.stereo_bag import TOLERANCE_S, BagPair, StereoBag
from mobilestereonet.streams.stream import StereoFrame, Stream, make_frame

BAG_FORMATS = (".mcap", ".bag", ".db3")


def is_bag(source: str | Path) -> bool:
    """Whether a source is a bag: a file of `BAG_FORMATS`, or the folder of a ROS 2 bag."""
    path = Path(source)
    return path.suffix.lower() in BAG_FORMATS or (path / "metadata.yaml").is_file()


def open_bag(
    path: str | Path,
    left: str | None = None,
    right: str | None = None,
    tolerance: float = TOLERANCE_S,
    *,
    rectify: bool = True,
) -> Stream:
    """Open a bag of ROS 1 (``.bag``) or ROS 2 (``.mcap``, ``.db3``, or the folder of one).

    Views whose stamps differ by no more than ``tolerance`` are a pair; an image without a partner
    becomes a frame with a problem. The calibration is that of the topics ``camera_info`` beside
    the images. Images that it calls distorted are rectified by it, unless the names of their
    topics say that they are (``image_rect``).

    Args:
        path: The bag.
        left: Topic of the left images: raw or compressed, see `picture_of`.
        right: Topic of the right images.
        tolerance: Largest difference between the stamps of a pair, in s.
        rectify: False leaves raw images as they are, without the bag's calibration: somebody who
            has another one rectifies them.

    Raises:
        FileNotFoundError: If there is no such bag.
        InputError: If it cannot be read, or a topic is missing or none of images; the message
            lists the topics that are.
    """
    bag = StereoBag.open(path, left, right, tolerance)
    raw = bag.raw_rig
    rectifier = Rectifier(raw) if rectify and raw is not None else None
    known = rectify or raw is None
    return Stream(
        _frames(bag, rectifier),
        total=bag.total,
        calibration=bag.calibration if known else None,
        topics=bag.topics,
        camera_infos=bag.camera_infos,
    )


def _frames(bag: StereoBag, rectifier: Rectifier | None) -> Generator[StereoFrame]:
    with closing(bag.pairs()) as pairs:
        for pair in pairs:
            frame = _frame(pair, rectifier)
            stamps, frame_ids = pair.stamps, pair.frame_ids
            yield replace(
                frame,
                stamp=stamps[1] if stamps[0] is None else stamps[0],
                frame_id=frame_ids[0] or frame_ids[1],
                right_stamp=stamps[1],
                right_frame_id=frame_ids[1],
            )


def _frame(pair: BagPair, rectifier: Rectifier | None) -> StereoFrame:
    try:
        if pair.pictures is None:
            raise InputError(pair.problem)
        pictures = pair.pictures if rectifier is None else rectifier(*pair.pictures)[:2]
        return make_frame(pair.index, pair.seconds, pictures)
    except InputError as error:
        return StereoFrame(pair.index, f"{pair.index:06d}", pair.seconds, None, str(error))
