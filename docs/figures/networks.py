"""A network from views to disparity, with shapes and costs, drawn from its config."""

from __future__ import annotations

from pathlib import Path

from boxes import (
    DECODER,
    FEATURES,
    HEAD,
    QUIET,
    VIEW,
    VOLUME,
    arrow,
    box,
    canvas,
    label,
    line,
    save,
)
from matplotlib.axes import Axes

from mobilestereonet.costs import count_costs
from mobilestereonet.nets import model_config
from mobilestereonet.nets.cost_volumes import REDUCED_CHANNELS
from mobilestereonet.nets.msnet_config import FEATURE_CHANNELS, NetConfig

_HEIGHT, _WIDTH = 256, 512
_TITLES = {"msnet2d": "2D-MobileStereoNet", "msnet3d": "3D-MobileStereoNet"}


def draw_network(model: str, path: Path) -> None:
    """The whole network above, one hourglass below.

    Args:
        model: Name of the network.
        path: Picture to write.
    """
    config = model_config(model)
    axes = canvas(1000, 545)
    label(axes, 20, 22, f"{_TITLES[model]} (msnet models: {model})", bold=True, align="left")
    _pipeline(axes, model, config)
    _hourglass(axes, config)
    save(axes.figure, path)


def _pipeline(axes: Axes, model: str, config: NetConfig) -> None:
    costs = count_costs(model, height=_HEIGHT, width=_WIDTH)

    def share(*names: str) -> str:
        macs = sum(costs[name].macs for name in names if name in costs)
        return f"{macs / 1e9:.2f} G" if macs else "no weights"

    reduced = config.channel_reduction
    planes, width = config.planes, config.width
    size = "H/4 x W/4"
    per_view = f"{REDUCED_CHANNELS if reduced else FEATURE_CHANNELS} x {size}"
    volume = f"{planes} x {size}" if config.dims == 2 else f"{config.groups} x {planes} x {size}"
    hidden = f"{width} x {size}" if config.dims == 2 else f"{width} x {planes} x {size}"
    kind = "interlacing" if config.learns_volume else "group-wise correlation"
    blocks = f"v2 blocks {config.dims}D"

    for y, name in ((60, "left view"), (150, "right view")):
        box(axes, 20, y, 80, 54, VIEW, name, "3 x H x W")
        arrow(axes, (100, y + 27), (124, y + 27))
    features = [
        "features",
        f"3 {config.first_conv}, then 4 stages",
        f"of {config.features} blocks",
        f"{FEATURE_CHANNELS} x {size}",
    ]
    if reduced:
        features += ["reduced to", f"{REDUCED_CHANNELS} x {size}"]
    features.append(share("features", "reduction"))
    box(axes, 124, 50, 132, 164, FEATURES, *features, "shared by both views")
    for y in (87, 177):
        arrow(axes, (256, y), (330, y))
        label(axes, 293, y - 9, per_view.split(" x ")[0] + " ch.", quiet=True)
    box(axes, 330, 50, 140, 164, VOLUME, "cost volume", kind, volume, share("volume"))
    arrow(axes, (470, 132), (490, 132))
    box(axes, 490, 82, 126, 100, DECODER, "pre-hourglass", blocks, hidden, share("pre_hourglass"))
    arrow(axes, (616, 132), (632, 132))
    count = config.hourglasses
    for index in reversed(range(count)):
        text = (f"{count} hourglasses", blocks, hidden, share("hourglasses")) if not index else ()
        box(axes, 632 + 8 * index, 82 - 8 * index, 126, 100, DECODER, *text)
    arrow(axes, (632 + 126 + 8 * (count - 1), 132), (800, 132))
    outputs = f"{planes} x {size}"
    box(axes, 800, 82, 80, 100, HEAD, "head", "scores", outputs.split(" x ")[0] + " planes")
    label(axes, 840, 194, share("heads"), quiet=True)
    arrow(axes, (880, 132), (900, 132))
    box(axes, 900, 82, 84, 100, HEAD, "upsample", "soft-argmax", "disparity", "H x W")
    label(
        axes,
        20,
        240,
        f"G: exact multiply-accumulates (1e9) at {_HEIGHT} x {_WIDTH}, both views; "
        f"{costs['total'].macs / 1e9:.2f} G in all. In training every stage has a head of its own.",
        quiet=True,
        align="left",
    )


def _hourglass(axes: Axes, config: NetConfig) -> None:
    """Two steps down, two steps up, and the skips, in three rows of falling resolution."""
    axes.axhline(262, 0.02, 0.98, color=QUIET, lw=0.5)
    label(axes, 20, 282, "One hourglass", bold=True, align="left")
    width, block, dims = config.width, config.hourglass, config.dims
    rows = (330, 410, 490)
    names = ("H/4 x W/4", "H/8 x W/8", "H/16 x W/16")
    if dims == 3:
        names = tuple(f"D/{2**i} x {name}" if i else f"D x {name}" for i, name in enumerate(names))
    for y, name, channels in zip(rows, names, (1, 2, 4), strict=True):
        label(axes, 20, y, f"{channels * width} x {name}", quiet=True, align="left")

    def layer(x: float, y: float, *text: str) -> None:
        box(axes, x, y - 21, 108, 42, DECODER, *text)

    box(axes, 165, rows[0] - 17, 60, 34, VIEW, "input")
    layer(260, rows[1], block, "stride 2")
    layer(390, rows[1], block)
    layer(470, rows[2], block, "stride 2")
    layer(600, rows[2], block)
    layer(520, rows[1], f"{block} (skip)")
    layer(520, rows[0], f"{block} (skip)")
    for x, y in ((720, rows[1]), (860, rows[0])):
        box(axes, x - 13, y - 13, 26, 26, "white", "+")
    label(axes, 720, rows[1] - 24, "ReLU", quiet=True)
    label(axes, 860, rows[0] - 24, "ReLU", quiet=True)
    arrow(axes, (225, rows[0]), (520, rows[0]))
    line(axes, (240, rows[0]), (240, rows[1]))
    arrow(axes, (240, rows[1]), (260, rows[1]))
    arrow(axes, (368, rows[1]), (390, rows[1]))
    arrow(axes, (498, rows[1]), (520, rows[1]))
    line(axes, (508, rows[1]), (508, rows[2] - 40), (455, rows[2] - 40), (455, rows[2]))
    arrow(axes, (455, rows[2]), (470, rows[2]))
    arrow(axes, (578, rows[2]), (600, rows[2]))
    arrow(axes, (628, rows[1]), (707, rows[1]))
    arrow(axes, (628, rows[0]), (847, rows[0]))
    line(axes, (708, rows[2]), (720, rows[2]))
    arrow(axes, (720, rows[2]), (720, rows[1] + 13))
    label(axes, 728, rows[2] - 32, "transposed convolution, x 2", quiet=True, align="left")
    line(axes, (733, rows[1]), (860, rows[1]))
    arrow(axes, (860, rows[1]), (860, rows[0] + 13))
    label(axes, 868, rows[0] + 40, "transposed, x 2", quiet=True, align="left")
    arrow(axes, (873, rows[0]), (925, rows[0]))
    label(axes, 930, rows[0], "output", align="left")
