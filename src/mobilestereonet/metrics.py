"""EPE, px-n and D1 over masks, kept as sums: batches, order and ranks do not matter."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError

MASKS = ("all", "noc", "occ", "fg", "bg")
_MASK_WORDS = {
    "all": "all of them",
    "noc": "noc (not occluded)",
    "occ": "occ (occluded)",
    "fg": "fg (foreground)",
    "bg": "bg (background)",
}


@dataclass(frozen=True)
class MaskScores:
    """Error figures over the pixels of one mask.

    Attributes:
        per_image: Mean over the images of each image's own mean (the paper's figure): ``epe`` in
            px, ``d1`` and ``px-n`` in percent. None where no image has a pixel to score.
        per_pixel: The same figures as means over all pixels of all images.
        images: Images that were scored.
        empty: Images without a pixel to score; they are in no mean.
        skipped: Images that ``min_share`` left out; they are in no mean.
        pixels: Pixels that were scored.
    """

    per_image: dict[str, float | None]
    per_pixel: dict[str, float | None]
    images: int
    empty: int
    skipped: int
    pixels: int


@dataclass(frozen=True)
class StereoScores:
    """Result of `StereoMetrics`: the figures of each mask; prints as a table.

    Attributes:
        max_disparity: Pixels count whose ground truth lies in ``0 < d < max_disparity``, in px.
        min_share: See `StereoMetrics`.
        masks: The figures of each mask that the data has; ``all`` is always there.
    """

    max_disparity: float
    min_share: float
    masks: dict[str, MaskScores]

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

    def to_dict(self) -> dict[str, Any]:
        """Plain dicts, ready for JSON (an infinite range becomes None)."""
        record = asdict(self)
        if math.isinf(self.max_disparity):
            record["max_disparity"] = None
        return record

    def legend(self) -> str:
        """What the table's rows and columns mean, and which pixels were scored."""
        given = [text for mask, text in _MASK_WORDS.items() if mask in self.masks]
        text = (
            f"Pixels with ground truth 0 < d < {self.max_disparity:g}; masks: {', '.join(given)}. "
            "EPE: mean error; px-n: share of errors above n px; D1: above 3 px and 5 %. "
            "Per image: mean over the images of each image's mean (the paper's). Per pixel: mean "
            "over all pixels. Empty: images without such a pixel. Skipped: "
        )
        if self.min_share > 0:
            return text + (
                f"images where fewer than {100 * self.min_share:g} % of the pixels with ground "
                "truth are in that range."
            )
        return text + "images that the authors' rule leaves out, none without it."

    def table(self, title: str | None = None, legend: bool = True) -> Table:
        """Table of `rich` with one row per mask and figure.

        Args:
            title: Its title.
            legend: With the `legend` below it.
        """
        caption = self.legend() if legend else None
        table = Table(title=title, caption=caption, caption_justify="left")
        table.add_column("mask")
        table.add_column("figure")
        for name in ("per image", "per pixel", "images", "empty", "skipped", "pixels"):
            table.add_column(name, justify="right")
        for mask, scores in self.masks.items():
            counts = [scores.images, scores.empty, scores.skipped, scores.pixels]
            head, tail = mask, [f"{count:,}" for count in counts]
            for figure, value in scores.per_image.items():
                pair = (value, scores.per_pixel[figure])
                cells = ["-" if mean is None else f"{mean:.3f}" for mean in pair]
                table.add_row(head, _label(figure), *cells, *tail)
                head, tail = "", []
            table.add_section()
        return table

    def __rich__(self) -> Table:
        return self.table()

    def __str__(self) -> str:
        console = Console(width=100)
        with console.capture() as capture:
            console.print(self.table())
        return capture.get().rstrip()


class StereoMetrics:
    """Metric of stereo matching: EPE, D1 and px-n over the masks all, noc, occ, fg and bg.

    EPE is the mean absolute disparity error in px; px-n the share of the pixels whose error is
    above n px; D1 the share whose error is above 3 px and above 5 % of the ground truth; shares
    are in percent. The masks noc and occ need ``occluded``, fg and bg need ``foreground``; an
    image without that map is not counted in them. This is the paper's protocol where
    ``per_image`` is read; ``min_share=0.1`` adds the rule of the authors' release.

    All states are sums over images, so they add up over batches and ranks.
    """

    def __init__(
        self,
        max_disparity: float = 192.0,
        thresholds: Sequence[float] = (1, 2, 3),
        min_share: float = 0.0,
    ) -> None:
        """Initialise with all sums at zero.

        Args:
            max_disparity: Ground truth in ``0 < d < max_disparity`` is scored, in px; ``inf``
                scores all of it.
            thresholds: The n of px-n, in px.
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
        self.names = ("epe", "d1", *(f"px-{threshold:g}" for threshold in self.thresholds))
        self.reset()

    def reset(self) -> None:
        """Set all sums to zero."""
        self.image_sums = torch.zeros(len(MASKS), len(self.names), dtype=torch.float64)
        self.pixel_sums = torch.zeros_like(self.image_sums)
        zeros = torch.zeros(len(MASKS), dtype=torch.int64)
        self.images, self.empty, self.skipped, self.pixels = (zeros.clone() for _ in range(4))

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
        for index, mask in _masks(scored, batch):
            pixels = torch.where(skipped, 0, mask.sum((1, 2)))
            sums = torch.stack([_masked_sum(figure, mask) for figure in figures], dim=1)
            counted = pixels > 0
            sums = torch.where(counted[:, None], sums, 0)
            means = sums / pixels.clamp_min(1)[:, None]
            for state, value in (
                (self.image_sums, means.sum(0)),
                (self.pixel_sums, sums.sum(0)),
                (self.images, counted.sum()),
                (self.empty, (~counted & ~skipped).sum()),
                (self.skipped, skipped.sum()),
                (self.pixels, pixels.sum()),
            ):
                state[index] += value.to(state.device)

    def compute(self) -> StereoScores:
        """Figures of everything added, over all ranks."""
        image_sums, pixel_sums = _over_ranks(self.image_sums), _over_ranks(self.pixel_sums)
        states = (self.images, self.empty, self.skipped, self.pixels)
        counts = torch.stack([_over_ranks(state) for state in states], dim=1).tolist()
        masks = {}
        for index, name in enumerate(MASKS):
            images, empty, skipped, pixels = counts[index]
            if name == "all" or any(counts[index]):
                masks[name] = MaskScores(
                    self._means(image_sums[index], images),
                    self._means(pixel_sums[index], pixels),
                    images,
                    empty,
                    skipped,
                    pixels,
                )
        return StereoScores(self.max_disparity, self.min_share, masks)

    def _pixel_figures(self, prediction: Tensor, truth: Tensor) -> list[Tensor]:
        """Each figure at each pixel, (B, H, W), in the order of ``names``."""
        error = (prediction - truth).abs()
        # "not within" instead of "above": an error of NaN is an outlier, too.
        d1 = ~((error <= 3) | (error <= 0.05 * truth))
        return [error, 100.0 * d1, *(100.0 * ~(error <= n) for n in self.thresholds)]

    def _means(self, sums: Tensor, count: int) -> dict[str, float | None]:
        values = [float(total) / count if count else None for total in sums]
        return dict(zip(self.names, values, strict=True))


def _over_ranks(state: Tensor) -> Tensor:
    """Sum over all ranks of a distributed run; the state itself outside of one."""
    distributed = torch.distributed
    if not (distributed.is_available() and distributed.is_initialized()):
        return state
    # NCCL adds on GPUs alone.
    total = state.cuda() if distributed.get_backend() == "nccl" else state.clone()
    distributed.all_reduce(total)
    return total.cpu()


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


def _masked_sum(figure: Tensor, mask: Tensor) -> Tensor:
    """Sum of each image over its mask, (B,), in float64."""
    return torch.where(mask, figure, 0.0).sum((1, 2), dtype=torch.float64)


def _label(figure: str) -> str:
    return {"epe": "EPE, px", "d1": "D1, %"}.get(figure, f"{figure}, %")
