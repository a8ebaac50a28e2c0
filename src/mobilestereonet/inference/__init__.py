"""Inference: from a pair of images to disparity, depth and points."""

from mobilestereonet.inference.checks import check_pair
from mobilestereonet.inference.filter import MetricFilter
from mobilestereonet.inference.finding import Finding
from mobilestereonet.inference.geometry import PointCloud
from mobilestereonet.inference.matcher import StereoMatcher
from mobilestereonet.inference.mesh import Mesh
from mobilestereonet.inference.pair import ImageLike, StereoPair, load_pair
from mobilestereonet.inference.quality import DEFAULT_MODEL, DEFAULT_QUALITY, QUALITIES, Quality
from mobilestereonet.inference.rectify import Rectifier
from mobilestereonet.inference.result import StereoResult
from mobilestereonet.inference.run_info import RunInfo

__all__ = [
    "DEFAULT_MODEL",
    "DEFAULT_QUALITY",
    "QUALITIES",
    "Finding",
    "ImageLike",
    "Mesh",
    "MetricFilter",
    "PointCloud",
    "Quality",
    "Rectifier",
    "RunInfo",
    "StereoMatcher",
    "StereoPair",
    "StereoResult",
    "check_pair",
    "load_pair",
]
