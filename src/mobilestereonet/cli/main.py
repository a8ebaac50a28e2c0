"""The ``msnet`` command."""

from __future__ import annotations

import sys

import typer

from mobilestereonet.errors import InputError

app = typer.Typer(
    name="msnet",
    help="Stereo matching with MobileStereoNet: a rectified pair in, disparity and depth out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command line; bad input ends with one line on stderr and exit code 2."""
    try:
        app()
    except (InputError, OSError) as error:
        print(f"msnet: {error}", file=sys.stderr)
        sys.exit(2)
