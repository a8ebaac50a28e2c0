"""What v1 and v2 blocks save over a standard convolution, by formula (the paper's Sec. 3.1)."""

from __future__ import annotations

from pathlib import Path

from mobilestereonet.atomic import write_atomically
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.nets.blocks import Block

EXPANSIONS = range(1, 9)
"""Expansion factors t of the paper's figure."""

EXPANSION_CHANNELS = (32, 64, 128)
"""Channels C_in = C_out of the paper's figure."""


def block_macs(
    kind: Block, dims: int, inputs: int, outputs: int, *, kernel: int = 3, expansion: int = 2
) -> int:
    """MACs of a block per element of its output's H x W (D x H x W in 3D): the paper's Table 1.

    Batch norm, activations and the skip are not counted, nor is there a stride.

    Args:
        kind: "conv", "v1" or "v2".
        dims: 2 or 3.
        inputs: Channels in.
        outputs: Channels out.
        kernel: Kernel size k of the convolution, or of the depthwise one.
        expansion: Expansion factor t of v2.
    """
    volume: int = kernel**dims
    if kind == "conv":
        return volume * inputs * outputs
    if kind == "v1":
        return volume * inputs + inputs * outputs
    hidden = expansion * inputs
    return inputs * hidden + volume * hidden + hidden * outputs


def reduction_factor(
    kind: Block, dims: int, inputs: int, outputs: int, *, kernel: int = 3, expansion: int = 2
) -> float:
    """How many times fewer MACs a block takes than the standard convolution (`block_macs`)."""
    block = block_macs(kind, dims, inputs, outputs, kernel=kernel, expansion=expansion)
    return block_macs("conv", dims, inputs, outputs, kernel=kernel) / block


def expansion_curve(dims: int, channels: int) -> list[float]:
    """Reduction factor of v2 blocks with C_in = C_out = ``channels``, k = 3, for `EXPANSIONS`."""
    return [reduction_factor("v2", dims, channels, channels, expansion=t) for t in EXPANSIONS]


def plot_expansion(path: str | Path) -> None:
    """Draw the paper's figure of the expansion factor: `expansion_curve` in 2D and 3D.

    Args:
        path: Picture to write; its ending names the format, such as ``.png``.

    Raises:
        InputError: If no such format is known.
        OSError: If the file cannot be written.
    """
    with needs_extra("plots"):
        from matplotlib.figure import Figure

    path = Path(path)
    figure = Figure(figsize=(6, 4), layout="constrained")
    formats = figure.canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in formats:
        raise InputError(f"{path}: a picture ends in one of {', '.join(sorted(formats))}")
    axes = figure.subplots()
    for dims, style in ((2, "o--"), (3, "s-")):
        for index, channels in enumerate(EXPANSION_CHANNELS):
            curve = expansion_curve(dims, channels)
            axes.plot(EXPANSIONS, curve, style, color=f"C{index}", label=f"{dims}D, C = {channels}")
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set(xlabel="expansion factor t", ylabel="reduction factor of the v2 block")
    axes.grid(alpha=0.3)
    axes.legend()
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=150))
