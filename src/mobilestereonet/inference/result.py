"""Matching result: disparity, confidence, depth, point cloud, files."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.disparity_files import KITTI_SCALE, write_disparity_png
from mobilestereonet.data.files import write_npy, write_pfm, write_png
from mobilestereonet.data.images import FloatMap, Mask, Picture
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference.checks import Finding
from mobilestereonet.inference.geometry import (
    PointCloud,
    depth_edges,
    depth_from_disparity,
    point_cloud,
)
from mobilestereonet.plots import colour_disparity, side_by_side

MAX_PNG_DISPARITY_PX = 65535 / KITTI_SCALE
"""Largest disparity that a 16-bit PNG holds."""

_MAX_NOTEBOOK_WIDTH = 1280
"""Pixels; a wider picture of a result is scaled down where a notebook shows it."""


@dataclass(frozen=True)
class RunInfo:
    """How a result was computed, and how long it took.

    Attributes:
        model: Name of the model.
        engine: Name of the engine that ran it.
        precision: Precision that it computed in, such as ``fp32`` or ``bf16``.
        device: Device that it ran on, such as ``cpu``.
        refined: Whether the disparity was refined, see `mobilestereonet.inference.predict`.
        width: Width of the views in px.
        height: Height of the views in px.
        seconds: Time from the checked pair to the maps, in s: a pair's share of its batch.
        quality: Quality level that chose the model and its settings; None where none did.
        scale: Factor of height and width in which the pair was matched.
    """

    model: str
    engine: str
    precision: str
    device: str
    refined: bool
    width: int
    height: int
    seconds: float
    quality: str | None = None
    scale: float = 1.0

    def __str__(self) -> str:
        model = f"{self.quality} ({self.model})" if self.quality else self.model
        if self.scale != 1:
            model += f" at {self.scale:g} of the size"
        return f"{model} on {self.engine} {self.precision}, {self.width}x{self.height}"


@dataclass(frozen=True, eq=False, repr=False)
class StereoResult:
    """Disparity of a pair's left view, with its confidence, checks and derived forms.

    A notebook shows it as a picture.

    Attributes:
        left: Left view, (H, W, 3) uint8 RGB.
        disparity: (H, W) float32, in pixels of the left view.
        valid: (H, W) bool, False where the disparity is not known.
        confidence: (H, W) float32 in 0..1: how probable the network holds it that the disparity
            is within 2 px of its estimate; None where it was not asked for.
        right_disparity: (H, W) float32, in pixels of the right view, whose pixel (x, y) matches
            left pixel (x + disparity, y); None where it was not asked for.
        occluded: (H, W) bool, True where the left-right check fails: the right camera does not see
            the pixel, or the match is wrong; None without ``right_disparity``.
        findings: What the quick checks say about the pair, see `quick_checks`.
        info: Model, engine, precision and time; None for a result that was read from files.
    """

    left: Picture
    disparity: FloatMap
    valid: Mask
    confidence: FloatMap | None = None
    right_disparity: FloatMap | None = None
    occluded: Mask | None = None
    findings: tuple[Finding, ...] = ()
    info: RunInfo | None = None

    def __repr__(self) -> str:
        height, width = self.disparity.shape
        known = self.disparity[self.valid]
        span = f"disparity {known.min():.1f} to {known.max():.1f} px" if known.size else "no match"
        parts = [f"{width}x{height}", span]
        if self.info is not None:
            parts += [self.info.model, self.info.engine, self.info.precision]
        return f"StereoResult({', '.join(parts)})"

    def _repr_png_(self) -> bytes:
        """The picture as PNG, at most `_MAX_NOTEBOOK_WIDTH` wide: what notebooks show."""
        picture = self.picture()
        height, width = picture.shape[:2]
        if width > _MAX_NOTEBOOK_WIDTH:
            size = (_MAX_NOTEBOOK_WIDTH, max(round(height * _MAX_NOTEBOOK_WIDTH / width), 1))
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        _, png = cv2.imencode(".png", picture[..., ::-1])
        return png.tobytes()

    def depth(self, calibration: Calibration) -> FloatMap:
        """Depth along the optical axis: focal * baseline / (disparity + doffs).

        Args:
            calibration: Geometry of the pair, for the left view's size.

        Returns:
            (H, W) float32 in metres. Never NaN or infinite: 0 where it is not known, which is
            where ``valid`` is False or the disparity (plus ``doffs``) is below 1/256 px.

        Raises:
            InputError: If the calibration is known to be of another size.
        """
        return depth_from_disparity(self.disparity, self.valid, calibration)

    def points(
        self,
        calibration: Calibration,
        *,
        max_depth: float = math.inf,
        min_confidence: float = 0.0,
        edges: bool = False,
    ) -> PointCloud:
        """Coloured points in the left camera's frame.

        Pixels that fail the left-right check, if there was one, give no point.

        Args:
            calibration: Geometry of the pair, for the left view's size.
            max_depth: Farther points are left out, in metres.
            min_confidence: Less confident ones are left out.
            edges: True keeps the pixels at depth edges, which mix two surfaces (see
                `depth_edges`).

        Returns:
            The points, row by row.

        Raises:
            InputError: If the calibration is known to be of another size, or ``min_confidence`` is
                asked for where the confidence is not known.
        """
        if min_confidence > 0 and self.confidence is None:
            raise InputError(
                f"min_confidence {min_confidence:g} needs a matcher with confidence=True"
            )
        kept = self.valid if edges else self.valid & ~depth_edges(self.disparity, self.valid)
        if self.confidence is not None:
            kept = kept & (self.confidence >= min_confidence)
        if self.occluded is not None:
            kept = kept & ~self.occluded
        depth = np.where(kept, self.depth(calibration), np.float32(0))
        return point_cloud(np.where(depth <= max_depth, depth, 0), self.left, calibration)

    def picture(self) -> Picture:
        """The left view beside the coloured disparity, (H, 2 W + gap, 3) uint8 RGB."""
        return side_by_side([self.left, colour_disparity(self.disparity, valid=self.valid)])

    def save(self, folder: str | Path, stem: str) -> dict[str, Path]:
        """Write the maps and a picture, each file atomically.

        Args:
            folder: Folder to write to; made if it does not exist.
            stem: How the files' names begin.

        Returns:
            Paths by kind: ``png`` (16 bit, disparity x 256 as in KITTI; 0 where unknown or 256 px
            and more), ``pfm`` and ``npy`` (float32; infinite where unknown) and ``picture``. With
            a confidence: ``confidence`` (8-bit grey, 255 is sure) and ``confidence_npy``. With
            the right view's disparity: ``right_png`` and ``right_npy`` likewise, ``occluded``
            (8 bit, 255 where occluded).
        """
        folder = Path(folder)
        disparity = np.where(self.valid, self.disparity, np.float32(np.inf))
        files: dict[str, tuple[str, Callable[[Path, NDArray[Any]], None], NDArray[Any]]] = {
            "png": ("disparity.png", _write_storable, disparity),
            "pfm": ("disparity.pfm", write_pfm, disparity),
            "npy": ("disparity.npy", write_npy, disparity),
            "picture": ("picture.png", write_png, self.picture()),
        }
        if self.confidence is not None:
            grey = np.rint(255 * self.confidence).astype(np.uint8)
            files["confidence"] = ("confidence.png", write_png, grey)
            files["confidence_npy"] = ("confidence.npy", write_npy, self.confidence)
        if self.right_disparity is not None:
            files["right_png"] = ("right_disparity.png", _write_storable, self.right_disparity)
            files["right_npy"] = ("right_disparity.npy", write_npy, self.right_disparity)
        if self.occluded is not None:
            files["occluded"] = ("occluded.png", write_png, np.uint8(255) * self.occluded)
        paths = {}
        for kind, (name, write, values) in files.items():
            paths[kind] = folder / f"{stem}_{name}"
            write(paths[kind], values)
        return paths


def _write_storable(path: Path, disparity: FloatMap) -> None:
    write_disparity_png(path, disparity, disparity <= MAX_PNG_DISPARITY_PX)
