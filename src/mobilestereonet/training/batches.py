"""What each step of a run takes, and the pairs that have to be read or rendered for it.

Position i of a run always gives the same pair, augmented in the same way, whatever the batch size,
the number of ranks and of workers, and whether the run was interrupted: that is what makes a
resumed run exact.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch.utils.data import Dataset, Sampler

from mobilestereonet.data.sample import StereoSample
from mobilestereonet.scenes import ProceduralScenes
from mobilestereonet.training.pool import Delivery, pack

_ORDER = 1 << 33
"""Stream of the random generator beside the scenes' own, as a bit of the key's first word."""


@dataclass(frozen=True)
class Uses:
    """Which pair each position takes: every pair several times, spread over the run.

    Of ``times`` positions in a row the first takes a new pair, the others pairs that were new
    ``pool / times``, ``2 pool / times`` ... pairs ago: one new pair for every ``times`` positions,
    evenly. While the pool is not full yet, its first pairs are taken more often.

    Attributes:
        times: How often each pair is taken.
        pool: Number of pairs in use at a time.
    """

    times: int = 1
    pool: int = 1

    def pair(self, position: int) -> int:
        """Number of the pair that a position takes."""
        newest, use = divmod(position, self.times)
        return newest - use * min(self.pool, newest + 1) // self.times

    def oldest(self, position: int) -> int:
        """Number of the oldest pair that this position or a later one takes."""
        return self.pair(position // self.times * self.times + self.times - 1)


class Request(NamedTuple):
    """What one rank takes in one step."""

    positions: list[int]
    pairs: list[int]
    """Number of each position's pair."""

    missing: list[int]
    """Those that have to be read or rendered, as no earlier step since the start took them."""

    oldest: int
    """Pairs before this one are not taken any more."""


class StepRequests(Sampler[Request]):
    """One rank's requests, step by step, from the current step to the run's end.

    Args:
        step: Gives the step at which to begin; asked when iteration starts, so that a resumed
            run goes on where it stopped.
        steps: Length of the run; None where it is not known.
        batch_size: Pairs per rank and step.
        uses: Which pair a position takes.
        rank: This process.
        ranks: Number of processes.
    """

    def __init__(
        self,
        step: Callable[[], int],
        steps: int | None,
        batch_size: int,
        uses: Uses,
        rank: int = 0,
        ranks: int = 1,
    ) -> None:
        self.step = step
        self.steps = steps
        self.batch_size = batch_size
        self.uses = uses
        self.rank = rank
        self.ranks = ranks

    def __iter__(self) -> Iterator[Request]:
        held: set[int] = set()
        for step in itertools.count(self.step()):
            if self.steps is not None and step >= self.steps:
                return
            first = (step * self.ranks + self.rank) * self.batch_size
            positions = list(range(first, first + self.batch_size))
            pairs = [self.uses.pair(position) for position in positions]
            oldest = self.uses.oldest(first)
            missing = sorted(set(pairs) - held)
            held = {pair for pair in held.union(missing) if pair >= oldest}
            yield Request(positions, pairs, missing, oldest)

    def __len__(self) -> int:
        """Steps of the whole run: Lightning counts those before a resumption as done."""
        if self.steps is None:
            raise TypeError("the length of this run is not known")
        return self.steps


class TrainingPairs(Dataset[Delivery]):
    """Pairs that a step lacks, for a `DataLoader` without batches of its own.

    Args:
        source: Procedural scenes, or any indexable data set of samples.
        seed: Seed of the order in which a data set is gone through.
    """

    def __init__(self, source: Dataset[StereoSample], seed: int) -> None:
        self.source = source
        self.seed = seed

    def __getitem__(self, request: Request) -> Delivery:
        """Read or render what is missing."""
        loaded = {number: pack(self._read(number)) for number in request.missing}
        return Delivery(request.positions, request.pairs, loaded, request.oldest)

    def _read(self, number: int) -> StereoSample:
        if isinstance(self.source, ProceduralScenes):
            # One by one: rendered together, scenes may differ in their last bits.
            return self.source.batch([number]).map(itemgetter(0))
        return self.source[self._index(number)]

    def _index(self, number: int) -> int:
        """Every pass over the data set has an order of its own."""
        length = len(self.source)  # type: ignore[arg-type]
        epoch, place = divmod(number, length)
        return int(_order(self.seed, epoch, length)[place])


@lru_cache(maxsize=2)  # a batch may reach from one pass into the next
def _order(seed: int, epoch: int, length: int) -> NDArray[np.int64]:
    """Order of a data set's samples in one pass over it."""
    generator = np.random.Generator(np.random.Philox(key=[seed | _ORDER, epoch]))
    return generator.permutation(length)
