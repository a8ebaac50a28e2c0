"""What a user says about the views as options of a command, and what the first look finds."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from mobilestereonet.cli.early import LAYOUTS, ORDERS, ROTATIONS, one_of
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.inference.finding import Finding
    from mobilestereonet.inference.first_look import ViewOptions


Layout: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Of one picture with both views: side-by-side or top-bottom. Default: what a look at "
        "it says.",
        callback=one_of(LAYOUTS),
    ),
]


@dataclass(frozen=True)
class LayoutFlags:
    """Options that say how the views lie, where the first look errs."""

    layout: Layout = None
    order: Annotated[
        str | None,
        typer.Option(
            help="Order of the views (files, or halves from the left or from above): left-right or "
            "right-left. Default: likewise.",
            callback=one_of(ORDERS),
        ),
    ] = None
    rotate: Annotated[
        int | None,
        typer.Option(
            help="Turn both views clockwise: 0, 90, 180 or 270 degrees. Default: likewise.",
            callback=one_of(ROTATIONS),
        ),
    ] = None

    @property
    def views(self) -> ViewOptions:
        """The options as the first look takes them."""
        from mobilestereonet.inference.first_look import ViewOptions

        return ViewOptions(self.layout, self.order, self.rotate)


@dataclass(frozen=True)
class ViewFlags(LayoutFlags):
    """Options that say how the views lie, and what the first look may stop."""

    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Write depth and points also of views that cannot give right ones."
        ),
    ] = False

    def report(self, findings: Iterable[Finding], metric: bool) -> bool:
        """Say what the first look found.

        Args:
            findings: What it found.
            metric: Whether depth or points are asked for.

        Returns:
            Whether the views can give right ones, or ``--force`` is given.

        Raises:
            InputError: If they are, the views cannot give right ones, and ``--force`` is not given.
        """
        from mobilestereonet.inference.first_look import problems

        tell_findings(findings)
        wrong = problems(findings)
        if metric and wrong and not self.force:
            raise InputError(
                f"no depth and no points of such views ({wrong[0].check}): put them right, or say "
                "--force"
            )
        return self.force or not wrong


def tell_findings(findings: Iterable[Finding]) -> None:
    """Print what is not as it should be."""
    for finding in findings:
        if finding.level not in ("good", "unknown"):
            print(f"msnet: {finding} (see `msnet doctor`)", file=sys.stderr)
