"""Checks of whether a pair is fit for stereo matching, with advice in plain words."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mobilestereonet.data.images import Picture
from mobilestereonet.engines.scaled import MIN_SCALE
from mobilestereonet.inference.arrangement import (
    AS_GIVEN,
    Arrangement,
    Turn,
    find_turns,
    is_swapped,
)
from mobilestereonet.inference.features import (
    Points,
    find_features,
    match_features,
    small_grey,
)
from mobilestereonet.inference.finding import Finding

_MAX_FEATURE_PIXELS = 1_000_000
"""Size in pixels to which larger pictures are scaled down for the feature search."""

_SPARE_PX = 8
"""By how much a search begins below the smallest disparity of the features."""

_OUTSIDE = 0.05
"""Share of the features above which their disparities are no wrong matches."""

_MISSING_ROWS = 0.1
"""Share of rows of one colour that one view has more than the other: it is damaged from then on."""

_FEATURES_OF_A_SCENE = 300
"""Features of each view from which on a scene that both show would be recognised."""

_MIN_ALIKE = 5
"""Fewest feature matches of a common scene, beyond twice those found by chance."""


def quick_checks(left: Picture, right: Picture) -> list[Finding]:
    """Run the checks that cost milliseconds; the matcher runs them on every pair.

    Args:
        left: Left view, (H, W, 3) uint8 RGB.
        right: Right view, the same size.

    Returns:
        Findings on content and exposure.
    """
    return [_content(left, right), _exposure(left, right)]


def check_pair(
    left: Picture, right: Picture, max_disparity: int = 192, doffs: float = 0.0
) -> list[Finding]:
    """Run all checks: the quick ones, and those that match image features (a second or less).

    Args:
        left: Left view, (H, W, 3) uint8 RGB.
        right: Right view, the same size.
        max_disparity: Disparities that the network searches, in px.
        doffs: Difference of the principal points in px, which cameras that converge have.

    Returns:
        Findings on content, exposure, rectification, the order of the views and the range.
    """
    findings = quick_checks(left, right)
    if findings[0].level == "problem":
        return findings
    scale = min(1.0, (_MAX_FEATURE_PIXELS / (left.shape[0] * left.shape[1])) ** 0.5)
    search = Search(max_disparity, doffs=doffs)
    return [*findings, *look_at(left, right, scale, search).findings]


@dataclass(frozen=True)
class Look:
    """What features say about a pair.

    Attributes:
        findings: On the views' direction, rows, order and range of disparities.
        arrangement: What puts right that the views are turned, mirrored or swapped.
        matches: Number of features that both views show.
    """

    findings: tuple[Finding, ...]
    arrangement: Arrangement = AS_GIVEN
    matches: int = 0


@dataclass(frozen=True)
class Search:
    """Disparities that are searched, and those that there can be.

    Attributes:
        end: First disparity that is not searched any more, in px.
        start: First one that is, in px.
        doffs: Difference of the principal points in px, where a calibration tells it: nothing in
            front of the cameras has a disparity below its negative.
    """

    end: float = math.inf
    start: int = 0
    doffs: float = 0.0

    @property
    def lowest(self) -> float:
        """Lowest disparity of views in the right order, in px: -doffs, or the search's start."""
        return min(-self.doffs, self.start)


def look_at(left: Picture, right: Picture, scale: float, search: Search | None = None) -> Look:
    """Match features of both views, and say what follows.

    Args:
        left: Left view, (H, W, 3) uint8 RGB.
        right: Right view, the same size.
        scale: Factor by which the pictures are made smaller for it.
        search: Disparities to judge by; by default all from 0 px on.
    """
    search = search or Search()
    greys = [small_grey(view, scale) for view in (left, right)]
    flat = [float(np.mean(np.ptp(grey, axis=1) <= 2)) for grey in greys]
    if abs(flat[0] - flat[1]) > _MISSING_ROWS:
        return Look((_damaged(flat),))
    here, there = (find_features(grey) for grey in greys)
    height, width = greys[0].shape
    seen, mirrored = match_features(here, there), False
    alike = seen.alike
    if not len(seen):
        mirror = Turn(mirrored=True)
        seen = match_features(here, find_features(mirror.picture(greys[1])))
        mirrored = bool(len(seen))
        seen = replace(seen, right=mirror.points(seen.right, (width, height)))
    if not len(seen):
        counts = len(here.points), len(there.points)
        return Look((_nothing_in_common(counts, alike, by_chance=seen.alike),))
    turns = find_turns(seen, mirrored, (width, height), search.lowest * scale)
    places = turns.points(seen, (width, height))
    disparity, vertical = (places[0] - places[1]).T / scale
    findings = [_turned(turns)] if turns.left or turns.right else []
    reach = float(np.percentile(np.hypot(disparity, vertical), 95))
    if reach < 0.5:
        text = f"nothing moves between the views (95 % of the features by less than {reach:.1f} px)"
        advice = "take two pictures from places side by side, not one twice"
        return Look((*findings, Finding("views", "problem", text, advice)), matches=len(seen))
    order = _order(disparity, search.lowest)
    swapped = is_swapped(disparity - search.lowest)
    findings += [_rectified(vertical, height / scale, 1 / scale), order]
    if swapped or order.level != "problem":
        findings.append(_range(-disparity if swapped else disparity, search))
    return Look(tuple(findings), replace(turns, swapped=swapped), len(seen))


def _damaged(flat: list[float]) -> Finding:
    """One view has rows of one colour where the other has none."""
    side = "left" if flat[0] > flat[1] else "right"
    text = f"{max(flat):.0%} of the {side} view's rows are of one colour, and not of the other's"
    return Finding("content", "problem", text, "a part of it is missing: take it again")


def _nothing_in_common(features: tuple[int, int], alike: int, by_chance: int) -> Finding:
    """Nothing can be told, or there is no common scene: then a mirrored one is as much alike."""
    text = f"{alike} of {features[0]} and {features[1]} image features match"
    if min(features) < _FEATURES_OF_A_SCENE or alike > 2 * by_chance + _MIN_ALIKE:
        text += ", too few to tell"
        advice = "make sure that both views show one scene, sharp and with texture"
        return Finding("geometry", "unknown", text, advice)
    text += ": no common scene"
    advice = "give two views of one scene, taken at one moment from places side by side"
    return Finding("overlap", "problem", text, advice)


def _turned(turns: Arrangement) -> Finding:
    if turns.left == turns.right:
        text = "features move up or down, not sideways"
        advice = "the cameras stand one above the other: turn both views by 90 degrees"
        return Finding("orientation", "problem", text, advice)
    side, turn = ("left", turns.left) if turns.left else ("right", turns.right)
    text = f"the {side} view is {turn.undone} against the other one"
    return Finding("orientation", "problem", text, "turn it as the other one is")


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


def _rectified(vertical: Points, height: float, pixel: float) -> Finding:
    """How far rows are apart; ``pixel``: size of one in which features were found."""
    offset = float(np.median(vertical))
    size = float(np.median(np.abs(vertical)))
    text = f"matching features are {size:.1f} px apart vertically (median)"
    # What counts is how much of a feature is left in its row: larger pictures have larger features.
    tolerance = max(0.75 * pixel, height / 2000)
    if size <= tolerance:
        return Finding("rectified", "good", text)
    if float(np.median(np.abs(vertical - offset))) <= 0.5:
        side, move = ("lower", "up") if offset < 0 else ("higher", "down")
        text = f"the right view lies {abs(offset):.1f} px {side} than the left one everywhere"
        advice = f"move the right view {move} by that much, or calibrate and use `msnet rectify`"
    else:
        advice = "calibrate the cameras and use `msnet rectify`: rows must match rows"
    return Finding("rectified", "warning" if size <= 2 * tolerance else "problem", text, advice)


def _order(disparity: Points, lowest: float) -> Finding:
    """Whether disparities lie above the lowest one that there is."""
    negative = float(np.mean(disparity < lowest - 1))
    shift = -float(np.percentile(disparity, 1))
    remedy = f"rectify, or let the search begin there (--shift {-math.ceil(shift) - _SPARE_PX})"
    converge = (
        "the cameras converge, the views are cropped differently, or they are in the wrong order "
        f"(--order right-left): {remedy}"
    )
    if is_swapped(disparity - lowest):
        text = f"{negative:.0%} of the features move to the right, seen from the left view"
        advice = (
            "the views are swapped: exchange them. If near things come out blue then, they were "
            f"in order, and the cameras converge: {remedy}"
        )
        return Finding("order", "problem", text, advice)
    if negative > 0.02:
        kind = f"disparity below {round(lowest)} px" if lowest else "negative disparity"
        text = f"{negative:.0%} of the features have a {kind}, down to {round(-shift)} px"
        if negative > _OUTSIDE:
            return Finding("order", "problem", text, converge)
        return Finding("order", "unknown", text, f"a few wrong matches, or {converge}")
    return Finding("order", "good", "left is left and right is right")


def _range(disparity: Points, search: Search) -> Finding:
    low, high = (float(value) for value in np.percentile(disparity, (1, 99)))
    text = f"the features' disparities go from {round(low)} to {round(high)} px"
    if high > search.end - 1:
        text += f", beyond the network's {search.end - 1}"
        return Finding("range", "problem", text, _beyond(low, high, search))
    if float(np.mean(disparity < search.start - 1)) > _OUTSIDE:
        text += f", and the search begins at {search.start}"
        advice = f"let it begin below them (--shift {math.floor(low) - _SPARE_PX})"
        # Who lets it begin above 0 wants to see near things alone.
        return Finding("range", "warning" if search.start > 0 else "problem", text, advice)
    if high < 5 + search.lowest:
        advice = "depth will be coarse: use larger pictures, or cameras farther apart"
        return Finding("range", "warning", text, advice)
    return Finding("range", "good", text)


def _beyond(low: float, high: float, search: Search) -> str:
    """What to do about disparities from ``low`` to ``high``, beyond the network's."""
    factor = 0.9 * (search.end - 1) / high
    advice = f"make both views smaller, to {factor:.2f} of their size: disparities shrink too"
    if factor >= MIN_SCALE:
        advice = f"match them smaller (--scale {factor:.2f}): disparities shrink, too"
    start = math.floor(low) - _SPARE_PX
    if start > 0 and high < start + search.end - search.start - 1:
        advice += f"; or let the search begin near {round(low)} px (--shift {start})"
    return advice
