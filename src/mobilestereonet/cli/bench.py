"""``msnet bench``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.calibration import RigFiles
from mobilestereonet.cli.engine import Device, NetworkOptions, Threads
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.inference import Rectifier

_SIZE = (256, 512)


def bench(
    *,
    options: NetworkOptions,
    size: Annotated[
        tuple[int, int] | None,
        typer.Option(
            help="Height and width, multiples of the network's. Default: 256 512; of a rig its "
            "own, of pictures as the cameras take them, padded as predict does it.",
            show_default=False,
        ),
    ] = None,
    threads: Threads = None,
    device: Device = "auto",
    repeats: Annotated[int, typer.Option(min=1, help="Timed runs of each engine.")] = 5,
    levels: Annotated[
        bool, typer.Option("--levels", help="Time the quality levels instead, as predict has them.")
    ] = False,
    files: RigFiles,
) -> None:
    """Time every installed engine on this machine.

    Times are compared with PyTorch unaccelerated in fp32. Engines that cannot run the network are
    named and left out. Says how to ask for the fastest one in each precision. Of sgbm or an ONNX
    file, its own time; with --levels that of each --quality; with --rig also that of rectifying a
    pair of its cameras.
    """
    if size is not None and min(size) < 1:
        raise InputError("size must be a height and a width above 0, got {} {}".format(*size))
    if levels and (options.model or options.weights or options.settings):
        raise InputError("--levels times fast, balanced and best: leave out the network")
    rectifier, told = files.read(), ""
    if rectifier is not None:
        size, told = _rectification(rectifier, size, repeats)
    size = size or _SIZE
    if levels:
        _time_levels(size, threads, device, repeats)
        print(told, end="")
        return

    import sys

    from rich.console import Console
    from rich.table import Table

    from mobilestereonet.data.motorcycle import motorcycle_views
    from mobilestereonet.engines.benchmark import benchmark_engines, benchmark_network, fastest
    from mobilestereonet.engines.choose import installed_engines, open_standalone
    from mobilestereonet.engines.devices import AUTO, torch_device
    from mobilestereonet.export.metadata import check_size
    from mobilestereonet.nets.model import fitting_side

    standalone = options.model and open_standalone(
        options.model, threads=threads, device=device, options=options.config
    )
    if standalone:
        name = options.model
        times = benchmark_engines([standalone], *motorcycle_views(size), repeats=repeats)
    else:
        name, net = options.open_network()
        if rectifier is not None:
            size = fitting_side(net, size[0]), fitting_side(net, size[1])
        check_size(net, size, net.size_multiple)
        device = str(torch_device(device)) if device == AUTO else device
        times = benchmark_network(
            net,
            *motorcycle_views(size),
            installed_engines(device),
            device=device,
            threads=threads,
            repeats=repeats,
            opening=lambda *engine: print("making ready:", *engine, file=sys.stderr),
            refused=lambda *engine_and_why: print("left out:", *engine_and_why, file=sys.stderr),
        )
    table = Table("engine", "precision", title=f"{name}, {size[0]}x{size[1]}, {device}")
    for column in ("ms", "times faster", "mean difference, px"):
        table.add_column(column, justify="right")
    for row in times:
        table.add_row(
            row.engine,
            row.precision,
            f"{row.seconds * 1000:.0f}",
            f"{row.ratio:.2f}",
            f"{row.difference:.5f}",
        )
    Console().print(table)
    if not standalone:
        for precision, row in fastest(times).items():
            print(f"fastest in {precision}: --runtime {row.engine} --precision {precision}")
    print(told, end="")


def _rectification(
    rectifier: Rectifier, size: tuple[int, int] | None, repeats: int
) -> tuple[tuple[int, int], str]:
    """Height and width of rectified views, and how long rectifying a pair takes, in words."""
    from functools import partial

    from mobilestereonet.data.images import to_picture
    from mobilestereonet.data.motorcycle import motorcycle_views
    from mobilestereonet.timing import time_interleaved

    rig = rectifier.rig
    if size is None:
        known = {geometry.size for geometry in rig.geometries if geometry.size}
        if len(known) != 1:
            raise InputError(f"{rig.name}: tells no one size of its pictures: give --size")
        size = known.pop()[::-1]
    run = partial(rectifier, *(to_picture(view[0]) for view in motorcycle_views(size)))
    height, width = run()[0].shape[:2]  # the first one also makes the maps
    if not rectifier.rectifies:
        return (height, width), f"{rig.name}: of rectified pictures, which takes no time\n"
    (seconds,) = time_interleaved(run, repeats=repeats)
    pictures = f"a pair of {size[1]}x{size[0]} to {width}x{height}"
    return (height, width), f"rectifying {pictures}: {seconds * 1000:.1f} ms\n"


def _time_levels(size: tuple[int, int], threads: int | None, device: str, repeats: int) -> None:
    """Print the time of each quality level, refinement included."""
    from functools import partial

    from rich.console import Console
    from rich.table import Table

    from mobilestereonet.data.motorcycle import motorcycle_views
    from mobilestereonet.inference import QUALITIES, StereoMatcher
    from mobilestereonet.timing import time_interleaved

    left, right = motorcycle_views(size)
    matchers = [
        StereoMatcher.from_pretrained(
            quality=name, precision="auto", device=device, threads=threads
        )
        for name in QUALITIES
    ]
    runs = [partial(matcher.infer, left, right) for matcher in matchers]
    for run in runs:
        run()  # the first one also prepares
    columns = ("--quality", "network", "size", "precision")
    table = Table(*columns, title=f"{size[0]}x{size[1]}, {device}")
    for column in ("ms", "pairs per second"):
        table.add_column(column, justify="right")
    times = time_interleaved(*runs, repeats=repeats)
    for level, matcher, seconds in zip(QUALITIES.values(), matchers, times, strict=True):
        settings = (matcher.model, f"{level.scale:g}", matcher.engine.precision)
        figures = (f"{seconds * 1000:.0f}", f"{1 / seconds:.2f}")
        table.add_row(matcher.quality, *settings, *figures)
    Console().print(table)
