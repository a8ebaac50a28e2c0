"""The ``msnet`` command."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from inspect import cleandoc
from typing import Annotated

import typer

from mobilestereonet import __version__
from mobilestereonet.atomic import one_call
from mobilestereonet.cli.ablate import ablate
from mobilestereonet.cli.average import average
from mobilestereonet.cli.batch import batch
from mobilestereonet.cli.bench import bench
from mobilestereonet.cli.compare import compare
from mobilestereonet.cli.cost import cost
from mobilestereonet.cli.data import data
from mobilestereonet.cli.demo import demo
from mobilestereonet.cli.doctor import doctor
from mobilestereonet.cli.evaluate import evaluate
from mobilestereonet.cli.export import export
from mobilestereonet.cli.fit_confidence import fit_confidence
from mobilestereonet.cli.groups import with_options_of_groups
from mobilestereonet.cli.info import info
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
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
    epilog="Example: msnet demo. What a command does: msnet predict --help.",
)

COMMANDS: dict[str, dict[Callable[..., None], str]] = {
    "Match": {
        demo: "demo",
        predict: "predict left.png right.png --rig stereo.yml --depth depth.png",
        batch: "batch left/ right/ -o maps --skip-existing",
        video: "video left.mp4 right.mp4 -o disparity.mp4",
        live: "live 0 --show browser",
        web: "web --port 8000",
    },
    "Cameras": {
        doctor: "doctor left.png right.png",
        rectify: "rectify left.png right.png --rig stereo.yml -o rectified",
    },
    "Networks and engines": {
        models: "models msnet3d",
        bench: "bench --levels",
        export: "export onnx --model msnet2d",
        cost: "cost --model msnet2d --height 384 --width 1248",
        info: "info",
    },
    "Research": {
        evaluate: "evaluate --data kitti2015 --root kitti/ --model msnet3d",
        compare: "compare runs/* --data kitti2015 --root kitti/ -o table.tex",
        submit: "submit kitti2015 --root kitti/ -o kitti2015.zip",
        train: "train runs/first --model msnet2d --set lr=5e-4",
        plot_run: "plot-run runs/first",
        average: "average runs/first/last.ckpt runs/second/last.ckpt",
        fit_confidence: "fit-confidence msnet2d -o fitted.safetensors",
        ablate: "ablate runs --models msnet2d --vary lr=1e-3,5e-4 --seeds 3",
    },
}
"""The commands by their panel in the help, each with an example."""


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


for panel, commands in COMMANDS.items():
    for command, example in commands.items():
        app.command(
            cls=LiveCommand if command is live else None,
            help=re.sub(r"(?<!\n)\n(?!\n)", " ", cleandoc(command.__doc__ or "")),
            epilog=f"Example: msnet {example}",
            rich_help_panel=panel,
        )(with_options_of_groups(command))
app.add_typer(data, rich_help_panel="Research", epilog="Example: msnet data list")


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
