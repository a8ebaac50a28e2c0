"""Training batches as a function of the position in the run.

Position i always gives the same pair, augmented in the same way, whatever the batch size, the
number of ranks and whether the run was interrupted: that is what makes a resumed run exact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch.utils.data import Dataset, Sampler

from mobilestereonet.data.augment import AugmentConfig, augment, geometry_only
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.scenes import ProceduralScenes

_AUGMENT, _ORDER = 1 << 32, 1 << 33
"""Streams of the random generator beside the scenes' own, as bits of the key's first word."""


class TrainingBatch(NamedTuple):
    """Pairs to train on."""

    augmented: StereoSample
    clean: StereoSample | None = None
    """Views of the same pairs with only their geometry augmented: for a teacher."""


class TrainingPairs(Dataset[TrainingBatch]):
    """Augmented pairs by position, for a DataLoader that asks for whole batches.

    Args:
        source: Procedural scenes, or any indexable data set of samples.
        config: The augmentation.
        seed: Seed of the order and of the augmentation.
        clean: Give clean views as well, see `TrainingBatch`.
    """

    def __init__(
        self,
        source: Dataset[StereoSample],
        config: AugmentConfig,
        seed: int,
        *,
        clean: bool = False,
    ) -> None:
        self.source = source
        self.config = config
        self.seed = seed
        self.clean = clean

    def __getitems__(self, positions: Sequence[int]) -> TrainingBatch:
        """Batch of the pairs at ``positions``."""
        if isinstance(self.source, ProceduralScenes):
            pairs = [self.source.batch(positions)]
            groups = [positions]
        else:
            # One by one: pairs get one size by the crop only.
            pairs = [collate([self.source[self._index(position)]]) for position in positions]
            groups = [[position] for position in positions]
        batch = self._augment(pairs, groups, self.config)
        if not self.clean:
            return TrainingBatch(batch)
        views = [StereoSample(pair.left, pair.right, name=pair.name) for pair in pairs]
        return TrainingBatch(batch, self._augment(views, groups, geometry_only(self.config)))

    def _augment(
        self,
        batches: Sequence[StereoSample],
        groups: Sequence[Sequence[int]],
        config: AugmentConfig,
    ) -> StereoSample:
        """Augment batches of the pairs at groups of positions, and join them."""
        augmented = []
        for batch, positions in zip(batches, groups, strict=True):
            keys = [[self.seed | _AUGMENT, position] for position in positions]
            generators = [np.random.Generator(np.random.Philox(key=key)) for key in keys]
            augmented.append(augment(batch, config, generators))
        if len(augmented) == 1:
            return augmented[0]
        return collate([batch.map(itemgetter(0)) for batch in augmented])

    def _index(self, position: int) -> int:
        """Every pass over the data set has an order of its own."""
        length = len(self.source)  # type: ignore[arg-type]
        epoch, place = divmod(position, length)
        return int(_order(self.seed, epoch, length)[place])


@lru_cache(maxsize=2)  # a batch may reach from one pass into the next
def _order(seed: int, epoch: int, length: int) -> NDArray[np.int64]:
    """Order of a data set's samples in one pass over it."""
    generator = np.random.Generator(np.random.Philox(key=[seed | _ORDER, epoch]))
    return generator.permutation(length)


class PositionBatches(Sampler[list[int]]):
    """One rank's positions, batch by batch, from the current step to the run's end.

    Args:
        step: Gives the step at which to begin; asked when iteration starts, so that a resumed
            run goes on where it stopped.
        steps: Length of the run.
        batch_size: Pairs per rank and step.
        rank: This process.
        ranks: Number of processes.
    """

    def __init__(
        self, step: Callable[[], int], steps: int, batch_size: int, rank: int = 0, ranks: int = 1
    ) -> None:
        self.step = step
        self.steps = steps
        self.batch_size = batch_size
        self.rank = rank
        self.ranks = ranks

    def __iter__(self) -> Iterator[list[int]]:
        for step in range(self.step(), self.steps):
            first = (step * self.ranks + self.rank) * self.batch_size
            yield list(range(first, first + self.batch_size))

    def __len__(self) -> int:
        """Steps of the whole run: Lightning counts those before a resumption as done."""
        return self.steps
