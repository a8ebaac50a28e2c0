"""Many pairs: videos, cameras, folders, and a cluster that shares them out."""

from mobilestereonet.streams.batch import Outcome, match_pairs
from mobilestereonet.streams.cluster import match_on_ray
from mobilestereonet.streams.maps import MAP_KINDS, MapFiles
from mobilestereonet.streams.open import open_stream
from mobilestereonet.streams.pairs import Pair, find_pairs
from mobilestereonet.streams.stream import StereoFrame, Stream
from mobilestereonet.streams.video import Tally, match_video

__all__ = [
    "MAP_KINDS",
    "MapFiles",
    "Outcome",
    "Pair",
    "StereoFrame",
    "Stream",
    "Tally",
    "find_pairs",
    "match_on_ray",
    "match_pairs",
    "match_video",
    "open_stream",
]
