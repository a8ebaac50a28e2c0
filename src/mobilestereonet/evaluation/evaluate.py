"""Evaluation of a matcher on a data set."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from statistics import median
from typing import Any

import torch
from rich.table import Table
from torch import Tensor

from mobilestereonet.data.files import write_png
from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation.matching import DisparityFn, timed_match
from mobilestereonet.evaluation.report import scores_table, write_json, write_rows
from mobilestereonet.metrics import StereoMetrics, StereoScores
from mobilestereonet.plots import colour_disparity, error_map, side_by_side, thicken


@dataclass(frozen=True)
class EvaluationProtocol:
    """Evaluation protocol: crop and padding of the views, and which pixels are scored.

    Attributes:
        max_disparity: Pixels with ground truth in ``0 < d < max_disparity`` count, in px.
        min_share: Skip an image where less than this share of its ground truth is in that range.
        crop: Height and width of the bottom right part of the frame that is matched and scored;
            None for all of it.
        padding: Height and width to which inference pads the normalised views; None for the next
            size that the engine takes. `evaluate` sees whole views only: it is for
            ``StereoMatcher(..., padding=...)``, by whoever makes the matcher.
    """

    max_disparity: float = 192.0
    min_share: float = 0.0
    crop: tuple[int, int] | None = None
    padding: tuple[int, int] | None = None


def authors_protocol(data: str) -> EvaluationProtocol:
    """Protocol of the paper authors' release for a data set.

    Args:
        data: Name of the data set, such as ``sceneflow`` or ``kitti2015``.

    Returns:
        Its protocol: the rule of 10 % everywhere, SceneFlow's crop to 512 x 960, KITTI's padding
        to 384 x 1248.
    """
    protocol = EvaluationProtocol(min_share=0.1)
    if data.startswith("kitti"):
        return replace(protocol, padding=(384, 1248))
    if data.startswith(("sceneflow", "flyingthings")):
        return replace(protocol, crop=(512, 960))
    return protocol


@dataclass(frozen=True)
class Evaluation:
    """Scores of one model on one data set; a console of `rich` prints them as a table.

    Attributes:
        model: Name of the model.
        data: Name of the data set.
        protocol: Evaluation protocol.
        scores: Error figures.
        pairs: Names of the pairs, in the order of ``scores.pairs``.
        seconds: Time of each pair: of its call, divided by the number of pairs in it.
    """

    model: str
    data: str
    protocol: EvaluationProtocol
    scores: StereoScores
    pairs: tuple[str, ...]
    seconds: tuple[float, ...]

    @property
    def seconds_per_image(self) -> float:
        """Median time of a pair."""
        return median(self.seconds)

    def row(self) -> dict[str, Any]:
        """All pairs in one row: model, data, seconds and `StereoScores.columns`."""
        names = {"model": self.model, "data": self.data, "pairs": len(self.pairs)}
        return {**names, "seconds_median": self.seconds_per_image, **self.scores.columns()}

    def pair_rows(self) -> list[dict[str, Any]]:
        """One row per pair: model, data, pair, seconds and the columns of `StereoScores`."""
        own = zip(self.pairs, self.seconds, self.scores.pairs, strict=True)
        names = {"model": self.model, "data": self.data}
        return [{**names, "pair": n, "seconds": s, **columns} for n, s, columns in own]

    def to_dict(self) -> dict[str, Any]:
        """Plain dicts, ready for JSON."""
        scores = self.scores.to_dict()
        protocol = {**asdict(self.protocol), "max_disparity": scores["max_disparity"]}
        return {
            "model": self.model,
            "data": self.data,
            "protocol": protocol,
            "seconds_per_image": self.seconds_per_image,
            "masks": scores["masks"],
            "pairs": self.pair_rows(),
        }

    def table(self, legend: bool = True) -> Table:
        """Table of `rich` with the figures, and below it what they mean."""
        title = f"{self.model} on {self.data}, {self.seconds_per_image:.3f} s per image"
        return scores_table(self.scores, title, legend)

    def __rich__(self) -> Table:
        return self.table()


def save_evaluations(
    evaluations: Sequence[Evaluation],
    json: Path | None = None,
    summary: Path | None = None,
    pairs: Path | None = None,
) -> None:
    """Write evaluations to files.

    Args:
        evaluations: One for each model.
        json: Everything, as a JSON list with one record per model.
        summary: CSV file with one row per model.
        pairs: CSV file with one row per model and pair.
    """
    if json is not None:
        write_json([evaluation.to_dict() for evaluation in evaluations], json)
    if summary is not None:
        write_rows([evaluation.row() for evaluation in evaluations], summary)
    if pairs is not None:
        write_rows([row for evaluation in evaluations for row in evaluation.pair_rows()], pairs)


def evaluate(
    match: DisparityFn,
    data: Iterable[StereoSample],
    *,
    model: str,
    data_name: str,
    protocol: EvaluationProtocol | None = None,
    thresholds: Sequence[float] = (1, 2, 3),
    batch_size: int = 1,
    pictures: Path | None = None,
) -> Evaluation:
    """Match every pair and score it against its ground truth.

    Args:
        match: Matcher to score.
        data: Single samples with ground truth. Their sizes may differ: consecutive samples of one
            size share a batch.
        model: Name of ``match`` in the report.
        data_name: Name of ``data`` in the report.
        protocol: Evaluation protocol; by default whole frames and ``0 < d < 192``.
        thresholds: The t of bad-t, in px.
        batch_size: Pairs per call at most. It does not change the figures.
        pictures: Folder for one picture per pair: left view, disparity, KITTI's error map.

    Returns:
        Scores and time.

    Raises:
        InputError: If there is no sample, a sample has no ground truth, none has a pixel to
            score, or ``match`` gives a wrong shape or values that are not finite.
    """
    protocol = protocol or EvaluationProtocol()
    metrics = StereoMetrics(protocol.max_disparity, thresholds, protocol.min_share)
    names: list[str] = []
    seconds: list[float] = []
    for samples in _batches((_crop(sample, protocol.crop) for sample in data), batch_size):
        batch = collate(samples)
        prediction, elapsed = timed_match(match, batch)
        metrics.update(prediction, batch)
        names += [sample.name for sample in samples]
        seconds += [elapsed / len(samples)] * len(samples)
        if pictures is not None:
            for sample, disparity in zip(samples, prediction, strict=True):
                path = pictures / f"{sample.name.replace('/', '_')}.png"
                write_png(path, _picture(sample, disparity, protocol.max_disparity))
    if not seconds:
        raise InputError(f"{data_name} has no sample to score")
    scores = metrics.compute()
    if not scores.masks["all"].pixels and not scores.masks["all"].skipped:
        raise InputError(
            f"{data_name}: none of its {len(seconds)} pairs has a pixel with ground truth between "
            f"0 and {protocol.max_disparity:g} px: is its scale right?"
        )
    return Evaluation(model, data_name, protocol, scores, tuple(names), tuple(seconds))


def _batches(data: Iterable[StereoSample], size: int) -> Iterator[list[StereoSample]]:
    """Group consecutive samples of equal shapes, ``size`` at most."""
    batch: list[StereoSample] = []
    for sample in data:
        if batch and (len(batch) >= size or _shapes(sample) != _shapes(batch[0])):
            yield batch
            batch = []
        batch.append(sample)
    if batch:
        yield batch


def _shapes(sample: StereoSample) -> dict[str, torch.Size]:
    """Shape of each map that a sample has: a batch leaves out a map that one of them lacks."""
    return {name: tensor.shape for name, tensor in _tensors(sample).items()}


def _tensors(sample: StereoSample) -> dict[str, Tensor]:
    values = {field.name: getattr(sample, field.name) for field in fields(sample)}
    return {name: value for name, value in values.items() if isinstance(value, Tensor)}


def _crop(sample: StereoSample, size: tuple[int, int] | None) -> StereoSample:
    """Crop the bottom right part of a sample, without its calibration, which no longer fits."""
    if size is None:
        return sample
    height, width = size
    if height > sample.left.shape[-2] or width > sample.left.shape[-1]:
        raise InputError(
            f"{sample.name}: cannot crop {height}x{width} from a frame of "
            f"{sample.left.shape[-2]}x{sample.left.shape[-1]}"
        )
    parts: dict[str, Any] = {
        name: tensor[..., -height:, -width:] for name, tensor in _tensors(sample).items()
    }
    return replace(sample, calibration=None, **parts)


def _picture(sample: StereoSample, prediction: Tensor, max_disparity: float) -> Picture:
    assert sample.disparity is not None and sample.valid is not None  # metrics saw to it
    scored = sample.valid & (sample.disparity > 0) & (sample.disparity < max_disparity)
    # One range for all models, whose pictures are compared.
    largest = float(sample.disparity[scored].max()) if scored.any() else None
    errors = error_map(prediction, sample.disparity, scored, sample.occluded)
    if scored.float().mean() < 0.5:
        errors = thicken(errors, scored)
    panels = [to_picture(sample.left), colour_disparity(prediction, largest), errors]
    title = "disparity" if largest is None else f"disparity, to {largest:.0f} px"
    return side_by_side(panels, [sample.name, title, "error, as KITTI colours it"])
