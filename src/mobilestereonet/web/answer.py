"""From a session's pair to everything that the page shows of it."""

from __future__ import annotations

import base64
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mobilestereonet.data.depth_files import write_depth
from mobilestereonet.data.disparity_files import KITTI_SCALE
from mobilestereonet.data.files import write_png
from mobilestereonet.data.images import to_picture
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoMatcher, StereoResult, check_pair, load_pair
from mobilestereonet.inference.geometry import PointCloud
from mobilestereonet.plots import colour_disparity
from mobilestereonet.web.sessions import Session

FAR = 3.0
"""Points beyond so many median depths are left out unless told otherwise: the far ones, whose
depth is poor, would make the rest look tiny."""

SHOWN = 400_000
"""Points that a browser turns smoothly; the PLY has all of them."""

CLOUD = "stereo_points.glb"
"""File of an answer's points for the browser, if there is any."""


@dataclass(frozen=True)
class Geometry:
    """What the visitor filled in; None where nothing is.

    Attributes:
        focal: Focal length in px.
        baseline: Distance of the cameras in metres.
        doffs: Difference of the principal points in px.
        max_depth: Farther points are left out, in metres.
        min_confidence: Less confident ones are left out.
    """

    focal: float | None = None
    baseline: float | None = None
    doffs: float | None = None
    max_depth: float | None = None
    min_confidence: float = 0.0

    def calibration(self) -> Calibration | None:
        """The calibration, None if it is left empty.

        Raises:
            InputError: If a number is impossible, or one of two is missing.
        """
        # An empty field of the page may come as 0.
        if not self.focal and not self.baseline:
            return None
        if not self.focal or not self.baseline:
            name = "baseline" if self.focal else "focal length"
            raise InputError(f"the {name} is 0 or missing: fill in both, or none (then no depth)")
        return Calibration(self.focal, self.baseline, self.doffs or 0.0)


@dataclass(frozen=True)
class Answer:
    """What the page shows.

    Attributes:
        left: The left view.
        disparity: The coloured disparity, as large.
        confidence: The confidence, white is sure; None where the engine tells none.
        files: What can be downloaded.
        readings: What the page needs to tell the depth at a place (`readout.js` reads it).
        facts: What was run, and how long it took.
        notes: What the visitor should know about the pair.
    """

    left: Path
    disparity: Path
    confidence: Path | None
    files: list[Path]
    readings: dict[str, Any]
    facts: str
    notes: list[str]


def answer(session: Session, matcher: StereoMatcher, geometry: Geometry) -> Answer:
    """Match the pictures that a session holds.

    Args:
        session: Has a ``left`` and a ``right`` picture; gets an ``answer``, in place of a former.
        matcher: What matches them.
        geometry: What makes metres of the disparity.

    Raises:
        InputError: If a picture is missing or damaged, the sizes differ, or the calibration is
            bad.
    """
    calibration = geometry.calibration()
    pair = _load(session)
    views = to_picture(pair[0]), to_picture(pair[1])
    result = matcher(*pair)
    started = time.perf_counter()
    findings = check_pair(*views, max_disparity=matcher.runtime.max_disparity)
    notes = [str(finding) for finding in findings if finding.level in ("warning", "problem")]
    with session.replace("answer") as folder:
        files = result.save(folder, "stereo")
        left, disparity = folder / "left.png", folder / "stereo_disparity_colours.png"
        write_png(left, result.left)
        write_png(disparity, colour_disparity(result.disparity, valid=result.valid))
        files["colours"] = disparity
        if calibration is not None:
            for suffix in (".png", ".npy"):
                files[f"depth{suffix}"] = folder / f"stereo_depth{suffix}"
                write_depth(files[f"depth{suffix}"], result.depth(calibration))
            points = _points(result, calibration, geometry)
            if len(points.points):
                files["points"] = folder / "stereo_points.ply"
                points.save(files["points"])
                files["cloud"] = folder / CLOUD
                _thinned(points).save(files["cloud"])
            else:
                notes.append("points: none is as near and as sure as asked for")
        facts = "{model} on {runtime} ({precision}), {width} x {height} px".format(**result.facts)
        matched, after = result.facts["seconds"], time.perf_counter() - started
        return Answer(
            left=left,
            disparity=disparity,
            confidence=files.get("confidence"),
            files=list(files.values()),
            readings=_readings(result, calibration),
            facts=f"{facts}: matched in {matched:.2f} s, checked and written in {after:.2f} s",
            notes=notes,
        )


def _load(session: Session) -> tuple[Any, Any]:
    left, right = session.file("left"), session.file("right")
    if left is None or right is None:
        side = "right" if left else "left"
        raise InputError(f"there is no {side} picture (any more): choose one")
    try:
        return load_pair(left, right)
    except (InputError, OSError) as error:
        # Where the server keeps its files is nobody's business.
        text = str(error).replace(str(left), "left picture").replace(str(right), "right picture")
        raise InputError(text) from None


def _points(result: StereoResult, calibration: Calibration, geometry: Geometry) -> PointCloud:
    depth = result.depth(calibration)
    median = float(np.median(depth[depth > 0])) if depth.any() else 0.0
    return result.points(
        calibration,
        max_depth=geometry.max_depth or FAR * median,
        min_confidence=0.0 if result.confidence is None else geometry.min_confidence,
    )


def _thinned(cloud: PointCloud) -> PointCloud:
    step = -(-len(cloud.points) // SHOWN)
    return PointCloud(cloud.points[::step], cloud.colours[::step])


def _readings(result: StereoResult, calibration: Calibration | None) -> dict[str, Any]:
    """Disparity and confidence in a PNG that a browser unpacks: no round trip per movement."""
    levels = np.rint(np.where(result.valid, result.disparity, 0) * KITTI_SCALE)
    high, low = np.divmod(np.where(levels <= 65535, levels, 0), 256)
    sure = np.zeros_like(low) if result.confidence is None else np.rint(255 * result.confidence)
    _, png = cv2.imencode(".png", np.stack((sure, low, high), axis=-1).astype(np.uint8))
    return {
        "levels": "data:image/png;base64," + base64.b64encode(png.tobytes()).decode(),
        "scale": KITTI_SCALE,
        "confident": result.confidence is not None,
        "depth": calibration and calibration.focal * calibration.baseline,
        "doffs": calibration and calibration.doffs,
    }
