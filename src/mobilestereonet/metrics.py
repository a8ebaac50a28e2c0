"""EPE, bad-t and D1 over masks: the columns by which stereo benchmarks compare matchers."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError

MASKS = ("all", "noc", "occ", "fg", "bg")
"""Every pixel with ground truth; those that are not occluded, occluded, foreground, background."""

_STATISTICS = {"mean": "per_image", "median": "median", "per_pixel": "per_pixel"}
"""Ends of column names, and the attributes of `MaskScores` that they show."""

PairColumns = dict[str, float | int | None]
"""Columns of one pair, see `StereoScores`. None is unknown, or a mean over no pixel."""


@dataclass(frozen=True)
class MaskScores:
    """Error figures over the pixels of one mask: ``epe`` in px, ``d1`` and ``bad1`` ... in percent.

    A figure is None where no image has a pixel to score.

    Attributes:
        per_image: Mean over the images of each image's own mean (the paper's figure).
        median: Median over the images of each image's own mean.
        per_pixel: Mean over all pixels of all images.
        images: Images that were scored.
        empty: Images without a pixel to score; they are in no mean.
        skipped: Images that ``min_share`` left out; they are in no mean.
        pixels: Pixels that were scored.
        gt_density: Share of the frames' pixels that was scored, in percent: the density of the
            ground truth, not of the predictions, which are dense. None without an image that has
            the mask.
    """

    per_image: dict[str, float | None]
    median: dict[str, float | None]
    per_pixel: dict[str, float | None]
    images: int
    empty: int
    skipped: int
    pixels: int
    gt_density: float | None


@dataclass(frozen=True)
class StereoScores:
    """Result of `StereoMetrics`: the figures of each mask, and of each pair.

    Attributes:
        max_disparity: Pixels count whose ground truth lies in ``0 < d < max_disparity``, in px.
        min_share: See `StereoMetrics`.
        masks: The figures of each mask that the data has; ``all`` is always there.
        pairs: Columns of each pair, in the order in which they were added (over ranks: one rank
            after the other). Names are ``FIGURE_MASK``, such as ``epe_all``, ``d1_noc``,
            ``bad1_noc``, and ``pixels_MASK``, ``gt_density_MASK``.
    """

    max_disparity: float
    min_share: float
    masks: dict[str, MaskScores]
    pairs: list[PairColumns]

    @property
    def listed_masks(self) -> list[str]:
        """Masks that reports list, in order: those of the data, ``all`` and ``noc`` always."""
        return _listed(self.masks)

    def figures(self, prefix: str = "") -> dict[str, float]:
        """Per-image means by name, for a logger: ``epe``, ``d1``, ... and ``noc/epe``, ...

        Args:
            prefix: Put before each name, such as ``val/``.

        Returns:
            The figures of every mask that has a pixel; those of ``all`` carry no mask's name.
        """
        return {
            f"{prefix}{'' if mask == 'all' else mask + '/'}{figure}": value
            for mask, scores in self.masks.items()
            for figure, value in scores.per_image.items()
            if value is not None
        }

    def columns(self) -> PairColumns:
        """Figures of all pairs together, in one row.

        Returns:
            ``FIGURE_MASK_mean`` and ``FIGURE_MASK_median`` over the pairs, and
            ``FIGURE_MASK_per_pixel``; ``images_MASK``, ``pixels_MASK`` and ``gt_density_MASK``.
            The columns of ``noc`` are always there, None where the data does not know it.
        """
        row: PairColumns = {}
        nothing: PairColumns = dict.fromkeys(self.masks["all"].per_image)
        for mask in self.listed_masks:
            own = self.masks.get(mask)
            for figure in nothing:
                for statistic, attribute in _STATISTICS.items():
                    values = nothing if own is None else getattr(own, attribute)
                    row[f"{figure}_{mask}_{statistic}"] = values[figure]
            for count in ("images", "pixels", "gt_density"):
                row[f"{count}_{mask}"] = None if own is None else getattr(own, count)
        return row

    def to_dict(self) -> dict[str, Any]:
        """Plain dicts, ready for JSON (an infinite range becomes None)."""
        record = asdict(self)
        if math.isinf(self.max_disparity):
            record["max_disparity"] = None
        return record


class _Images(NamedTuple):
    """What all figures follow from, for N images, on the CPU.

    Attributes:
        sums: Sum of each figure over each mask, (N, masks, figures) float64.
        pixels: Pixels of each mask, (N, masks); -1 where an image has no such map.
        frame: Pixels of the frame, (N,).
        skipped: True where ``min_share`` leaves the image out, (N,).
    """

    sums: Tensor
    pixels: Tensor
    frame: Tensor
    skipped: Tensor


class StereoMetrics:
    """Metric of stereo matching: EPE, D1 and bad-t over the masks all, noc, occ, fg and bg.

    With the error ``e = |prediction - truth|`` of a pixel, over the pixels of a mask:

    - ``epe``: mean of e in px (Middlebury's "avgerr").
    - ``bad1``, ``bad2``, ...: share of pixels with e > t px, in percent ("bad-t" of Middlebury's
      evaluation, Scharstein and Szeliski, IJCV 2002, section 5.1; the paper's "px-3" is bad-3).
    - ``d1``: share of pixels with e > 3 px and e > 5 % of the truth, in percent ("D1" of KITTI
      2015, Menze and Geiger, CVPR 2015).

    A benchmark that ranks by non-occluded pixels is compared with ``noc``. The masks noc and occ
    need ``occluded``, fg and bg need ``foreground``; an image without that map is not counted in
    them. This is the paper's protocol where ``per_image`` is read; ``min_share=0.1`` adds the
    rule of the authors' release.

    The states are sums of each image, so that batches, order and ranks do not matter.
    """

    def __init__(
        self,
        max_disparity: float = 192.0,
        thresholds: Sequence[float] = (1, 2, 3),
        min_share: float = 0.0,
    ) -> None:
        """Initialise without an image.

        Args:
            max_disparity: Ground truth in ``0 < d < max_disparity`` is scored, in px; ``inf``
                scores all of it.
            thresholds: The t of bad-t, in px.
            min_share: Skip and count an image where less than this share of the pixels with
                ground truth is in that range (the authors' release: 0.1).

        Raises:
            InputError: If a value is out of its range.
        """
        if not max_disparity > 0:
            raise InputError(f"max_disparity must be positive, got {max_disparity}")
        if not 0 <= min_share <= 1:
            raise InputError(f"min_share must lie in 0..1, got {min_share}")
        if any(not threshold >= 0 for threshold in thresholds):
            raise InputError(f"thresholds must not be negative, got {tuple(thresholds)}")
        self.max_disparity = float(max_disparity)
        self.min_share = float(min_share)
        self.thresholds = tuple(thresholds)
        self.names = ("epe", "d1", *(f"bad{threshold:g}" for threshold in self.thresholds))
        self.reset()

    def reset(self) -> None:
        """Forget all images."""
        none = torch.zeros(0, len(MASKS), len(self.names), dtype=torch.float64)
        counts = torch.zeros(0, len(MASKS), dtype=torch.int64)
        self._batches = [_Images(none, counts, counts[:, 0], counts[:, 0].bool())]

    def update(self, prediction: Tensor, batch: StereoSample) -> None:
        """Add a batch of predictions.

        Args:
            prediction: Disparity in px, (B, H, W). A value that is not finite is an outlier.
            batch: The samples with ground truth, (B, H, W) maps, on any device: what is scored
                is moved to the prediction's.

        Raises:
            InputError: If there is no ground truth or the shapes differ.
        """
        if batch.disparity is None or batch.valid is None:
            raise InputError(f"{batch.name or 'this sample'} has no ground truth to score against")
        if prediction.ndim != 3 or prediction.shape != batch.disparity.shape:
            raise InputError(
                f"{batch.name or 'prediction'}: a (B, H, W) prediction must have its ground "
                f"truth's shape, got {tuple(prediction.shape)} and {tuple(batch.disparity.shape)}"
            )
        truth, valid = (_beside(prediction, truth) for truth in (batch.disparity, batch.valid))
        figures = self._pixel_figures(prediction.float(), truth.float())
        scored = valid & (truth > 0) & (truth < self.max_disparity)
        skipped = scored.sum((1, 2)) < self.min_share * valid.sum((1, 2))
        count = len(prediction)
        sums = torch.zeros(count, len(MASKS), len(self.names), dtype=torch.float64)
        pixels = torch.full((count, len(MASKS)), -1)
        for index, mask in _masks(scored, batch):
            own = [torch.where(mask, figure, 0.0) for figure in figures]
            sums[:, index] = torch.stack([f.sum((1, 2), dtype=torch.float64) for f in own], 1).cpu()
            pixels[:, index] = mask.sum((1, 2)).cpu()
        frame = torch.full((count,), truth[0].numel())
        self._batches.append(_Images(sums, pixels, frame, skipped.cpu()))

    def compute(self) -> StereoScores:
        """Figures of everything added, over all ranks."""
        batches = _over_ranks(self._batches)
        images = _Images(*(torch.cat(parts) for parts in zip(*batches, strict=True)))
        masks = {
            name: self._mask_scores(images, index)
            for index, name in enumerate(MASKS)
            if name == "all" or (images.pixels[:, index] >= 0).any()
        }
        listed = _listed(masks)
        pairs = [self._pair(images, row, listed) for row in range(len(images.frame))]
        return StereoScores(self.max_disparity, self.min_share, masks, pairs)

    def _mask_scores(self, images: _Images, mask: int) -> MaskScores:
        pixels, sums = images.pixels[:, mask], images.sums[:, mask]
        known = pixels >= 0
        scored = (pixels > 0) & ~images.skipped
        means = (sums[scored] / pixels[scored, None]).numpy()
        total = int(pixels[scored].sum())
        frames = int(images.frame[known & ~images.skipped].sum())
        nothing: dict[str, float | None] = dict.fromkeys(self.names)
        return MaskScores(
            per_image=self._named(means.mean(0)) if total else nothing,
            median=self._named(np.median(means, 0)) if total else nothing,
            per_pixel=self._named(sums[scored].sum(0) / total) if total else nothing,
            images=int(scored.sum()),
            empty=int((known & ~scored & ~images.skipped).sum()),
            skipped=int((known & images.skipped).sum()),
            pixels=total,
            gt_density=100 * total / frames if frames else None,
        )

    def _pair(self, images: _Images, row: int, masks: Sequence[str]) -> PairColumns:
        """Columns of one image; an image that was skipped has none but empty ones."""
        columns: PairColumns = {}
        for name in masks:
            index = MASKS.index(name)
            pixels = -1 if images.skipped[row] else int(images.pixels[row, index])
            means = images.sums[row, index] / max(pixels, 1)
            for figure, mean in zip(self.names, means.tolist(), strict=True):
                columns[f"{figure}_{name}"] = mean if pixels > 0 else None
            columns[f"pixels_{name}"] = None if pixels < 0 else pixels
            density = 100 * pixels / int(images.frame[row])
            columns[f"gt_density_{name}"] = None if pixels < 0 else density
        return columns

    def _named(self, values: Any) -> dict[str, float | None]:
        return dict(zip(self.names, values.tolist(), strict=True))

    def _pixel_figures(self, prediction: Tensor, truth: Tensor) -> list[Tensor]:
        """Each figure at each pixel, (B, H, W), in the order of ``names``."""
        error = (prediction - truth).abs()
        # "not within" instead of "above": an error of NaN is an outlier, too.
        d1 = ~((error <= 3) | (error <= 0.05 * truth))
        return [error, 100.0 * d1, *(100.0 * ~(error <= t) for t in self.thresholds)]


def _listed(masks: Container[str]) -> list[str]:
    return [name for name in MASKS if name in masks or name in ("all", "noc")]


def _over_ranks(batches: list[_Images]) -> list[_Images]:
    """Batches of all ranks of a distributed run; one's own outside of one."""
    distributed = torch.distributed
    if not (distributed.is_available() and distributed.is_initialized()):
        return batches
    parts: list[list[_Images]] = [[] for _ in range(distributed.get_world_size())]
    distributed.all_gather_object(parts, batches)
    return [batch for part in parts for batch in part]


def _masks(scored: Tensor, batch: StereoSample) -> Iterator[tuple[int, Tensor]]:
    """The masks that this batch has, each with its place in `MASKS`."""
    yield 0, scored
    if batch.occluded is not None:
        occluded = _beside(scored, batch.occluded)
        yield 1, scored & ~occluded
        yield 2, scored & occluded
    if batch.foreground is not None:
        foreground = _beside(scored, batch.foreground)
        yield 3, scored & foreground
        yield 4, scored & ~foreground


def _beside(other: Tensor, values: Tensor) -> Tensor:
    """The values on the device of ``other``."""
    return values.to(other.device)
