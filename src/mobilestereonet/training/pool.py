"""Pool of pairs in the training device's memory, from which augmented batches are made there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.data.augment import AugmentConfig, augment, geometry_only
from mobilestereonet.data.sample import StereoSample

_AUGMENT = 1 << 32
"""Stream of the random generator beside the scenes' own, as a bit of the key's first word."""


class TrainingBatch(NamedTuple):
    """Pairs to train on."""

    augmented: StereoSample
    clean: StereoSample | None = None
    """Views of the same pairs with only their geometry augmented: for a teacher."""


class Delivery(NamedTuple):
    """What one step takes, with the pairs that it is the first to take."""

    positions: list[int]
    pairs: list[int]
    """Number of each position's pair."""

    loaded: dict[int, StereoSample]
    """Pairs by number, see `pack`; the others came with earlier steps."""

    oldest: int
    """Pairs before this one are not taken any more."""


def pack(sample: StereoSample) -> StereoSample:
    """What training needs of a pair, its views as 8-bit numbers: a quarter of the memory."""

    def bytes_of(view: Tensor) -> Tensor:
        return (view * 255).round().to(torch.uint8)

    return StereoSample(
        bytes_of(sample.left),
        bytes_of(sample.right),
        sample.disparity,
        sample.valid,
        name=sample.name,
    )


class PairPool:
    """Pairs held for several uses, each use with an augmentation of its own.

    Args:
        config: The augmentation.
        seed: Seed of the augmentation.
        clean: Give clean views as well, see `TrainingBatch`.
    """

    def __init__(self, config: AugmentConfig, seed: int, *, clean: bool = False) -> None:
        self.config = config
        self.seed = seed
        self.clean = clean
        self.held: dict[int, StereoSample] = {}

    def batch(self, delivery: Delivery) -> TrainingBatch:
        """The batch of one step, on the device on which its pairs lie."""
        self.held |= delivery.loaded
        pairs = [self.held[number] for number in delivery.pairs]
        self.held = {n: pair for n, pair in self.held.items() if n >= delivery.oldest}
        batch = self._augment(pairs, delivery.positions, self.config)
        if not self.clean:
            return TrainingBatch(batch)
        views = [StereoSample(pair.left, pair.right, name=pair.name) for pair in pairs]
        clean = self._augment(views, delivery.positions, geometry_only(self.config))
        return TrainingBatch(batch, clean)

    def _augment(
        self, pairs: Sequence[StereoSample], positions: Sequence[int], config: AugmentConfig
    ) -> StereoSample:
        keys = [[self.seed | _AUGMENT, position] for position in positions]
        return augment(pairs, config, [np.random.Generator(np.random.Philox(key=k)) for k in keys])
