"""AutoDispNet-C (Saikia et al., "AutoDispNet: Improving Disparity Estimation With AutoML", 2019).

DispNet-C with cells that a search found in place of its convolutions: separable and dilated
convolutions and skips between a few nodes, the same in every cell of a kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import InputError
from mobilestereonet.nets.dispnet import CORRELATION, REACH, DispNetC
from mobilestereonet.nets.operations import Correlation1D
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.regression import (
    RegressionModel,
    RegressionOutputs,
    conv,
    enlarged,
    initialise,
    leaky,
    positive,
    predictor,
    transposed,
)

Nodes = tuple[tuple[tuple[str, int], ...], ...]
"""A cell's nodes after its inputs, each the sum of operations on earlier ones: name and place."""

NORMAL: Nodes = (
    (("skip", 0), ("sep5", 1)),
    (("sep3", 2), ("skip", 0)),
    (("dil3", 2), ("dil3", 0)),
)
"""A cell that keeps the size. Inputs: 0 from before the last cell, 1 from the last cell."""

REDUCTION: Nodes = (
    (("sep5", 1), ("sep3", 0)),
    (("sep5", 2), ("skip", 0)),
    (("skip", 1), ("sep5", 3)),
)
"""A cell that halves the size: operations on its inputs have stride 2."""

ENLARGEMENT: Nodes = (
    (("sep3", 3), ("dil3", 2), ("sep3", 1), ("skip", 0)),
    (("sep3", 3), ("sep3", 4)),
    (("sep3", 2), ("dil5", 4)),
)
"""A cell of the decoder. Inputs: 0 and 1 as above, 2 the prediction, 3 the encoder's features."""


@dataclass(frozen=True, kw_only=True)
class AutoDispNetConfig:
    """AutoDispNet-C as data.

    Attributes:
        max_disparity: Disparities below this are trained on; the network can give any.
        width: Channels C of a node in the last cell of the decoder; all cells are in proportion.
            18 in the authors' "css".
        stem: Channels of the first convolution; the second has twice as many. 36 in "css".
    """

    max_disparity: int = 192
    width: int = 42
    stem: int = 64

    def __post_init__(self) -> None:
        for name in ("width", "stem"):
            if (value := getattr(self, name)) < 1:
                raise InputError(f"{name} must be positive, got {value}")


class StridedConv2d(nn.Conv2d):
    """Convolution of stride 2 with TensorFlow's padding: the odd pixel is right and below."""

    def __init__(self, inputs: int, outputs: int, kernel: int, **options: int) -> None:
        super().__init__(inputs, outputs, kernel, 2, **options)  # type: ignore[arg-type]
        before = (kernel - 2) // 2
        self.around = 2 * (before, kernel - 2 - before)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W), H and W even -> (B, C', H / 2, W / 2)."""
        return super().forward(F.pad(x, self.around))


def halve(inputs: int, outputs: int, kernel: int = 3) -> nn.Sequential:
    """Convolution of stride 2 and a leaky ReLU."""
    return nn.Sequential(StridedConv2d(inputs, outputs, kernel), leaky())


class Separable(nn.Module):
    """Depthwise convolution without bias, pointwise convolution, leaky ReLU."""

    def __init__(self, channels: int, kernel: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        padding = dilation * (kernel // 2)
        self.depthwise = (
            StridedConv2d(channels, channels, kernel, groups=channels, bias=False)
            if stride == 2
            else nn.Conv2d(
                channels,
                channels,
                kernel,
                padding=padding,
                dilation=dilation,
                groups=channels,
                bias=False,
            )
        )
        self.pointwise = nn.Conv2d(channels, channels, 1)
        self.activation = leaky()

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C, H / stride, W / stride)."""
        return cast(Tensor, self.activation(self.pointwise(self.depthwise(x))))


def operation(name: str, channels: int, stride: int) -> nn.Module:
    """An operation of a cell: "skip", or "sep" or "dil" and the kernel size, such as "sep5"."""
    if name == "skip":
        return halve(channels, channels) if stride == 2 else nn.Identity()
    kernel = int(name[3:])
    if name.startswith("dil"):
        return Separable(channels, kernel, dilation=2)
    return nn.Sequential(Separable(channels, kernel, stride), Separable(channels, kernel))


class Cell(nn.Module):
    """A graph of operations.

    Args:
        nodes: The graph.
        channels: Channels C of its inputs and nodes.
        inputs: Number of inputs.
        stride: 2 halves the size: stride of the operations on the inputs.
    """

    def __init__(self, nodes: Nodes, channels: int, inputs: int, stride: int = 1) -> None:
        super().__init__()
        self.nodes, self.inputs = nodes, inputs
        self.operations = nn.ModuleList(
            operation(name, channels, stride if source < inputs else 1)
            for node in nodes
            for name, source in node
        )

    def forward(self, *inputs: Tensor) -> Tensor:
        """Inputs (B, C, H, W) each -> all nodes, (B, 3 C, H / stride, W / stride)."""
        states, operations = list(inputs), iter(self.operations)
        for node in self.nodes:
            terms = [next(operations)(states[source]) for _, source in node]
            states.append(torch.stack(terms).sum(dim=0))
        return torch.cat(states[self.inputs :], dim=1)


class EncoderCell(nn.Module):
    """A normal or reduction cell on the outputs of the two cells before it.

    Args:
        before: Channels of the output before the last.
        last: Channels of the last output.
        channels: Channels C of a node; the cell gives 3 C.
        reduces: Halve the size.
        after_reduction: The last cell did: the output before it has twice the size.
    """

    def __init__(
        self, before: int, last: int, channels: int, *, reduces: bool, after_reduction: bool
    ) -> None:
        super().__init__()
        self.before = (halve if after_reduction else conv)(
            before, channels, 3 if after_reduction else 1
        )
        self.last = conv(last, channels, 1)
        nodes, stride = (REDUCTION, 2) if reduces else (NORMAL, 1)
        self.cell = Cell(nodes, channels, 2, stride)

    def forward(self, before: Tensor, last: Tensor) -> Tensor:
        """The outputs of the two cells before this one -> its own."""
        return cast(Tensor, self.cell(self.before(before), self.last(last)))


class DecoderCell(nn.Module):
    """A cell that doubles the size, told the prediction and the encoder's features of that size.

    Args:
        before: Channels of the output before the last.
        last: Channels of the last output.
        skip: Channels of the encoder's features.
        channels: Channels C of a node; the cell gives 3 C.
        first: There is no cell before the last: both outputs have one size.
    """

    def __init__(self, before: int, last: int, skip: int, channels: int, *, first: bool) -> None:
        super().__init__()
        self.before = conv(before, channels, 1) if first else transposed(before, channels)
        self.last = conv(last, channels, 1)
        self.prediction = conv(1, channels, 1)
        self.skip = conv(skip, channels, 1)
        self.up = nn.ModuleList(transposed(channels, channels) for _ in range(2))
        self.cell = Cell(ENLARGEMENT, channels, 4)

    def forward(self, before: Tensor, last: Tensor, prediction: Tensor, skip: Tensor) -> Tensor:
        """The outputs of the two cells before this one, the prediction and the features."""
        states = self.up[0](self.before(before)), self.up[1](self.last(last))
        return cast(Tensor, self.cell(*states, self.prediction(prediction), self.skip(skip)))


@register_model(
    "autodispnet-c",
    paper="Saikia et al., AutoDispNet: Improving Disparity Estimation With AutoML, ICCV 2019",
    licence="Apache-2.0 (its operations: GPL v3)",
    checkpoints="none that can be read here; lmb-freiburg/autodispnet on GitHub has it as the "
    "first network of its stacks CSS and css (TensorFlow snapshots)",
    trained_on="FlyingThings3D; that and KITTI",
)
class AutoDispNetC(RegressionModel):
    """Correlation at an eighth of the resolution, in an encoder-decoder of cells."""

    config: AutoDispNetConfig
    preprocessing = DispNetC.preprocessing
    # As DispNet-C, from which it is made; training code is not public.
    head_weights = DispNetC.head_weights

    def __init__(self, config: AutoDispNetConfig) -> None:
        super().__init__(config)
        c, stem = config.width, config.stem
        self.stems = nn.Sequential(halve(3, stem, 7), halve(stem, 2 * stem, 5))
        self.feature_cell = EncoderCell(
            2 * stem, 2 * stem, 2 * c, reduces=True, after_reduction=False
        )
        self.correlate = Correlation1D(REACH)
        sizes = [12 * c, CORRELATION]  # channels: both views' features, correlation, each cell
        self.encoder_cells = nn.ModuleList()
        for i, channels in enumerate((2 * c, 4 * c, 4 * c, 8 * c, 8 * c, 16 * c)):
            reduces = i % 2 == 1
            before, last = sizes[-2:]
            self.encoder_cells.append(
                EncoderCell(
                    before, last, channels, reduces=reduces, after_reduction=i > 0 and not reduces
                )
            )
            sizes.append(3 * channels)
        sizes = [sizes[-1], sizes[-1]]
        self.decoder_cells = nn.ModuleList()
        for channels, skip in ((8 * c, 24 * c), (4 * c, 12 * c), (2 * c, 6 * c), (c, 2 * stem)):
            before, last = sizes[-2:]
            first = len(sizes) == 2
            self.decoder_cells.append(DecoderCell(before, last, skip, channels, first=first))
            sizes.append(3 * channels)
        self.predictors = nn.ModuleList(predictor(size) for size in sizes[1:])
        initialise(self)
        # Sums of operations grow without norms, and min(0, .) lets no gradient through above 0.
        for predict in cast(list[nn.Conv2d], list(self.predictors)):
            assert predict.bias is not None
            nn.init.normal_(predict.weight, std=1e-3)
            nn.init.constant_(predict.bias, -1.0)

    def outputs(self, left: Tensor, right: Tensor) -> RegressionOutputs:
        """Predictions at 1/64 to 1/4 of the resolution, see `RegressionModel`."""
        self.check_views(left, right)
        left_stem, right_stem = self.stems(left), self.stems(right)
        left_features = self.feature_cell(left_stem, left_stem)
        right_features = self.feature_cell(right_stem, right_stem)
        correlation = F.relu(self.correlate(left_features, right_features))
        states = [torch.cat((left_features, right_features), dim=1), correlation]
        for cell in self.encoder_cells:
            states.append(cell(*states[-2:]))
        skips = (states[-3], states[-5], left_features, left_stem)  # each the first of its size
        states = [states[-1], states[-1]]
        predictions = [self.predictors[0](states[-1])]
        for cell, skip, predict in zip(self.decoder_cells, skips, self.predictors[1:], strict=True):
            # Without a gradient, as in the release.
            told = enlarged(predictions[-1].detach().clamp_max(0), 2)
            states.append(cell(*states[-2:], told, skip))
            predictions.append(predict(states[-1]))
        disparity = enlarged((-predictions[-1]).clamp_min(0), 4)[:, 0]
        return RegressionOutputs(positive(predictions), disparity)
