"""What the commands share that score models on a data set: options, matchers, progress, rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.early import STATISTICS, assignment, one_of
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.options import DataRoot, Split
from mobilestereonet.cli.sources import data_sets
from mobilestereonet.settings import parse_assignments

if TYPE_CHECKING:
    from mobilestereonet.data import StereoDataSet
    from mobilestereonet.evaluation import Evaluation, EvaluationProtocol, ResultTable
    from mobilestereonet.inference import Rectifier, StereoMatcher


@dataclass(frozen=True, kw_only=True)
class ScoringOptions:
    """Options that choose the pairs, and how models are scored on them."""

    data: Annotated[
        str,
        typer.Option(
            help="Data set of `msnet data list`, such as kitti2015, sceneflow, folder.",
            callback=one_of(data_sets),
        ),
    ]
    root: DataRoot
    split: Split = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="An option of the data set, such as size=H, or a value of the networks' configs "
            "in place of the weights' own, such as net.estimator=mean. Repeat for more.",
            callback=assignment,
        ),
    ] = None
    authors: Annotated[
        bool,
        typer.Option(
            "--authors-protocol",
            help="Crop, pad and skip images as the paper's authors do on this data set.",
        ),
    ] = False
    max_disparity: Annotated[
        float, typer.Option(help="Score ground truth below this, in px; inf for all of it.")
    ] = 192
    threshold: Annotated[
        list[float] | None, typer.Option(help="A t of bad-t. Repeat for more. Default: 1 2 3.")
    ] = None
    batch_size: Annotated[int, typer.Option(metavar="<n>", min=1, help="Pairs per call.")] = 1
    statistic: Annotated[
        str,
        typer.Option(
            help="Of the table that compares models: mean or median over the images, or per-pixel.",
            callback=one_of(STATISTICS),
        ),
    ] = "mean"
    paper: Annotated[
        bool,
        typer.Option(
            "--paper",
            help="The MobileStereoNet paper's printed figures beside (SceneFlow, KITTI 2015).",
        ),
    ] = False

    def open(self) -> StereoDataSet:
        """The pairs, checked to have ground truth.

        Raises:
            FileNotFoundError: If nothing is found.
            InputError: If an option is bad, or the pairs have no ground truth.
        """
        from mobilestereonet.data import open_data_set

        texts = [text for text in self.settings or () if not text.startswith("net.")]
        options = parse_assignments(texts) | ({} if self.split is None else {"split": self.split})
        pairs = open_data_set(self.data, self.root, **options)
        pairs.require_truth()
        return pairs

    @property
    def of_networks(self) -> list[str]:
        """Settings of the networks' configs."""
        return [text for text in self.settings or () if text.startswith("net.")]

    @property
    def protocol(self) -> EvaluationProtocol:
        """The protocol that the options ask for."""
        from mobilestereonet.evaluation import EvaluationProtocol, authors_protocol

        own = authors_protocol(self.data) if self.authors else EvaluationProtocol()
        return replace(own, max_disparity=self.max_disparity)

    def open_matcher(self, options: MatcherOptions) -> StereoMatcher:
        """A matcher that pads as the protocol says; sgbm, which takes no normalised views, not."""
        standalone = options.model == "sgbm"
        return options.open_matcher(padding=None if standalone else self.protocol.padding)

    def score(
        self,
        matcher: StereoMatcher,
        pairs: StereoDataSet,
        name: str,
        pictures: Path | None = None,
        rectifier: Rectifier | None = None,
    ) -> Evaluation:
        """Score one matcher, with a progress bar on a terminal; see `evaluate`.

        Args:
            matcher: The matcher.
            pairs: The data set.
            name: Name of the model in the report.
            pictures: Folder for one picture per pair.
            rectifier: Rectifies the views, whose ground truth is rectified already.
        """
        from rich.console import Console
        from rich.progress import track

        from mobilestereonet.evaluation import evaluate

        console = Console(stderr=True)
        indices = track(
            range(len(pairs)),
            f"{name} on {pairs}",
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        protocol = self.protocol
        if matcher.model == "sgbm":
            protocol = replace(protocol, padding=None)
        return evaluate(
            matcher.disparity,
            (
                pairs[index] if rectifier is None else rectifier.sample(pairs[index])
                for index in indices
            ),
            model=name,
            data_name=str(pairs),
            protocol=protocol,
            thresholds=self.threshold or (1, 2, 3),
            batch_size=self.batch_size,
            pictures=pictures,
        )

    def printed(self) -> dict[str, dict[str, float]] | None:
        """The paper's figures on the data set by network, if they are asked for.

        Raises:
            InputError: If the paper prints none on it.
        """
        if not self.paper:
            return None
        from mobilestereonet.paper.tables import printed_errors

        return printed_errors(self.data)

    def table(
        self,
        groups: dict[str, list[Evaluation]],
        networks: dict[str, str],
        printed: dict[str, dict[str, float]] | None,
    ) -> ResultTable:
        """One table of all models.

        Args:
            groups: Evaluations by row.
            networks: Network of each row, by which the paper's figures are found.
            printed: See `printed`.
        """
        from mobilestereonet.evaluation import compare_evaluations
        from mobilestereonet.paper.tables import PRINTED_ON

        beside = printed and {row: printed.get(name, {}) for row, name in networks.items()}
        notes = "" if printed is None else PRINTED_ON
        return compare_evaluations(
            groups, self.data, statistic=self.statistic, printed=beside, notes=notes
        )
