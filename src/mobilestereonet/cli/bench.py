"""``msnet bench``."""

from __future__ import annotations

from typing import Annotated

import typer

from mobilestereonet.cli.engine import Device, NetworkOptions, Threads
from mobilestereonet.errors import InputError


def bench(
    *,
    options: NetworkOptions,
    size: Annotated[
        tuple[int, int], typer.Option(help="Height and width, multiples of the network's.")
    ] = (256, 512),
    threads: Threads = None,
    device: Device = "auto",
    repeats: Annotated[int, typer.Option(min=1, help="Timed runs of each engine.")] = 5,
    levels: Annotated[
        bool, typer.Option("--levels", help="Time the quality levels instead, as predict has them.")
    ] = False,
) -> None:
    """Time every installed engine on this machine.

    Times are compared with PyTorch unaccelerated in fp32. Engines that cannot run the network are
    named and left out. Says how to ask for the fastest one in each precision. Of sgbm or an ONNX
    file, its own time; with --levels that of each --quality.
    """
    if min(size) < 1:
        raise InputError("size must be a height and a width above 0, got {} {}".format(*size))

    if levels:
        if options.model or options.weights or options.settings:
            raise InputError("--levels times fast, balanced and best: leave out the network")
        _time_levels(size, threads, device, repeats)
        return

    import sys

    from rich.console import Console
    from rich.table import Table

    from mobilestereonet.data.motorcycle import motorcycle_views
    from mobilestereonet.engines.benchmark import benchmark_engines, benchmark_network, fastest
    from mobilestereonet.engines.choose import installed_engines, open_standalone
    from mobilestereonet.engines.devices import AUTO, torch_device
    from mobilestereonet.export.metadata import check_size

    standalone = options.model and open_standalone(
        options.model, threads=threads, device=device, options=options.config
    )
    if standalone:
        name = options.model
        times = benchmark_engines([standalone], *motorcycle_views(size), repeats=repeats)
    else:
        name, net = options.open_network()
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
    table = Table("--quality", "network", "precision", title=f"{size[0]}x{size[1]}, {device}")
    for column in ("ms", "pairs per second"):
        table.add_column(column, justify="right")
    for matcher, seconds in zip(matchers, time_interleaved(*runs, repeats=repeats), strict=True):
        times = (f"{seconds * 1000:.0f}", f"{1 / seconds:.2f}")
        table.add_row(matcher.quality, matcher.model, matcher.engine.precision, *times)
    Console().print(table)
