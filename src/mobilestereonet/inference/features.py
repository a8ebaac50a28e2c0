"""Image features of a pair, matched: what the checks of its geometry rest on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.images import Array, Picture

Points: TypeAlias = NDArray[np.float32]
"""Places in a picture, (N, 2) float32: x and y in px."""

MIN_MATCHES = 30
"""Matches from which on they tell a geometry: fewer may agree by chance."""

_MAX_FEATURES = 1200
_MAX_DISTANCE_RATIO = 0.75
"""A match counts if the second best is farther by this factor (Lowe's test)."""


class Features(NamedTuple):
    """SIFT features of a picture: places and directions (degrees) in it, and descriptors."""

    points: Points
    angles: NDArray[np.float32]
    descriptors: Array


@dataclass(frozen=True, eq=False)
class Matches:
    """Features that both views show, in px of the small pictures.

    Attributes:
        left: Their places in the left view.
        right: Their places in the right view.
        turn: Multiple of 90 degrees by which the right view is turned clockwise against the left.
        alike: Number of features with a clear counterpart, before the epipolar geometry is asked.
    """

    left: Points
    right: Points
    turn: int = 0
    alike: int = 0

    def __len__(self) -> int:
        return len(self.left)


def small_grey(view: Picture, scale: float) -> Array:
    """A view as grey levels, made smaller by a factor."""
    grey = cv2.cvtColor(view, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def find_features(grey: Array) -> Features:
    """Find SIFT features of a grey picture (H, W) uint8."""
    keypoints, descriptors = cv2.SIFT.create(nfeatures=_MAX_FEATURES).detectAndCompute(grey, None)
    if descriptors is None:
        descriptors = np.zeros((0, 128), np.float32)
    points = np.array([point.pt for point in keypoints], np.float32).reshape(-1, 2)
    return Features(points, np.array([point.angle for point in keypoints], np.float32), descriptors)


def match_features(left: Features, right: Features) -> Matches:
    """Match features, filtered by the epipolar geometry; none if there are too few to tell."""
    nowhere = np.zeros((0, 2), np.float32)
    if min(len(left.points), len(right.points)) < MIN_MATCHES:
        return Matches(nowhere, nowhere)
    pairs: Any = cv2.BFMatcher().knnMatch(left.descriptors, right.descriptors, k=2)
    best = [one for one, two in pairs if one.distance < _MAX_DISTANCE_RATIO * two.distance]
    none = Matches(nowhere, nowhere, alike=len(best))
    if len(best) < MIN_MATCHES:
        return none
    here, there = [one.queryIdx for one in best], [one.trainIdx for one in best]
    points = left.points[here], right.points[there]
    _, inliers = cv2.findFundamentalMat(*points, cv2.USAC_MAGSAC, 1.0, 0.999)
    if inliers is None or inliers.sum() < MIN_MATCHES:
        return none
    kept = inliers.ravel().astype(bool)
    # Each match votes for a number of quarter turns.
    turns = np.deg2rad(right.angles[there] - left.angles[here])[kept]
    votes = np.bincount(np.rint(turns / (np.pi / 2)).astype(int) % 4, minlength=4)
    return Matches(points[0][kept], points[1][kept], 90 * int(votes.argmax()), len(best))
