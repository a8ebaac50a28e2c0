"""Matching of many pairs: videos, cameras, folders, clusters."""

from mobilestereonet.streams.bag_file import BagFile
from mobilestereonet.streams.batch import PairStatus, match_pairs
from mobilestereonet.streams.cluster import match_on_ray
from mobilestereonet.streams.driving import find_pairs
from mobilestereonet.streams.look import look_at_pairs, look_at_stream
from mobilestereonet.streams.maps import MAP_KINDS, MapFiles
from mobilestereonet.streams.matched import StreamResult
from mobilestereonet.streams.open import open_stream
from mobilestereonet.streams.pairs import PairFiles
from mobilestereonet.streams.rerun_log import RerunLog
from mobilestereonet.streams.stream import StereoFrame, Stream
from mobilestereonet.streams.video import VideoStats, match_video

__all__ = [
    "MAP_KINDS",
    "BagFile",
    "MapFiles",
    "PairFiles",
    "PairStatus",
    "RerunLog",
    "StereoFrame",
    "Stream",
    "StreamResult",
    "VideoStats",
    "find_pairs",
    "look_at_pairs",
    "look_at_stream",
    "match_on_ray",
    "match_pairs",
    "match_video",
    "open_stream",
]
