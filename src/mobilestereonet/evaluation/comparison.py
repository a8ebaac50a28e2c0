"""Several models in one table: columns as the data set's leaderboard names them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mobilestereonet.errors import InputError
from mobilestereonet.evaluation.evaluate import Evaluation
from mobilestereonet.evaluation.result_table import Cell, ResultTable, Spread, TableColumn
from mobilestereonet.settings import choice_hint

STATISTICS = {"mean": "per_image", "median": "median", "per-pixel": "per_pixel"}
"""Statistics of a column, and the attributes of `MaskScores` that have them."""

Figures = Mapping[str, float | None]
"""Figures of a model by the titles of the columns; None is unknown."""


@dataclass(frozen=True)
class Column:
    """Figure of a comparison.

    Attributes:
        title: What the data set's leaderboard calls it.
        figure: Its name in `MaskScores`: ``epe``, ``d1``, ``bad2``; or ``seconds``.
        mask: The pixels over which it is taken.
    """

    title: str
    figure: str
    mask: str = "all"

    @property
    def head(self) -> TableColumn:
        """Heading with the unit, and digits."""
        unit, digits = {"epe": ("px", 3), "seconds": ("s", 3)}.get(self.figure, ("%", 2))
        return TableColumn(f"{self.title} ({unit})", digits)

    def of(self, evaluation: Evaluation, statistic: str) -> float | None:
        """The figure of an evaluation; None where its data does not know the mask."""
        if self.figure == "seconds":
            return evaluation.seconds_per_image
        scores = evaluation.scores.masks.get(self.mask)
        if scores is None:
            return None
        values: Mapping[str, float | None] = getattr(scores, STATISTICS[statistic])
        return values.get(self.figure)


PAPER_COLUMNS = (Column("EPE", "epe"), Column("D1", "d1"), Column("px-3", "bad3"))
"""Columns of the paper's tables of errors."""

SECONDS = Column("time", "seconds")

_MIDDLEBURY = (
    Column("bad 2.0 nonocc", "bad2", "noc"),
    Column("avgerr nonocc", "epe", "noc"),
    Column("bad 2.0 all", "bad2"),
    Column("avgerr all", "epe"),
)

_LEADERBOARDS: Mapping[str, tuple[Column, ...]] = {
    "kitti2012": (
        Column("Out-Noc", "bad3", "noc"),
        Column("Out-All", "bad3"),
        Column("Avg-Noc", "epe", "noc"),
        Column("Avg-All", "epe"),
    ),
    "kitti2015": (
        Column("D1-bg", "d1", "bg"),
        Column("D1-fg", "d1", "fg"),
        Column("D1-all", "d1"),
        Column("EPE", "epe"),
    ),
    "midd": _MIDDLEBURY,
    "eth3d": (
        Column("bad 1.0 noc", "bad1", "noc"),
        Column("avgerr noc", "epe", "noc"),
        Column("bad 1.0 all", "bad1"),
        Column("avgerr all", "epe"),
    ),
    "spring": (Column("1px", "bad1"), Column("Abs", "epe"), Column("D1", "d1")),
}
"""Columns of the leaderboards, by the beginnings of the data sets' names."""


def leaderboard_columns(data: str) -> tuple[Column, ...]:
    """Columns as a data set's leaderboard names them, else those of the paper.

    Args:
        data: Name of the data set, such as ``kitti2015``.
    """
    for beginning, columns in _LEADERBOARDS.items():
        if data.startswith(beginning):
            return columns
    return PAPER_COLUMNS


def compare_evaluations(
    groups: Mapping[str, Sequence[Evaluation]],
    data: str,
    *,
    statistic: str = "mean",
    printed: Mapping[str, Mapping[str, float]] | None = None,
    notes: str = "",
) -> ResultTable:
    """One table of evaluations on the same pairs.

    Args:
        groups: Evaluations by the names of their rows; those of one row differ by the seed.
        data: Name of the data set, which tells the columns.
        statistic: One of `STATISTICS`, over the images.
        printed: A paper's figures by row, then by `Column.figure`, to put beside the measured
            ones.
        notes: What else there is to know about the figures.

    Raises:
        InputError: If there is no such statistic, or nothing to compare.
    """
    if statistic not in STATISTICS:
        raise InputError(f"statistic {statistic}: {choice_hint(statistic, STATISTICS)}")
    found = [evaluation for group in groups.values() for evaluation in group]
    if not found:
        raise InputError("a comparison needs at least one evaluation")
    columns = list(leaderboard_columns(data))
    if printed is not None:
        there = {column.figure for column in columns if column.mask == "all"}
        columns += [column for column in PAPER_COLUMNS if column.figure not in there]
    known = {"seconds", *found[0].scores.masks["all"].per_image}
    columns = [column for column in columns if column.figure in known] + [SECONDS]
    rows = {
        name: [{column.title: column.of(one, statistic) for column in columns} for one in group]
        for name, group in groups.items()
    }
    count = len(found[0].pairs)
    over = {"per-pixel": "means over all pixels"}.get(statistic, f"{statistic}s over the images")
    return comparison_table(
        rows,
        columns,
        title=f"{found[0].data}, {count} pair{'s' if count > 1 else ''}",
        notes=f"Figures are {over}, of pixels with ground truth 0 < d < "
        f"{found[0].scores.max_disparity:g}. {notes}".strip(),
        printed=printed,
    )


def comparison_table(
    rows: Mapping[str, Sequence[Figures]],
    columns: Sequence[Column],
    *,
    title: str,
    notes: str = "",
    printed: Mapping[str, Mapping[str, float]] | None = None,
) -> ResultTable:
    """Table of figures, with means and standard deviations over the seeds of a row.

    Args:
        rows: The figures of each seed, by the rows' names.
        columns: Columns, whose titles name the figures.
        title: What was measured, on what.
        notes: What there is to know about the figures.
        printed: A paper's figures by row, then by `Column.figure`.
    """
    heads = [TableColumn("model")]
    table: list[list[Cell]] = [[name] for name in rows]
    seeds = [len(group) for group in rows.values()]
    if max(seeds, default=0) > 1:
        heads.append(TableColumn("seeds", 0))
        for row, count in zip(table, seeds, strict=True):
            row.append(Spread(count))
        notes = f"{notes} ± is the standard deviation over the seeds."
    beside = printed or {}
    for column in columns:
        heads.append(column.head)
        papers = [beside.get(name, {}).get(column.figure) for name in rows]
        papers = papers if column.mask == "all" else [None] * len(papers)
        for row, group in zip(table, rows.values(), strict=True):
            row.append(Spread.of([figures.get(column.title) for figures in group]))
        if any(paper is not None for paper in papers):
            heads.append(TableColumn(f"{column.title}, paper", 2))
            for row, paper in zip(table, papers, strict=True):
                row.append(None if paper is None else Spread(paper))
    return ResultTable(title, tuple(heads), tuple(map(tuple, table)), notes.strip())
