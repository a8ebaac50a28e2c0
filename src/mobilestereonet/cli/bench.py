"""``msnet bench``."""

from __future__ import annotations

from typing import Annotated

import typer

from mobilestereonet.cli.engine import Device, Model, Threads, Weights


def bench(
    model: Model = None,
    weights: Weights = None,
    size: Annotated[tuple[int, int], typer.Option(help="Height and width, multiples of 16.")] = (
        256,
        512,
    ),
    threads: Threads = None,
    device: Device = "auto",
    repeats: Annotated[int, typer.Option(min=1, help="Timed runs of each engine.")] = 5,
) -> None:
    """Time every installed engine on this machine, against PyTorch unaccelerated in fp32.

    On this CPU ``--runtime auto`` takes the fastest one of each precision from then on, for this
    network.
    """
    import sys

    from rich.console import Console
    from rich.table import Table

    from mobilestereonet.data.motorcycle import motorcycle_views
    from mobilestereonet.engines.choose import check_device, choose_engine, remember_fastest
    from mobilestereonet.engines.compare import compare_engines, fastest, installed_engines
    from mobilestereonet.export.metadata import check_size
    from mobilestereonet.inference.matcher import pretrained_net
    from mobilestereonet.nets.model import IMAGENET

    name, net = pretrained_net(model, weights)
    device = check_device("auto", device)
    check_size(net, size)
    left, right = map(IMAGENET, motorcycle_views(size))
    engines = installed_engines(device)
    times = compare_engines(
        net,
        left,
        right,
        engines,
        device=device,
        threads=threads,
        repeats=repeats,
        opening=lambda *engine: print("making ready:", *engine, file=sys.stderr),
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
    taken, kept = "torch", ""
    if device == "cpu":
        file = remember_fastest(net.config, fastest(times))
        kept = (
            "it could not be kept: the user's cache folder cannot be written to"
            if file is None
            else f"kept in {file}, with those of other networks: delete it and auto is torch again"
        )
        precisions = dict.fromkeys(row.precision for row in times)
        taken = ", ".join(
            f"{choose_engine('auto', net.config, precision, device)[0]} in {precision}"
            for precision in precisions
        )
    print(f"--runtime auto on {device}: {taken}")
    if kept:
        print(kept)
