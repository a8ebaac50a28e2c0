"""Checks of whether a pair is fit for stereo matching, with advice in plain words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.images import Picture

Level: TypeAlias = Literal["good", "warning", "problem", "unknown"]
Points: TypeAlias = NDArray[np.float32]

_MAX_FEATURE_PIXELS = 1_000_000
"""Size in pixels to which larger pictures are scaled down for the feature search."""

_MIN_MATCHES = 30
"""Feature matches below which the geometry is reported as unknown."""


@dataclass(frozen=True)
class Finding:
    """Result of one check of a pair: level, text and advice.

    Attributes:
        check: What was looked at, such as ``rectified``.
        level: ``good``, ``warning`` (worse results), ``problem`` (no sensible result) or
            ``unknown`` (it could not be told).
        text: What was found, with the figure.
        advice: What to do; empty where nothing is to be done.
    """

    check: str
    level: Level
    text: str
    advice: str = ""

    def __str__(self) -> str:
        return f"{self.check}: {self.text}" + (f"; {self.advice}" if self.advice else "")


def quick_checks(left: Picture, right: Picture) -> list[Finding]:
    """Run the checks that cost milliseconds; the matcher runs them on every pair.

    Args:
        left: Left view, (H, W, 3) uint8 RGB.
        right: Right view, the same size.

    Returns:
        Findings on content and exposure.
    """
    return [_content(left, right), _exposure(left, right)]


def check_pair(left: Picture, right: Picture, max_disparity: int = 192) -> list[Finding]:
    """Run all checks: the quick ones, and those that match image features (a second or less).

    Args:
        left: Left view, (H, W, 3) uint8 RGB.
        right: Right view, the same size.
        max_disparity: Disparities that the network searches, in px.

    Returns:
        Findings on content, exposure, rectification, the order of the views and the range.
    """
    findings = quick_checks(left, right)
    if findings[0].level == "problem":
        return findings
    left_points, right_points = match_features(left, right)
    if len(left_points) < _MIN_MATCHES:
        text = f"only {len(left_points)} image features match, too few to tell"
        advice = "make sure that both views show one scene, sharp and with texture"
        return [*findings, Finding("geometry", "unknown", text, advice)]
    disparity, vertical = (left_points - right_points).T
    reach = float(np.percentile(np.abs(left_points - right_points), 95))
    if reach < 0.5:
        text = f"nothing moves between the views (95 % of the features by less than {reach:.1f} px)"
        advice = "take two pictures from places side by side, not one twice"
        return [*findings, Finding("views", "problem", text, advice)]
    if _above_each_other(disparity, vertical):
        text = f"features move by {np.median(np.abs(vertical)):.0f} px vertically (median)"
        advice = "the cameras stand one above the other: turn both views by 90 degrees"
        return [*findings, Finding("rectified", "problem", text, advice)]
    order = _order(disparity)
    findings += [_rectified(vertical, left.shape[0]), order]
    return findings if order.level == "problem" else [*findings, _range(disparity, max_disparity)]


def match_features(left: Picture, right: Picture) -> tuple[Points, Points]:
    """Match SIFT features of both views, filtered by the epipolar geometry.

    Args:
        left: Left view, (H, W, 3) uint8 RGB.
        right: Right view, the same size.

    Returns:
        Matching points in the left and the right view, (N, 2) each, x and y in px.
    """
    scale = min(1.0, (_MAX_FEATURE_PIXELS / (left.shape[0] * left.shape[1])) ** 0.5)
    sift = cv2.SIFT.create(nfeatures=3000)
    features: list[tuple[Any, Any]] = []
    for view in (left, right):
        grey = cv2.cvtColor(view, cv2.COLOR_RGB2GRAY)
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        features.append(sift.detectAndCompute(grey, None))
    (left_keypoints, left_descriptors), (right_keypoints, right_descriptors) = features
    none = np.zeros((0, 2), np.float32)
    if min(len(left_keypoints), len(right_keypoints)) < 2:
        return none, none
    matches = cv2.BFMatcher().knnMatch(left_descriptors, right_descriptors, k=2)
    # A match counts if the second best is clearly worse (Lowe's test).
    best = [first for first, second in matches if first.distance < 0.75 * second.distance]
    if len(best) < _MIN_MATCHES:
        return none, none
    left_points = np.array([left_keypoints[match.queryIdx].pt for match in best], np.float32)
    right_points = np.array([right_keypoints[match.trainIdx].pt for match in best], np.float32)
    _, inliers = cv2.findFundamentalMat(left_points, right_points, cv2.USAC_MAGSAC, 1.0, 0.999)
    if inliers is None:
        return none, none
    kept = inliers.ravel().astype(bool)
    return left_points[kept] / scale, right_points[kept] / scale


def _content(left: Picture, right: Picture) -> Finding:
    difference = cv2.norm(left, right, cv2.NORM_L1) / left.size
    if difference < 0.1:
        text = "both views are the same picture"
        return Finding("content", "problem", text, "give the right camera's picture as second one")
    for name, view in (("left", left), ("right", right)):
        mean, deviation = _mean_and_deviation(view)
        if deviation < 2:
            text = f"the {name} view is blank (all pixels near {mean:.0f} of 255)"
            return Finding("content", "problem", text, "check the camera and the file")
    return Finding("content", "good", "two different pictures")


def _exposure(left: Picture, right: Picture) -> Finding:
    levels = [max(_mean_and_deviation(view)[0], 1.0) for view in (left, right)]
    ratio = max(levels) / min(levels)
    text = f"mean brightness {levels[0]:.0f} and {levels[1]:.0f} of 255"
    if ratio > 1.5:
        advice = "lock exposure, gain and white balance of both cameras to the same values"
        return Finding("exposure", "warning", f"{text}, a factor of {ratio:.1f}", advice)
    return Finding("exposure", "good", text)


def _mean_and_deviation(view: Picture) -> tuple[float, float]:
    """Mean and standard deviation over all pixels and channels."""
    means, deviations = cv2.meanStdDev(view)
    mean = float(means.mean())
    return mean, float(max((deviations**2 + means**2).mean() - mean**2, 0)) ** 0.5


def _above_each_other(disparity: Points, vertical: Points) -> bool:
    """Whether the vertical disparity, not the horizontal one, depends on the depth."""
    differ = float(np.median(np.abs(vertical - np.median(vertical)))) > 0.5
    horizontal = float(np.percentile(np.abs(disparity), 95))
    return differ and float(np.median(np.abs(vertical))) > 4 * horizontal


def _rectified(vertical: Points, height: int) -> Finding:
    offset = float(np.median(vertical))
    size = float(np.median(np.abs(vertical)))
    text = f"matching features are {size:.1f} px apart vertically (median)"
    # What counts is how much of a feature is left in its row: larger pictures have larger features.
    tolerance = max(0.75, height / 2000)
    if size <= tolerance:
        return Finding("rectified", "good", text)
    if float(np.median(np.abs(vertical - offset))) <= 0.5:
        side, move = ("lower", "up") if offset < 0 else ("higher", "down")
        text = f"the right view lies {abs(offset):.1f} px {side} than the left one everywhere"
        advice = f"move the right view {move} by that much, or calibrate and use `msnet rectify`"
    else:
        advice = "calibrate the cameras and use `msnet rectify`: rows must match rows"
    return Finding("rectified", "warning" if size <= 2 * tolerance else "problem", text, advice)


def _order(disparity: Points) -> Finding:
    negative, positive = float(np.mean(disparity < -1)), float(np.mean(disparity > 1))
    shift = -float(np.percentile(disparity, 1))
    converge = (
        "the cameras converge, or the views are cropped differently: rectify them, or move the "
        f"right view {shift:.0f} px to the left and add {-shift:.0f} to the calibration's doffs"
    )
    if negative > max(0.3, 4 * positive):
        text = f"{negative:.0%} of the features move to the right, seen from the left view"
        advice = (
            "the views are swapped: exchange them; but if near things are then blue in the picture "
            f"of `msnet predict`, they were in order, and {converge}"
        )
        return Finding("order", "problem", text, advice)
    if negative > 0.05:
        text = f"{negative:.0%} of the features have a negative disparity, down to {-shift:.0f} px"
        return Finding("order", "problem", text, converge)
    return Finding("order", "good", "left is left and right is right")


def _range(disparity: Points, max_disparity: int) -> Finding:
    low, high = (float(value) for value in np.percentile(disparity, (1, 99)))
    text = f"the features' disparities go from {low:.0f} to {high:.0f} px"
    if high > max_disparity - 1:
        text += f", beyond the network's {max_disparity - 1}"
        factor = 0.9 * (max_disparity - 1) / high
        advice = f"make both views smaller, to {factor:.2f} of their size: disparities shrink too"
        return Finding("range", "problem", text, advice)
    if high < 5:
        advice = "depth will be coarse: use larger pictures, or cameras farther apart"
        return Finding("range", "warning", text, advice)
    return Finding("range", "good", text)
