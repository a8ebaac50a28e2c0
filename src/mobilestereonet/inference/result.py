"""Matching result: disparity, confidence, depth, point cloud, files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mobilestereonet.data.calibration import read_calibration
from mobilestereonet.data.images import FloatMap, Mask, Picture
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.inference.deviation import (
    check_fitted,
    depth_deviation,
    disparity_deviation,
)
from mobilestereonet.inference.filter import NO_LIMITS, MetricFilter
from mobilestereonet.inference.finding import Finding
from mobilestereonet.inference.first_look import problems
from mobilestereonet.inference.geometry import (
    PointCloud,
    depth_edges,
    depth_from_disparity,
    point_cloud,
    point_map,
)
from mobilestereonet.inference.map_files import save_maps
from mobilestereonet.inference.mesh import Mesh, fitting_step, surface
from mobilestereonet.inference.run_info import RunInfo
from mobilestereonet.plots import colour_disparity, depth_picture, plot_maps, side_by_side

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_NOTEBOOK_WIDTH = 1280
"""Pixels; a wider picture of a result is scaled down where a notebook shows it."""


@dataclass(frozen=True, eq=False, repr=False)
class StereoResult:
    """Disparity of a pair's left view, with its confidence, checks and derived forms.

    A notebook shows it as a picture.

    Attributes:
        left: Left view, (H, W, 3) uint8 RGB.
        disparity: (H, W) float32, in pixels of the left view.
        valid: (H, W) bool, False where the disparity is not known.
        confidence: (H, W) float32 in 0..1: the probability that the disparity's error is below
            3 px, where it was fitted to the weights, as to those of this package (`msnet
            fit-confidence`). Of other weights: how probable the network itself holds it that the
            disparity is within 2 px of its estimate. None where it was not asked for.
        right_disparity: (H, W) float32, in pixels of the right view, whose pixel (x, y) matches
            left pixel (x + disparity, y); None where it was not asked for.
        occluded: (H, W) bool, True where the left-right check fails: the right camera does not see
            the pixel, or the match is wrong; None without ``right_disparity``.
        findings: What was put right while the views were read, what the first look found where
            one was taken, see `first_look`, and what the quick checks say, see `quick_checks`.
        info: Model, engine, precision and time; None for a result that was read from files.
        filter: Which pixels have a depth, besides those that fail the left-right check.
        calibration: Geometry of the views, where a rig or the pair told it.
    """

    left: Picture
    disparity: FloatMap
    valid: Mask
    confidence: FloatMap | None = None
    right_disparity: FloatMap | None = None
    occluded: Mask | None = None
    findings: tuple[Finding, ...] = ()
    info: RunInfo | None = None
    filter: MetricFilter = NO_LIMITS
    calibration: Calibration | None = None

    def __repr__(self) -> str:
        height, width = self.disparity.shape
        known = self.disparity[self.valid]
        span = f"disparity {known.min():.1f} to {known.max():.1f} px" if known.size else "no match"
        parts = [f"{width}x{height}", span]
        if self.info is not None:
            parts += [self.info.model, self.info.engine, self.info.precision]
        parts += [f"problem: {finding.text}" for finding in problems(self.findings)]
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

    def depth(
        self,
        calibration: Calibration | str | Path | None = None,
        *,
        focal: float | None = None,
        baseline: float | None = None,
        doffs: float = 0.0,
    ) -> FloatMap:
        """Depth along the optical axis: focal * baseline / (disparity + doffs).

        Args:
            calibration: Geometry of the pair, for the left view's size, or the path of a file of
                it; by default the result's own. Or, in its place:
            focal: Focal length in px.
            baseline: Distance between the cameras in metres.
            doffs: Difference of the principal points, right minus left, in px.

        Returns:
            (H, W) float32 in metres. Never NaN or infinite: 0 where it is not known, which is
            where ``valid`` is False, the disparity (plus ``doffs``) is below 1/256 px, the
            left-right check failed, or the ``filter`` leaves the pixel out.

        Raises:
            InputError: If the calibration is known to be of another size, or there is none, or
                there are two; or if the filter needs a confidence that is not known.
        """
        return self._depth(self._geometry(calibration, focal, baseline, doffs), edges=True)

    def depth_std(
        self,
        calibration: Calibration | str | Path | None = None,
        *,
        focal: float | None = None,
        baseline: float | None = None,
        doffs: float = 0.0,
    ) -> FloatMap:
        """Standard deviation of `depth`, from the confidence, see `disparity_std`.

        It is that of the disparity through its slope, so it grows with the square of the depth;
        where it comes near the depth itself, nothing is known.

        Args:
            calibration: See `depth`, and so for those that follow.
            focal: Likewise.
            baseline: Likewise.
            doffs: Likewise.

        Returns:
            (H, W) float32 in metres, 0 where the depth is not known.

        Raises:
            InputError: As `depth` and `disparity_std`.
        """
        geometry = self._geometry(calibration, focal, baseline, doffs)
        depth = self._depth(geometry, edges=True)
        return depth_deviation(depth, self.disparity, self.disparity_std(), geometry.doffs)

    def disparity_std(self) -> FloatMap:
        """Standard deviation of the disparity in px, (H, W), from the confidence alone.

        That of the Laplace distribution whose error is below 3 px as probably as the confidence
        says; the errors themselves were not fitted, see `disparity_deviation`.

        Raises:
            InputError: If the confidence is not known, or no probability of an error.
        """
        if self.confidence is None:
            raise InputError("a standard deviation needs a matcher with confidence=True")
        if self.info is not None:
            check_fitted(self.info.confidence_fitted, self.info.model)
        return disparity_deviation(self.confidence)

    def _geometry(
        self,
        calibration: Calibration | str | Path | None,
        focal: float | None = None,
        baseline: float | None = None,
        doffs: float = 0.0,
    ) -> Calibration:
        if calibration is not None and (focal is not None or baseline is not None or doffs):
            raise InputError("depth takes a calibration, or focal and baseline: leave one out")
        if focal is not None or baseline is not None or doffs:
            if focal is None or baseline is None:
                raise InputError(
                    "depth needs a calibration, or focal= (px) and baseline= (m), both of them"
                )
            return Calibration(focal=focal, baseline=baseline, doffs=doffs)
        if isinstance(calibration, str | Path):
            return read_calibration(calibration)
        calibration = calibration or self.calibration
        if calibration is None:
            raise InputError(
                "depth needs a calibration, or focal= (px) and baseline= (m), both of them, or a "
                "matcher with rig=FILE"
            )
        return calibration

    def points(
        self,
        calibration: Calibration | str | Path | None = None,
        *,
        max_depth: float = math.inf,
        min_confidence: float = 0.0,
        edges: bool = False,
    ) -> PointCloud:
        """Coloured points in the left camera's frame.

        Pixels that fail the left-right check, if there was one, give no point.

        Args:
            calibration: Geometry of the pair, for the left view's size; by default the result's
                own.
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
        calibration = self._geometry(calibration)
        depth = self._depth(calibration, min_confidence, max_depth, edges)
        return point_cloud(depth, self.left, calibration)

    def mesh(
        self,
        calibration: Calibration | str | Path | None = None,
        *,
        max_depth: float = math.inf,
        min_confidence: float = 0.0,
        edges: bool = False,
        step: int | None = None,
    ) -> Mesh:
        """Textured surface in the left camera's frame, cut at depth edges.

        Pixels that fail the left-right check, if there was one, are no part of it.

        Args:
            calibration: Geometry of the pair, for the left view's size; by default the result's
                own.
            max_depth: What is farther is left out, in metres.
            min_confidence: What is less confident is left out.
            edges: True joins the two sides of depth edges, too.
            step: Every how many pixels there is a vertex: 2 makes the file a quarter as large. By
                default the smallest that gives at most `MAX_VERTICES`.

        Raises:
            InputError: If the calibration is known to be of another size, ``step`` is below 1, or
                ``min_confidence`` is asked for where the confidence is not known.
        """
        if step is None:
            step = fitting_step(*self.disparity.shape)
        if step < 1:
            raise InputError(f"step must be 1 or more, got {step}")
        calibration = self._geometry(calibration)
        points = point_map(
            self._depth(calibration, min_confidence, max_depth, edges=True), calibration
        )
        return surface(points, self.disparity, self.left, step=step, edges=edges)

    def _depth(
        self,
        calibration: Calibration,
        min_confidence: float = 0.0,
        max_depth: float = math.inf,
        edges: bool = False,
    ) -> FloatMap:
        """Depth in metres, 0 where it is not known, or does not pass the filter and these limits.

        Raises:
            InputError: If the confidence counts and is not known.
        """
        limits = self.filter.stricter(min_confidence, max_depth, edges)
        kept = self.valid
        if limits.min_confidence > 0:
            if self.confidence is None:
                raise InputError(
                    f"min_confidence {limits.min_confidence:g} needs a matcher with confidence=True"
                )
            kept = kept & (self.confidence >= limits.min_confidence)
        if self.occluded is not None:
            kept = kept & ~self.occluded
        if not limits.edges:
            kept = kept & ~depth_edges(self.disparity, self.valid)
        depth = depth_from_disparity(self.disparity, kept, calibration)
        return np.where(depth <= limits.max_depth, depth, np.float32(0))

    def to_open3d(self, calibration: Calibration | str | Path | None = None, **limits: Any) -> Any:
        """The points as ``open3d.geometry.PointCloud``, in the left camera's frame.

        Args:
            calibration: Geometry of the pair, for the left view's size; by default the result's
                own.
            **limits: ``max_depth``, ``min_confidence`` and ``edges``, see `points`.

        Raises:
            InputError: As `points`, or if Open3D is not installed.
        """
        try:
            import open3d
        except ModuleNotFoundError:
            raise InputError("open3d is not installed: pip install open3d") from None
        cloud = self.points(calibration, **limits)
        converted = open3d.geometry.PointCloud()
        converted.points = open3d.utility.Vector3dVector(cloud.points.astype(np.float64))
        converted.colors = open3d.utility.Vector3dVector(cloud.colours / 255)
        return converted

    def picture(self) -> Picture:
        """The left view beside the coloured disparity, (H, 2 W + gap, 3) uint8 RGB."""
        return side_by_side([self.left, colour_disparity(self.disparity, valid=self.valid)])

    def depth_picture(self, calibration: Calibration | str | Path | None = None) -> Picture:
        """The depth in colours beside a bar in metres, (H, W + the bar's, 3) uint8 RGB.

        Args:
            calibration: See `depth`.
        """
        return depth_picture(self.depth(calibration))

    def to_pil(self) -> Image.Image:
        """The disparity's colours as a PIL image, of the left view's size."""
        return Image.fromarray(colour_disparity(self.disparity, valid=self.valid))

    def plot(self, figure: Figure | None = None) -> Figure:
        """Left view, disparity in px and, if known, depth in m and confidence, as a figure.

        Args:
            figure: Matplotlib's, to draw in; by default a new one, which `show` and notebooks show.

        Raises:
            InputError: If Matplotlib is not installed.
        """
        known = np.where(self.valid, self.disparity, np.float32(np.nan))
        maps: list[tuple[str, NDArray[Any], dict[str, Any]]] = [
            ("left view", self.left, {}),
            ("disparity (px)", known, {"cmap": "turbo", "vmin": 0}),
        ]
        if self.calibration is not None:
            metres = self.depth()
            seen = np.where(metres > 0, metres, np.float32(np.nan))
            farthest = np.percentile(metres[metres > 0], 99) if metres.any() else 1.0
            maps.append(("depth (m)", seen, {"cmap": "turbo_r", "vmin": 0, "vmax": farthest}))
        if self.confidence is not None:
            maps.append(("confidence", self.confidence, {"cmap": "grey", "vmin": 0, "vmax": 1}))
        return plot_maps(maps, figure)

    def show(self) -> None:
        """Show `plot` in a window, or below a notebook's cell.

        Raises:
            InputError: If Matplotlib is not installed.
        """
        with needs_extra("plots"):
            from matplotlib import pyplot
        self.plot(pyplot.figure(layout="constrained"))
        pyplot.show()

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
        return save_maps(
            Path(folder),
            stem,
            disparity=np.where(self.valid, self.disparity, np.float32(np.inf)),
            picture=self.picture(),
            confidence=self.confidence,
            right_disparity=self.right_disparity,
            occluded=self.occluded,
        )
