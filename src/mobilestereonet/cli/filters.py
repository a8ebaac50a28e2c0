"""The filter of everything metric as options of a command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.cli.engine import MatcherOptions
    from mobilestereonet.inference import StereoMatcher


@dataclass(frozen=True)
class FilterOptions:
    """Options that say which pixels have a depth: in maps, points and messages alike."""

    min_confidence: Annotated[
        float,
        typer.Option(
            metavar="<p>",
            min=0,
            max=1,
            help="No depth where the probability of an error below 3 px is less.",
        ),
    ] = 0.0
    max_depth: Annotated[
        float, typer.Option(metavar="<m>", min=0, help="No depth beyond this, in metres.")
    ] = float("inf")
    keep_edges: Annotated[
        bool | None,
        typer.Option(
            "--keep-edges/--drop-edges",
            help="Pixels at depth edges, which lie between two surfaces. Default: depth maps have "
            "them, points do not.",
            show_default=False,
        ),
    ] = None
    left_right: Annotated[
        bool,
        typer.Option(
            "--left-right",
            help="Match the right view as well: no depth where both disagree, as where the right "
            "camera sees nothing. Takes twice the time; predict writes its maps, too.",
        ),
    ] = False

    def require(self, metric: bool) -> None:
        """Refuse limits of depth where nothing metric is asked for.

        Raises:
            InputError: If there are any.
        """
        limits = {
            "--min-confidence": self.min_confidence > 0,
            "--max-depth": self.max_depth < float("inf"),
            "--keep-edges": self.keep_edges is not None,
        }
        given = [option for option, is_given in limits.items() if is_given]
        if given and not metric:
            raise InputError(
                f"{', '.join(given)} is for depth and points: ask for some, or leave it out"
            )

    def open_matcher(
        self, options: MatcherOptions, *, confidence: bool = False, **more: Any
    ) -> StereoMatcher:
        """The matcher whose results have this filter.

        Args:
            options: Network and engine.
            confidence: Results have a confidence, whether the filter needs it or not.
            **more: Other arguments of `StereoMatcher.from_pretrained`.

        Raises:
            InputError: As `MatcherOptions.open_matcher`.
        """
        from mobilestereonet.inference.filter import MetricFilter

        limits = MetricFilter(self.min_confidence, self.max_depth, self.keep_edges)
        matcher = options.open_matcher(
            confidence=confidence or self.min_confidence > 0, left_right=self.left_right, **more
        )
        matcher.filter = limits
        return matcher
