"""Released checkpoints of the networks' authors, with their tensors' names translated to ours."""

from __future__ import annotations

import re
from typing import NamedTuple

from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.weights.files import COUNTER, WeightsFile
from mobilestereonet.weights.released_names import MARKS, released_name
from mobilestereonet.weights.shapes import registered_shapes

_UNUSED = re.compile(r"cost_agg\.deconv0b\.")
"""A block in released GA-Net-deep checkpoints that its network never calls."""


class _Reading(NamedTuple):
    """A checkpoint, taken for that of one network."""

    network: str
    state: dict[str, Tensor]  # by released names, without prefixes
    expected: dict[str, str]  # our names by released ones

    @property
    def missing(self) -> set[str]:
        return self.expected.keys() - self.state.keys()

    @property
    def unknown(self) -> set[str]:
        return self.state.keys() - self.expected.keys()

    @property
    def misfits(self) -> int:
        return len(self.missing) + len(self.unknown)


def from_authors(weights: WeightsFile) -> WeightsFile:
    """Translate a released checkpoint; any other is given back as it is.

    Released are state dicts, alone or beside other things, with or without a prefix such as
    ``module.``. Their names tell the network, not all of its config: give ``align_corners`` to
    those of `psmnet` that need it.

    Raises:
        InputError: If most names are those of a release, but not all, or there are more.
    """
    found = [name for name, mark in MARKS.items() if any(mark in key for key in weights.state)]
    if weights.model is not None or not found:
        return weights
    best = min((_read(weights.state, name) for name in found), key=lambda r: r.misfits)
    if len(best.missing) > len(best.expected) / 2:  # others' names begin alike
        return weights
    if best.misfits:
        example = min(best.missing or best.unknown)
        raise InputError(
            f"{weights.source}: not the authors' {best.network.removesuffix('-authors')}: "
            f"{len(best.missing)} keys missing, {len(best.unknown)} unknown, such as {example!r}"
        )
    translated = {own: best.state[released] for released, own in best.expected.items()}
    return WeightsFile(weights.source, translated, best.network)


def _read(state: dict[str, Tensor], network: str) -> _Reading:
    mark = MARKS[network]
    prefix = next(key.partition(mark)[0] for key in state if mark in key)
    names = {key.removeprefix(prefix): value for key, value in state.items()}
    kept = {
        key: value
        for key, value in names.items()
        if not key.endswith(COUNTER) and not _UNUSED.match(key)
    }
    expected = {released_name(network, key): key for key in registered_shapes(network)}
    return _Reading(network, kept, expected)
