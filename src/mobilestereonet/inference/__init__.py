"""From a pair of images to a disparity map, and on to metres."""

from mobilestereonet.inference.checks import Finding, check_pair
from mobilestereonet.inference.geometry import PointCloud
from mobilestereonet.inference.matcher import DEFAULT_MODEL, StereoMatcher
from mobilestereonet.inference.prepare import View, load_pair
from mobilestereonet.inference.rectify import rectify_pair
from mobilestereonet.inference.result import StereoResult

__all__ = [
    "DEFAULT_MODEL",
    "Finding",
    "PointCloud",
    "StereoMatcher",
    "StereoResult",
    "View",
    "check_pair",
    "load_pair",
    "rectify_pair",
]
