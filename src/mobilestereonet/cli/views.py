"""What a user says about the views as options of a command, and what the first look finds."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.early import LAYOUTS, ORDERS, ROTATIONS, one_of
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.inference.finding import Finding
    from mobilestereonet.inference.first_look import ViewOptions


@dataclass(frozen=True)
class ViewFlags:
    """Options that say how the views lie, where the first look errs, and what it may stop."""

    layout: Annotated[
        str | None,
        typer.Option(
            help="Of one picture with both views: side-by-side or top-bottom. Default: what a look "
            "at it says, as for the two options that follow.",
            callback=one_of(LAYOUTS),
        ),
    ] = None
    order: Annotated[
        str | None,
        typer.Option(
            help="Order of the views (files, or halves from the left or from above): left-right or "
            "right-left.",
            callback=one_of(ORDERS),
        ),
    ] = None
    rotate: Annotated[
        int | None,
        typer.Option(
            help="Turn both views clockwise: 0, 90, 180 or 270 degrees.",
            callback=one_of(ROTATIONS),
        ),
    ] = None
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Write depth and points also of views that cannot give right ones."
        ),
    ] = False

    @property
    def views(self) -> ViewOptions:
        """The options as the first look takes them."""
        from mobilestereonet.inference.first_look import ViewOptions

        return ViewOptions(self.layout, self.order, self.rotate)

    def report(self, findings: Iterable[Finding], metric: bool, joined: str | None = None) -> None:
        """Say what the first look found.

        Args:
            findings: What it found.
            metric: Whether depth or points are asked for.
            joined: Source whose pictures should have both views each; None if it is none.

        Raises:
            InputError: If ``--force`` is not given, and metric outputs are asked for of views that
                cannot give right ones; or ``joined`` shows no two views.
        """
        from mobilestereonet.inference.first_look import problems

        for finding in findings:
            if finding.level not in ("good", "unknown"):
                print(f"msnet: {finding} (see `msnet doctor`)", file=sys.stderr)
        wrong = problems(findings)
        alone = joined is not None and self.layout is None and not self.force
        if alone and any(finding.check == "overlap" for finding in wrong):
            raise InputError(
                f"{joined}: the halves of its picture show no common scene: give the right view's, "
                "too, if this is the left one's; if it has both views, --layout side-by-side or "
                "top-bottom"
            )
        if metric and wrong and not self.force:
            raise InputError(
                f"no depth and no points of such views ({wrong[0].check}): put them right, or say "
                "--force"
            )
