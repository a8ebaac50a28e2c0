"""Matching of a session's pair, and everything that the page shows of it."""

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
from mobilestereonet.data.rig import Rig
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference import (
    StereoMatcher,
    StereoPair,
    StereoResult,
    load_pair,
)
from mobilestereonet.inference.first_look import problems, put_right
from mobilestereonet.inference.geometry import PointCloud
from mobilestereonet.inference.rectify import Rectifier
from mobilestereonet.plots import colour_disparity
from mobilestereonet.web.sessions import Session

MAX_DEPTH_RATIO = 3.0
"""Depth, as a multiple of the median, beyond which points are left out by default: far ones, whose
depth is poor, would make the rest look tiny."""

MAX_SHOWN_POINTS = 400_000
"""Points that a browser turns smoothly; the PLY has all of them."""

CLOUD = "stereo_points.glb"
"""File of an answer's points for the browser, if there is any."""


@dataclass(frozen=True)
class Geometry:
    """Geometry that the visitor filled in; None where a field is empty.

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
    """Files and texts that the page shows.

    Attributes:
        left: Picture of the left view.
        disparity: Picture of the coloured disparity, of the same size.
        confidence: Picture of the confidence, white is 1; None where the engine has none.
        files: Files to download.
        readings: Data from which `readout.js` reads the depth at a place.
        summary: Model, engine, precision, size and times.
        notes: Warnings about the pair.
    """

    left: Path
    disparity: Path
    confidence: Path | None
    files: list[Path]
    readings: dict[str, Any]
    summary: str
    notes: list[str]


def answer(
    session: Session,
    matcher: StereoMatcher,
    geometry: Geometry,
    rectifier: Rectifier | None = None,
) -> Answer:
    """Match the pictures that a session holds.

    Args:
        session: Has a ``left`` and a ``right`` picture; gets an ``answer``, in place of a former.
        matcher: The matcher.
        geometry: Calibration and limits of the points.
        rectifier: Rectifies the pair, or has its calibration, where the geometry has none.

    Raises:
        InputError: If a picture is missing or damaged, the sizes differ, or the calibration is
            bad.
    """
    calibration = geometry.calibration()
    if calibration is not None:
        rectifier = Rectifier(Rig((calibration,), "the calibration"))
    pair = put_right(
        _load(session),
        rectifier=rectifier,
        max_disparity=matcher.max_disparity,
        shift=matcher.shift,
    )
    calibration = pair.calibration
    result = matcher.match(pair)
    started = time.perf_counter()
    notes = [str(finding) for finding in pair.findings if finding.level not in ("good", "unknown")]
    if calibration is not None and (wrong := problems(pair.findings)):
        notes.append(f"no depth and no points of such views ({wrong[0].check}): put them right")
        calibration = None
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
        assert result.info is not None  # the matcher's results have one
        matched, after = result.info.seconds, time.perf_counter() - started
        return Answer(
            left=left,
            disparity=disparity,
            confidence=files.get("confidence"),
            files=list(files.values()),
            readings=_readings(result, calibration),
            summary=(
                f"{result.info}: matched in {matched:.2f} s, checked and written in {after:.2f} s"
            ),
            notes=notes,
        )


def _load(session: Session) -> StereoPair:
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
        max_depth=geometry.max_depth or MAX_DEPTH_RATIO * median,
        min_confidence=0.0 if result.confidence is None else geometry.min_confidence,
    )


def _thinned(cloud: PointCloud) -> PointCloud:
    step = -(-len(cloud.points) // MAX_SHOWN_POINTS)
    return PointCloud(cloud.points[::step], cloud.colours[::step])


def _readings(result: StereoResult, calibration: Calibration | None) -> dict[str, Any]:
    """Disparity and confidence in a PNG that a browser unpacks: no round trip per movement."""
    levels = np.rint(np.where(result.valid, result.disparity, 0) * KITTI_SCALE)
    high, low = np.divmod(np.where(levels <= 65535, levels, 0), 256)
    confidence = 0 if result.confidence is None else np.rint(255 * result.confidence)
    channels = np.broadcast_arrays(confidence, low, high)
    _, png = cv2.imencode(".png", np.stack(channels, axis=-1).astype(np.uint8))
    return {
        "levels": "data:image/png;base64," + base64.b64encode(png.tobytes()).decode(),
        "scale": KITTI_SCALE,
        "confident": result.confidence is not None,
        "depth": calibration and calibration.focal * calibration.baseline,
        "doffs": calibration and calibration.doffs,
    }
