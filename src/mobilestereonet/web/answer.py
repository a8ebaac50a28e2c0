"""Matching of a session's pair, and everything that the page shows of it."""

from __future__ import annotations

import base64
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import cv2
import numpy as np

from mobilestereonet.data.depth_files import write_depth
from mobilestereonet.data.disparity_files import KITTI_SCALE
from mobilestereonet.data.files import write_png
from mobilestereonet.data.images import Picture
from mobilestereonet.data.sample import Calibration
from mobilestereonet.inference import StereoMatcher, StereoPair, StereoResult
from mobilestereonet.inference.first_look import problems, put_right
from mobilestereonet.inference.geometry import PointCloud
from mobilestereonet.inference.rectify import Rectifier
from mobilestereonet.plots import colour_disparity
from mobilestereonet.web.cameras import ASSUMED, Geometry, Size
from mobilestereonet.web.sessions import Session

MAX_DEPTH_RATIO = 3.0
"""Depth, as a multiple of the median, beyond which points are left out by default: far ones, whose
depth is poor, would make the rest look tiny."""

MAX_SHOWN_POINTS = 400_000
"""Points that a browser turns smoothly; the PLY has all of them."""

CLOUD = "stereo_points.glb"
"""File of an answer's points for the browser, if there is any."""

MESH = "stereo_mesh.glb"
"""File of an answer's surface for the browser and Blender, if there is any."""

SHAPE_ASPECT = 1.5
"""Width by height of the view in 3D, see page.css."""

_HALF_VIEW = math.tan(0.8 / 2)
"""Half the height of what the viewer's camera (Babylon's default) sees at a distance of 1."""

_JPEG_QUALITY = 92


@dataclass(frozen=True)
class Answer:
    """Files and texts that the page shows.

    Attributes:
        downloads: Files by what the page calls them: ``picture``, ``depth``, ``blender`` and
            ``everything``; without what could not be made.
        summary: Model, engine, precision, size and times.
        notes: Warnings about the pair.
        distance: See `viewing_distance`; None without points.
    """

    downloads: dict[str, Path]
    summary: str
    notes: list[str]
    distance: float | None


def rectifier_of(geometry: Geometry, size: Size, pair: StereoPair) -> Rectifier | None:
    """What gives a pair the calibration that the visitor asks for.

    Args:
        geometry: What the visitor says about the cameras.
        size: Width and height of the views as they were uploaded.
        pair: The pair, maybe scaled.

    Raises:
        InputError: If the calibration is bad, or of pictures of another size.
    """
    rig = geometry.rig(size)
    if rig is None:
        return None
    rectifier = Rectifier(rig, resized=size != (pair.width, pair.height))
    rectifier.calibration((pair.width, pair.height))
    return rectifier


def prepare(
    pair: StereoPair, size: Size, rectifier: Rectifier | None, matcher: StereoMatcher
) -> StereoPair:
    """Put a pair right, with its calibration if there is one.

    Args:
        pair: The pair.
        size: Width and height of the views as they were uploaded.
        rectifier: The visitor's, or that of the page's own cameras.
        matcher: What is to match it.

    Raises:
        InputError: If the rectifier is of pictures of another size, or one picture was given that
            does not show both views.
    """
    if rectifier is not None and size != (pair.width, pair.height):
        rectifier = Rectifier(rectifier.rig, resized=True)
    return put_right(
        pair, rectifier=rectifier, max_disparity=matcher.max_disparity, shift=matcher.shift
    )


def answer(session: Session, pair: StereoPair, result: StereoResult, geometry: Geometry) -> Answer:
    """Write what a session's pair became.

    Args:
        session: Gets an ``answer``, in place of a former.
        pair: The pair, see `prepare`.
        result: What the matcher made of it.
        geometry: Limits of the points, and whether the scale is guessed.
    """
    started = time.perf_counter()
    calibration = _trusted(pair)
    notes = [str(finding) for finding in pair.findings if finding.level not in ("good", "unknown")]
    if calibration is None and pair.calibration is not None:
        wrong = problems(pair.findings)[0].check
        notes.append(f"no depth in metres of such views ({wrong}): put them right")
    if calibration is not None and geometry.guessed:
        notes.append("the scale is guessed: a field of view of 60 degrees, cameras 65 mm apart")
    with session.replace("answer") as folder:
        downloads, distance = _write(folder, result, calibration, geometry, notes)
    assert result.info is not None  # the matcher's results have one
    matched, after = result.info.seconds, time.perf_counter() - started
    return Answer(
        downloads=downloads,
        summary=f"{result.info}: matched in {matched:.2f} s, checked and written in {after:.2f} s",
        notes=notes,
        distance=distance,
    )


def _trusted(pair: StereoPair) -> Calibration | None:
    """The calibration, None if views that cannot give depth make it worthless."""
    return None if problems(pair.findings) else pair.calibration


def _write(
    folder: Path,
    result: StereoResult,
    calibration: Calibration | None,
    geometry: Geometry,
    notes: list[str],
) -> tuple[dict[str, Path], float | None]:
    result.save(folder, "stereo")
    downloads = {"picture": folder / "stereo_disparity_colours.png"}
    write_png(downloads["picture"], colour_disparity(result.disparity, valid=result.valid))
    write_png(folder / "left.png", result.left)
    if calibration is not None:
        depth = result.depth(calibration)
        for suffix in (".png", ".npy", ".tif"):
            write_depth(folder / f"stereo_depth{suffix}", depth)
        downloads["depth"] = folder / "stereo_depth.tif"
    # The shape alone needs no scale.
    height, width = result.disparity.shape
    known = calibration or ASSUMED.geometry((width, height))
    max_depth = geometry.max_depth
    if calibration is None and max_depth:
        max_depth = None
        notes.append('3D: "Farther than, m" counts with depth in metres only')
    limits = _limits(result, known, max_depth, geometry.min_confidence)
    points, mesh = result.points(known, **limits), result.mesh(known, **limits)
    distance = None
    if len(points.points):
        distance = viewing_distance(points)
        points.save(folder / "stereo_points.ply")
        _thinned(points).save(folder / CLOUD)
    if len(mesh.faces):
        mesh.save(folder / MESH)
        downloads["blender"] = folder / MESH
    else:
        shown = "points only, no surface" if len(points.points) else "nothing"
        notes.append(f"3D: {shown} is as near and as sure as asked for")
    files = sorted(path for path in folder.iterdir() if path.is_file())
    with ZipFile(folder / "stereo.zip", "w") as archive:  # most of them are compressed already
        for path in files:
            archive.write(path, path.name)
    return downloads | {"everything": folder / "stereo.zip"}, distance


def _limits(
    result: StereoResult,
    calibration: Calibration,
    max_depth: float | None,
    min_confidence: float,
) -> dict[str, Any]:
    depth = result.depth(calibration)
    median = float(np.median(depth[depth > 0])) if depth.any() else 0.0
    return {
        "max_depth": max_depth or MAX_DEPTH_RATIO * median,
        "min_confidence": 0.0 if result.confidence is None else min_confidence,
    }


def viewing_distance(cloud: PointCloud) -> float:
    """Distance in metres from the points' middle from which they just fill the view in 3D."""
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    x, y, z = (cloud.points - (low + high) / 2).T
    needed = np.maximum(np.abs(x) / SHAPE_ASPECT, np.abs(y)) / _HALF_VIEW
    return float((needed - z).max())


def _thinned(cloud: PointCloud) -> PointCloud:
    step = -(-len(cloud.points) // MAX_SHOWN_POINTS) or 1
    return PointCloud(cloud.points[::step], cloud.colours[::step])


def preview(pair: StereoPair) -> dict[str, Any]:
    """What `view.js` shows before a match: the left view."""
    return {"left": _jpeg(pair.left_image)}


def view(pair: StereoPair, result: StereoResult, guessed: bool) -> dict[str, Any]:
    """What `view.js` shows of a result: pictures that a browser unpacks, and the geometry."""
    calibration = _trusted(pair)
    levels = np.rint(np.where(result.valid, result.disparity, 0) * KITTI_SCALE)
    high, low = np.divmod(np.where(levels <= 65535, levels, 0), 256)
    confidence = 0 if result.confidence is None else np.rint(255 * result.confidence)
    channels = np.broadcast_arrays(confidence, low, high)
    _, png = cv2.imencode(".png", np.stack(channels, axis=-1).astype(np.uint8))
    shown: dict[str, Any] = {
        "left": _jpeg(result.left),
        "levels": _data_url("png", png.tobytes()),
        "scale": KITTI_SCALE,
        "confident": result.confidence is not None,
        "geometry": None,
    }
    if calibration is not None:
        height, width = result.disparity.shape
        cx, cy = calibration.principal_point(width, height)
        shown["geometry"] = {
            "focal": calibration.focal,
            "depth": calibration.focal * calibration.baseline,
            "doffs": calibration.doffs,
            "cx": cx,
            "cy": cy,
            "guessed": guessed,
        }
    return shown


def _jpeg(picture: Picture) -> str:
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    return _data_url("jpeg", cv2.imencode(".jpg", picture[..., ::-1], options)[1].tobytes())


def _data_url(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
