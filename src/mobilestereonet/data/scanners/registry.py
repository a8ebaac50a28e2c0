"""Registry of the data sets that can be opened by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import cleandoc, signature
from pathlib import Path
from typing import Any, TypeVar

from mobilestereonet.atomic import note_inputs
from mobilestereonet.data.scanners.base import StereoDataSet
from mobilestereonet.errors import InputError
from mobilestereonet.settings import check_arguments, choice_hint

_Scanner = TypeVar("_Scanner", bound=type[StereoDataSet])
_REGISTRY: dict[str, type[StereoDataSet]] = {}


def register_data_set(name: str) -> Callable[[_Scanner], _Scanner]:
    """Class decorator that makes a data set known by name, on the command line too.

    Args:
        name: What `open_data_set` takes.

    Raises:
        InputError: If another class has the name.
    """

    def register(scanner: _Scanner) -> _Scanner:
        known = _REGISTRY.get(name, scanner)
        # The same class again is the notebook's cell that is run again.
        if (known.__module__, known.__qualname__) != (scanner.__module__, scanner.__qualname__):
            raise InputError(f"data set {name!r} is {known.__name__} already: choose another name")
        _REGISTRY[name] = scanner
        scanner.label = name
        return scanner

    return register


def data_sets() -> dict[str, type[StereoDataSet]]:
    """Every data set that can be opened by name."""
    return dict(_REGISTRY)


@dataclass(frozen=True)
class DataSetInfo:
    """What a data set is, for lists.

    Attributes:
        name: What `open_data_set` takes.
        summary: What it is, in a line.
        splits: Official number of frames of each split, None where there is none; the first split
            is the default.
        withheld: Splits whose ground truth is not public.
        options: Other arguments of `open_data_set`, and their defaults.
    """

    name: str
    summary: str
    splits: Mapping[str, int | None]
    withheld: frozenset[str]
    options: Mapping[str, Any]


def list_data_sets() -> list[DataSetInfo]:
    """What can be opened by name, in the order of the names."""
    return [_info(name, scanner) for name, scanner in sorted(_REGISTRY.items())]


def _info(name: str, scanner: type[StereoDataSet]) -> DataSetInfo:
    summary = cleandoc(scanner.__doc__ or "").partition("\n")[0]
    options = {
        option.name: option.default
        for option in signature(scanner).parameters.values()
        if option.name not in ("root", "split", "strict")
    }
    return DataSetInfo(name, summary, scanner.splits, scanner.withheld, options)


def open_data_set(name: str, root: str | Path, **options: Any) -> StereoDataSet:
    """Open a data set by name.

    Args:
        name: A key of `data_sets`.
        root: Folder in which the data set's archives were unpacked.
        **options: Arguments of the class, such as ``split``.

    Returns:
        The data set, scanned and checked.

    Raises:
        FileNotFoundError: If nothing is found, or a file of a frame is missing.
        InputError: If the name or an option is unknown, or an option's value of the wrong type.
    """
    known = data_sets()
    if name not in known:
        raise InputError(f"unknown data set {name!r}: {choice_hint(name, known, likeliest=3)}")
    options = check_arguments(known[name].__init__, options, name, reserved=["root"])
    found = known[name](root, **options)
    for frame in found.frames:
        note_inputs(*filter(None, (frame.left, frame.right, frame.disparity)))
    return found
