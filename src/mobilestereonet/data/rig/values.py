"""Numbers and matrices among the entries of a calibration file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mobilestereonet.data.rig.cameras import Matrix, Size
from mobilestereonet.data.rig.entries import Entries
from mobilestereonet.errors import InputError

_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")


def numbers(value: Any) -> Matrix:
    """The numbers of an entry: an array, nested lists, a mapping with ``data``, or a text.

    A comma in a number of a text is a decimal one where white space separates the numbers.

    Raises:
        ValueError: If something in it is no number.
    """
    if isinstance(value, Mapping):
        if "data" in value:
            value = value["data"]
        elif {"x", "y", "z"} <= value.keys():
            value = [value[axis] for axis in "xyz"]
        else:
            raise ValueError("no data in it")
    if isinstance(value, str):
        words = re.sub(r"[\[\](){};]", " ", value).split()
        if all("," not in word or _DECIMAL_COMMA.fullmatch(word) for word in words):
            words = [word.replace(",", ".") for word in words]
        else:
            words = " ".join(words).replace(",", " ").split()
        return np.array([float(word) for word in words])
    if isinstance(value, list | tuple):
        if not value:
            return np.zeros(0)
        return np.concatenate([np.atleast_1d(numbers(part)) for part in value])
    if value is None or isinstance(value, bool):
        raise ValueError(f"{value} is no number")
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{array.dtype} are no numbers")
    return array.astype(np.float64).ravel()


def matrix_of(entries: Entries, names: str | Iterable[str], shape: tuple[int, ...]) -> Matrix:
    """Look up an entry under one of several names, as an array.

    Args:
        entries: Names and values.
        names: Names that the entry may have, in order of precedence.
        shape: Shape of the result; -1 takes any size.

    Raises:
        InputError: If there is none, or it has another size.
    """
    names = [names] if isinstance(names, str) else list(names)
    name = next((n for n in names if n in entries), None)
    if name is None:
        raise InputError(f"no {' or '.join(names)} in the file, only {listed(entries)}")
    try:
        return numbers(entries[name]).reshape(shape)
    except (ValueError, TypeError, RecursionError):
        size = " x ".join("n" if n < 0 else str(n) for n in shape)
        size += " number" if shape == (1,) else " numbers"
        found = str(entries[name])
        shown = found if len(found) <= 200 else f"{found[:200]} ..."
        raise InputError(f"{name} must hold {size}, got {shown!r}") from None


def number_of(entries: Entries, names: str | Iterable[str], default: float | None = None) -> float:
    """Look up a number; the default, if there is one, where no name is among the entries.

    Raises:
        InputError: If there is none, or it is no number.
    """
    names = [names] if isinstance(names, str) else list(names)
    if default is not None and entries.keys().isdisjoint(names):
        return default
    return float(matrix_of(entries, names, (1,))[0])


def size_of(width: float, height: float) -> Size | None:
    """Width and height as whole numbers; None where both are 0, as messages have it.

    Raises:
        InputError: If they are none.
    """
    if not (math.isfinite(width + height) and width == round(width) and height == round(height)):
        raise InputError(f"width and height must be whole numbers, got {width} and {height}")
    if not width and not height:
        return None
    if min(width, height) <= 0:
        raise InputError(f"width and height must be positive, got {width:g} and {height:g}")
    return round(width), round(height)


def listed(entries: Iterable[str]) -> str:
    """Some names for a message."""
    names = [str(name) for name in entries]
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(names[:12]) + more
