"""The interlacing cost volume: what its three convolutions see."""

from __future__ import annotations

from pathlib import Path

from boxes import FEATURES, INK, QUIET, VOLUME, arrow, box, canvas, label, line, save
from matplotlib.patches import Rectangle

from mobilestereonet.nets.cost_volumes import REDUCED_CHANNELS, LearnedVolume

_CELL = 13.5
_LEFT, _RIGHT = FEATURES, VOLUME


def draw_interlacing(path: Path) -> None:
    """One disparity of `LearnedVolume`: the depths of its three convolutions.

    Args:
        path: Picture to write.
    """
    convolutions = list(LearnedVolume("interlaced-4").conv)
    depths = [2 * REDUCED_CHANNELS]
    for conv in convolutions:
        depths.append(depths[-1] // conv.stride[0])
    axes = canvas(1015, 470)
    label(axes, 20, 22, "Interlaced_4 at disparity i (one of 48)", bold=True, align="left")
    note = "left columns from i on, right columns without their last i, channel by channel in turn"
    label(axes, 20, 44, note, quiet=True, align="left")

    def columns(depth: int, span: float) -> list[float]:
        return [60 + span * (index + 0.5) for index in range(depth)]

    tops = (75, 180, 285, 380)
    widths = [_CELL * depths[0] / depth for depth in depths]
    for level, (depth, top, width) in enumerate(zip(depths, tops, widths, strict=True)):
        for index in range(depth):
            colour = (_LEFT, _RIGHT)[index % 2] if level == 0 else "#d6efd8"
            x, cell = 60 + width * index, min(width - 1.5, 60)
            x += (width - 1.5 - cell) / 2
            axes.add_patch(Rectangle((x, top), cell, 30, fc=colour, ec=INK, lw=0.6))
    for index in (0, 1, 2, 3):
        name = f"{'LR'[index % 2]}{index // 2}"
        axes.text(60 + _CELL * (index + 0.45), tops[0] + 15, name, ha="center", va="center", size=6)
    channels = [1, *(conv.out_channels for conv in convolutions)]
    for depth, top, count in zip(depths, tops, channels, strict=True):
        label(axes, 932, top + 8, f"depth {depth}", align="left")
        plural = "channel" if count == 1 else "channels"
        label(axes, 932, top + 23, f"{count} {plural}", quiet=True, align="left")
    for level, conv in enumerate(convolutions):
        reach, width = conv.kernel_size[0], widths[level]
        next_centres = columns(depths[level + 1], widths[level + 1])
        for index, centre in enumerate(next_centres):
            start = 60 + width * reach * index + 1
            end = 60 + width * reach * (index + 1) - 3
            bottom = tops[level] + 34
            line(axes, (start, bottom), (start, bottom + 6), (end, bottom + 6), (end, bottom))
            arrow(axes, (centre, bottom + 6), (centre, tops[level + 1] - 2))
        size = " x ".join(map(str, conv.kernel_size))
        stride = " x ".join(map(str, conv.stride))
        text = f"{conv.in_channels} to {conv.out_channels}, kernel {size}, stride {stride}"
        place = (500, tops[level] + 62)
        axes.text(
            *place,
            text,
            ha="center",
            va="center",
            size=8,
            color=QUIET,
            bbox={"fc": "white", "ec": "none", "pad": 2},
        )
    middle = 60 + _CELL * 32
    box(axes, middle - 90, 425, 180, 36, VOLUME, "plane i, H/4 x W/4", "after a 1 x 1 convolution")
    arrow(axes, (middle, 412), (middle, 425))
    save(axes.figure, path)
