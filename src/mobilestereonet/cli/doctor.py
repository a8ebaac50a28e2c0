"""``msnet doctor``."""

from __future__ import annotations

from typing import Annotated

import typer

from mobilestereonet.cli.calibration import RigFiles
from mobilestereonet.cli.options import AsJson, LeftView, SecondView
from mobilestereonet.cli.views import LayoutFlags


def doctor(
    left: LeftView,
    right: SecondView = None,
    max_disparity: Annotated[
        int, typer.Option(min=1, help="Disparities that the network searches, in px.")
    ] = 192,
    as_json: AsJson = False,
    *,
    views: LayoutFlags,
    files: RigFiles,
) -> None:
    """Say whether a pair is fit for stereo matching, and what to do.

    Exit code 1: it is not.
    """
    import json
    from dataclasses import asdict

    from rich.console import Console

    from mobilestereonet.inference import load_pair
    from mobilestereonet.inference.first_look import check_whole

    colours = {"good": "green", "fixed": "green", "problem": "red"}
    rectifier, pair = files.read(), load_pair(left, right, layout=views.layout)
    findings = check_whole(pair, max_disparity, rectifier, views.views)
    if as_json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        console = Console(highlight=False)
        for finding in findings:
            level = f"[{colours.get(finding.level, 'yellow')}]{finding.level:8}[/]"
            console.print(f"{level} {finding.check}: {finding.text}", soft_wrap=True)
            if finding.advice:
                console.print(f"         -> {finding.advice}", soft_wrap=True)
    if any(finding.level == "problem" for finding in findings):
        raise typer.Exit(1)
