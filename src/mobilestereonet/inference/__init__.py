"""From a pair of images to a disparity map."""

from mobilestereonet.inference.matcher import DEFAULT_MODEL, StereoMatcher
from mobilestereonet.inference.prepare import View, load_pair
from mobilestereonet.inference.result import StereoResult

__all__ = ["DEFAULT_MODEL", "StereoMatcher", "StereoResult", "View", "load_pair"]
