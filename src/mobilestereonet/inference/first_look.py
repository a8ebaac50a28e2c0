"""The first look at a pair, a folder or a stream: what is wrong, and what can be put right."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace

from mobilestereonet.errors import InputError
from mobilestereonet.inference.arrangement import AS_GIVEN, Arrangement, Turn
from mobilestereonet.inference.checks import Look, Search, check_pair, look_at, quick_checks
from mobilestereonet.inference.finding import Finding
from mobilestereonet.inference.pair import LAYOUTS, StereoPair
from mobilestereonet.inference.rectify import Rectifier

ORDERS = ("left-right", "right-left")
ROTATIONS = (0, 90, 180, 270)

_LOOK_SIZE_PX = 512
"""Longer side to which larger pictures are scaled down for the first look."""

_LAYOUT_SIZE_PX = 320
"""The same, to find out whether one view lies above the other."""

_STACKED = Finding(
    "layout",
    "fixed",
    "the picture has one view above the other: it was split so",
    "if it has not: --layout side-by-side",
)


@dataclass(frozen=True)
class ViewOptions:
    """How the views lie, as the user says; None leaves it to the first look.

    Attributes:
        layout: Of one picture with both views, one of `LAYOUTS`.
        order: One of `ORDERS`; of views one above the other, the upper one is the first.
        rotate: Degrees by which both views are turned clockwise, one of `ROTATIONS`.
    """

    layout: str | None = None
    order: str | None = None
    rotate: int | None = None

    def __post_init__(self) -> None:
        for name, choices in (("layout", LAYOUTS), ("order", ORDERS), ("rotate", ROTATIONS)):
            value = getattr(self, name)
            if value is not None and value not in choices:
                listed = ", ".join(map(str, choices))
                raise InputError(f"{name} is one of {listed}; got {value!r}")

    @property
    def arrangement(self) -> Arrangement:
        """What the user asks for."""
        turn = Turn(self.rotate or 0)
        return Arrangement(self.layout == "top-bottom", turn, turn, self.order == "right-left")


def first_look(
    pair: StereoPair,
    options: ViewOptions | None = None,
    rectifier: Rectifier | None = None,
    *,
    max_disparity: float = math.inf,
    shift: int = 0,
) -> tuple[Arrangement, tuple[Finding, ...]]:
    """Look at a pair before it is matched, in less than 0.3 s.

    Args:
        pair: The pair as it was given.
        options: What the user says about it.
        rectifier: What rectifies the pair, or has its calibration, once it is arranged. Views
            that it has rectified are of the rig's left and right camera: they are not exchanged
            or turned afterwards.
        max_disparity: Disparities below this are searched, in px.
        shift: Disparity from which on they are, in px.

    Returns:
        What puts the pair right, to be applied to it and to all that come from the same source;
        and what was found. A finding is ``fixed`` if the arrangement puts it right.
    """
    options = options or ViewOptions()
    start, findings = options.arrangement, list(pair.findings)
    if options.layout is None and _is_stacked(pair, start):
        start = replace(start, top_bottom=True)
        findings.append(_STACKED)
    raw = rectifier is not None and rectifier.rectifies
    arranged = _with_calibration(start(pair), rectifier)
    findings += quick_checks(arranged.left_image, arranged.right_image)
    if any(finding.level == "problem" for finding in findings):
        return start, tuple(findings)
    doffs = 0.0 if arranged.calibration is None else arranged.calibration.doffs
    look = _look(arranged, _LOOK_SIZE_PX, Search(max_disparity, shift, doffs))
    found = AS_GIVEN if raw else look.arrangement
    if options.rotate is not None and (found.left or found.right):
        found = AS_GIVEN  # what the user turned is not turned again
    if options.order is not None:
        found = replace(found, swapped=False)
    findings += [_after(finding, found, options, raw) for finding in look.findings]
    if options.layout is None:
        findings += _not_two_views(pair, look.findings)
    turns = (found.right, found.left) if start.swapped else (found.left, found.right)
    return (
        Arrangement(
            start.top_bottom,
            turns[0] or start.left,
            turns[1] or start.right,
            start.swapped or found.swapped,
        ),
        tuple(findings),
    )


def put_right(
    pair: StereoPair,
    options: ViewOptions | None = None,
    rectifier: Rectifier | None = None,
    *,
    max_disparity: float = math.inf,
    shift: int = 0,
) -> StereoPair:
    """A pair after the first look, rectified and with its findings; see `first_look`.

    Raises:
        InputError: If one picture was given, and it is not one with two views.
    """
    arrangement, findings = first_look(
        pair, options, rectifier, max_disparity=max_disparity, shift=shift
    )
    require_two_views(findings)
    pair = arrangement(pair)
    return replace(pair if rectifier is None else rectifier.pair(pair), findings=findings)


def check_whole(
    pair: StereoPair,
    max_disparity: int,
    rectifier: Rectifier | None = None,
    options: ViewOptions | None = None,
) -> list[Finding]:
    """All checks of a pair at full size, as it was given: what is wrong is not put right.

    One picture with both views is split as its content says, unless the user does.

    Args:
        pair: The pair as it was given.
        max_disparity: Disparities that the network searches, in px.
        rectifier: What rectifies it, or has its calibration.
        options: What the user says about the views.
    """
    options = options or ViewOptions()
    start, findings = options.arrangement, list(pair.findings)
    if options.layout is None and _is_stacked(pair, start):
        start = replace(start, top_bottom=True)
        findings.append(_STACKED)
    pair = start(pair)
    if rectifier is not None:
        pair = rectifier.pair(pair)
    doffs = 0.0 if pair.calibration is None else pair.calibration.doffs
    found = check_pair(pair.left_image, pair.right_image, max_disparity, doffs)
    if options.layout is None:
        findings += _not_two_views(pair, found)
    return [*findings, *found]


def require_two_views(findings: Iterable[Finding], name: str = "") -> None:
    """Check that one picture with both views was found to be one.

    Args:
        findings: What was found at it.
        name: What messages call it.

    Raises:
        InputError: If it was not.
    """
    for finding in problems(findings):
        if finding.check == "layout":
            raise InputError(f"{name}{': ' * bool(name)}{finding.text}: {finding.advice}")


def _not_two_views(pair: StereoPair, found: Iterable[Finding]) -> list[Finding]:
    """What is said of one picture, or of its source, if its halves show no common scene.

    Halves of one view may be alike if one is mirrored: many things are symmetric.

    Args:
        pair: The pair as it came.
        found: What was found at the two halves.
    """
    unlike = [f for f in found if f.check in ("overlap", "geometry", "content", "orientation")]
    unlike = [finding for finding in unlike if finding.level in ("problem", "unknown")]
    if not pair.layout or not unlike:
        return []
    return [
        Finding(
            "layout",
            "problem",
            f"the picture's halves are not two views of one scene ({unlike[0].text})",
            "give the right view, too, if it is the left one; that it has both views, --layout "
            f"{pair.layout} says",
        )
    ]


def findings_of(pair: StereoPair) -> tuple[Finding, ...]:
    """Findings of a pair, those of the quick checks among them."""
    known = {finding.check for finding in pair.findings}
    quick = [] if "content" in known else quick_checks(pair.left_image, pair.right_image)
    return (*pair.findings, *quick)


def problems(findings: Iterable[Finding]) -> list[Finding]:
    """Findings with which there is no sensible result."""
    return [finding for finding in findings if finding.level == "problem"]


def warn_of(findings: Iterable[Finding], stacklevel: int = 2) -> None:
    """Warn of what was put right, and of what leaves no sensible result.

    Args:
        findings: What was found at a pair.
        stacklevel: Whose line the warnings show: 1 is the caller's.
    """
    for finding in findings:
        if finding.level in ("fixed", "problem"):
            warnings.warn(str(finding), stacklevel=stacklevel + 1)


def _with_calibration(pair: StereoPair, rectifier: Rectifier | None) -> StereoPair:
    """A pair that is rectified, or has its calibration where that fits before it is turned."""
    if rectifier is None:
        return pair
    try:
        return rectifier.pair(pair)
    except InputError:
        if rectifier.rectifies:
            raise
        return pair


def _look(pair: StereoPair, size: int, search: Search | None = None) -> Look:
    scale = min(1.0, size / max(pair.width, pair.height))
    return look_at(pair.left_image, pair.right_image, scale, search)


def _is_stacked(pair: StereoPair, start: Arrangement) -> bool:
    """Whether a picture's upper and lower half have more in common than its left and right one."""
    if pair.layout != "side-by-side" or pair.height % 2:
        return False
    plain = replace(pair, calibration=None)
    beside, stacked = (
        _look(replace(start, top_bottom=layout)(plain), _LAYOUT_SIZE_PX).matches
        for layout in (False, True)
    )
    return stacked > 2 * beside


def _after(finding: Finding, found: Arrangement, options: ViewOptions, raw: bool) -> Finding:
    """A finding after what it is about was put right, or was overruled.

    Args:
        finding: The finding.
        found: What puts the pair right.
        options: What the user says about it.
        raw: Whether it was rectified before it was looked at.
    """
    if finding.check == "orientation" and (found.left or found.right):
        advice = "it was turned; --rotate 0 leaves the views as they are"
        return replace(finding, level="fixed", advice=advice)
    if finding.check == "order" and found.swapped:
        text = f"{finding.text}: the views were swapped, and have been exchanged"
        advice = "if they were in order (cameras that converge): --order left-right"
        return replace(finding, level="fixed", text=text, advice=advice)
    if finding.check == "order" and finding.level == "problem" and options.order is not None:
        advice = f"the views were taken as they are, as order {options.order} says"
        return replace(finding, level="warning", advice=advice)
    if finding.check == "orientation" and options.rotate is not None:
        advice = f"the views were taken as they are, as rotate {options.rotate} says"
        return replace(finding, level="warning", advice=advice)
    if finding.check == "order" and raw and finding.advice.startswith("the views are swapped"):
        advice = "the files are exchanged: give them in the rig's order, or --order right-left"
        return replace(finding, advice=advice)
    if finding.check == "orientation" and raw:
        advice = "give the views as the rig's cameras took them, or turn them (--rotate)"
        return replace(finding, advice=advice)
    return finding
