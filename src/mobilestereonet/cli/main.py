"""The ``msnet`` command."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from mobilestereonet import __version__
from mobilestereonet.atomic import one_call
from mobilestereonet.cli.ablate import ablate
from mobilestereonet.cli.average import average
from mobilestereonet.cli.batch import batch
from mobilestereonet.cli.bench import bench
from mobilestereonet.cli.cost import cost
from mobilestereonet.cli.data import data
from mobilestereonet.cli.demo import demo
from mobilestereonet.cli.doctor import doctor
from mobilestereonet.cli.evaluate import evaluate
from mobilestereonet.cli.export import export
from mobilestereonet.cli.groups import with_options_of_groups
from mobilestereonet.cli.live import LiveCommand, live
from mobilestereonet.cli.models import models
from mobilestereonet.cli.plot_run import plot_run
from mobilestereonet.cli.predict import predict
from mobilestereonet.cli.process import prepare_process, report
from mobilestereonet.cli.rectify import rectify
from mobilestereonet.cli.submit import submit
from mobilestereonet.cli.train import train
from mobilestereonet.cli.video import video
from mobilestereonet.cli.web import web

app = typer.Typer(
    name="msnet",
    help="Stereo matching with MobileStereoNet: a rectified pair in, disparity and depth out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


_DEBUG = "--debug"


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"mobilestereonet {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
    debug: Annotated[
        bool, typer.Option(_DEBUG, help="Print the traceback of an error as well.")
    ] = False,
) -> None:
    """Options of the program itself; `app` has the help text."""


for command in (
    demo,
    predict,
    doctor,
    rectify,
    video,
    batch,
    models,
    cost,
    evaluate,
    submit,
    train,
    average,
    ablate,
    plot_run,
    export,
    bench,
    web,
):
    app.command()(with_options_of_groups(command))
app.command(cls=LiveCommand)(with_options_of_groups(live))
app.add_typer(data)


def main() -> None:
    """Run the command line; an error ends with one line on stderr.

    Exit code 2 for bad input, 70 for what nobody foresaw. ``--debug`` may stand anywhere.
    """
    prepare_process()
    arguments = [word for word in sys.argv[1:] if word != _DEBUG]
    try:
        with one_call():
            app(arguments, prog_name=app.info.name)
    except Exception as error:
        sys.exit(report(error, debug=_DEBUG in sys.argv))
