"""Settings: frozen dataclasses from plain data, changed by dotted names, compared in words.

The one mechanism behind ``--set``, recipes, configs of networks and scenes, and options of data
sets. Every value is checked against its type hint, and a message names the value, what it must be
and, for an unknown name, the likeliest one meant.
"""

from __future__ import annotations

import difflib
import functools
import json
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, asdict, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from mobilestereonet.errors import InputError
from mobilestereonet.text import parse_json, shorten

T = TypeVar("T")

UNSET = "unset"
"""What `differences` gives for a value that only the other side has."""

_MAX_WHOLE = 2**63 - 1
"""Largest whole number of a setting: what 64 bits hold."""

_WORDS: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    Path: "a path",
    NoneType: "null",
}


_KNOWN_DISTANCE = re.compile(r"(\d{1,6}),(\d{1,6})=(\d{1,9}(?:\.\d+)?|\.\d+)", re.ASCII)


def parse_known_distance(text: str) -> tuple[int, int, float]:
    """Read ``COLUMN,ROW=METRES``.

    Raises:
        InputError: If it is none, or the distance is 0.
    """
    match = _KNOWN_DISTANCE.fullmatch(text)
    if match is None or not float(match[3]) > 0:
        raise InputError(f"--known {text}: write it as COLUMN,ROW=METRES, such as 320,240=2.5")
    return int(match[1]), int(match[2]), float(match[3])


def parse_assignments(assignments: Sequence[str]) -> dict[str, Any]:
    """Read assignments such as ``size=H``, ``lr=5e-4`` or ``augment.noise=0.02``.

    Args:
        assignments: Texts as given to ``--set``. Values are JSON; what is no JSON is text.

    Raises:
        InputError: If an assignment has no "=", or a value that `parse_json` refuses.
    """
    options: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise InputError(f"{shorten(assignment)!r}: write it as key=value")
        options[key] = parse_json(text, shorten(assignment)) if _is_json(text) else text
    return options


def parse_variations(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Read values to compare, such as ``lr=1e-3,5e-4`` or ``model=msnet2d,msnet3d``.

    Args:
        texts: Texts as given to ``--vary``. What stands after the name is a list of JSON without
            its brackets, or texts between commas; those within brackets do not count.

    Returns:
        The values by name.

    Raises:
        InputError: If there is no "=", no value, or a name comes twice.
    """
    found: dict[str, list[Any]] = {}
    for text in texts:
        name, equals, values = text.partition("=")
        if not equals or not values:
            raise InputError(f"{shorten(text)!r}: write it as name=value,value")
        if name in found:
            raise InputError(f"{name} is varied twice: give all its values at once")
        if _is_json(f"[{values}]"):
            found[name] = parse_json(f"[{values}]", shorten(text))
        else:
            parts = [f"{name}={value}" for value in _outer_parts(values)]
            found[name] = [parse_assignments([part])[name] for part in parts]
    return found


def _outer_parts(text: str) -> list[str]:
    """What stands between the commas outside brackets."""
    parts, depth = [""], 0
    for sign in text:
        depth += (sign in "[{") - (sign in "]}")
        if sign == "," and depth <= 0:
            parts.append("")
        else:
            parts[-1] += sign
    return parts


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except json.JSONDecodeError:
        return False
    except (ValueError, RecursionError):  # too many digits, too deep
        return True
    return True


def build(kind: type[T], values: Any, name: str, *, also_known: Sequence[str] = ()) -> T:
    """Make a dataclass from plain data such as JSON gives, its parts and tuples likewise.

    Args:
        kind: The dataclass.
        values: Values by name; what is left out has its default.
        name: What to call it in messages.
        also_known: Dotted names to suggest for unknown ones, beside those of ``kind``.

    Raises:
        InputError: If a name is unknown or missing, a value has the wrong type, or the dataclass
            refuses its values.
    """
    known = [*_dotted_names(kind), *also_known]
    return cast(T, _Builder(known).value(kind, values, name, ""))


def override(
    config: T, values: Mapping[str, Any], name: str, *, also_known: Sequence[str] = ()
) -> T:
    """A dataclass with other values.

    Args:
        config: The dataclass; it is not changed.
        values: New values by dotted name, such as ``lr`` or ``augment.noise``.
        name: What to call ``config`` in messages.
        also_known: See `build`.

    Raises:
        InputError: See `build`; also if a value is set below one that has no parts.
    """
    record = asdict(config)  # type: ignore[call-overload]
    for key, value in values.items():
        *parents, last = key.split(".")
        target: Any = record
        for parent in parents:
            if isinstance(target, dict) and target.get(parent) is None:
                target[parent] = {}
            target = target[parent] if isinstance(target, dict) else None
        if not isinstance(target, dict):
            raise InputError(f"{name}: there is no {key}: {parents[-1]} has no parts")
        target[last] = value
    return build(type(config), record, name, also_known=also_known)


def check_arguments(
    function: Callable[..., Any],
    arguments: Mapping[str, Any],
    name: str,
    *,
    reserved: Iterable[str] = (),
) -> dict[str, Any]:
    """Check keyword arguments, such as a user's options, against a function's type hints.

    Args:
        function: The function that is to be called; a class's ``__init__``.
        arguments: Arguments by name, as plain data.
        name: What to call the function in messages.
        reserved: Parameters that are not the user's to set.

    Returns:
        The arguments, of the hinted types.

    Raises:
        InputError: If a name is unknown, or a value has the wrong type.
    """
    hints = get_type_hints(function)
    for reserved_name in ("return", *reserved):
        hints.pop(reserved_name, None)
    builder = _Builder(list(hints))
    for key in arguments:
        if key not in hints:
            raise InputError(f"{name} has no option {key!r}{builder.hint(key, hints)}")
    return {
        key: builder.value(hints[key], value, f"{name}: {key}", key)
        for key, value in arguments.items()
    }


def differences(before: Any, after: Any) -> dict[str, tuple[Any, Any]]:
    """Values in which two configs differ: dotted name to (before, after).

    Args:
        before: A dataclass or mapping, with any of both as parts.
        after: Another one.
    """
    found: dict[str, tuple[Any, Any]] = {}
    old, new = _parts(before), _parts(after)
    for key in {**new, **old}:
        a, b = old.get(key, UNSET), new.get(key, UNSET)
        if _has_parts(a) and _has_parts(b):
            found |= {f"{key}.{part}": pair for part, pair in differences(a, b).items()}
        elif a != b:
            found[key] = (a, b)
    return found


class _Builder:
    """Makes values of the hinted types; knows all dotted names, to suggest them.

    Args:
        known: Dotted names of the whole config.
    """

    def __init__(self, known: Sequence[str]) -> None:
        self.known = known

    def value(self, hint: Any, value: Any, name: str, path: str) -> Any:
        """A value of the hinted type, called ``name`` in messages, at a dotted ``path``."""
        kind, members = get_origin(hint) or hint, get_args(hint)
        if kind is Any or isinstance(kind, TypeVar):
            return value
        if kind is Literal:
            # Not `in`: True is no 1.
            if any(value == member and type(value) is type(member) for member in members):
                return value
        elif kind in (UnionType, Union):
            return self._any_of(members, hint, value, name, path)
        elif is_dataclass(kind):
            if isinstance(value, cast(type[Any], kind)):
                return value
            if isinstance(value, Mapping):
                return self._dataclass(cast(type[Any], kind), value, name, path)
        elif kind is tuple and isinstance(value, list | tuple):
            kinds = members[:1] * len(value) if members[-1:] == (...,) else members
            if len(kinds) == len(value) or not members:
                pairs = zip(kinds or [Any] * len(value), value, strict=True)
                return tuple(self.value(*pair, name, path) for pair in pairs)
        elif kind in (int, float) and type(value) is int and abs(value) > _MAX_WHOLE:
            raise InputError(f"{name} is out of reach: {shorten(str(value))}")
        elif kind is float and type(value) is int:
            return float(value)
        elif kind is float and value != value:
            raise InputError(f"{name} must be a number, got NaN")
        elif kind is Path and isinstance(value, str):
            return Path(value)
        elif isinstance(value, kind) and (kind is bool or not isinstance(value, bool)):
            return value
        raise InputError(f"{name} must be {_in_words(hint)}, got {shorten(repr(value))}")

    def _any_of(self, members: Sequence[Any], hint: Any, value: Any, name: str, path: str) -> Any:
        """A value of one of several types; of one type or null, its own message."""
        if value is None and NoneType in members:
            return None
        kinds = [member for member in members if member is not NoneType]
        for kind in kinds:
            try:
                return self.value(kind, value, name, path)
            except InputError:
                if len(kinds) == 1 and isinstance(value, Mapping):
                    raise
        raise InputError(f"{name} must be {_in_words(hint)}, got {shorten(repr(value))}")

    def _dataclass(self, kind: type[Any], values: Mapping[str, Any], name: str, path: str) -> Any:
        hints, parts = _hints(cast(Any, kind)), _fields(kind)
        for key in values:
            if key not in parts:
                near = self.hint(key, parts)
                raise InputError(f"{name} has no value {key!r}{near}")
        missing = [key for key, part in parts.items() if _is_required(part) and key not in values]
        if missing:
            raise InputError(f"{name} lacks {', '.join(missing)}")
        prefix = f"{path}." if path else ""
        own = {
            key: self.value(hints[key], value, prefix + key, prefix + key)
            for key, value in values.items()
        }
        try:
            return kind(**own)
        except (TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{name}: {error}") from None

    def hint(self, key: str, own: Iterable[str]) -> str:
        """What ``key`` may mean: a name of its own part, or of any other, or a list of the former.

        Args:
            key: The unknown name.
            own: Names of the part in which it was looked for.
        """
        return likeliest_name(key, list(own), self.known)


def choice_hint(name: str, names: Collection[str], likeliest: int = 1) -> str:
    """End of the message about an unknown name: which may be meant, and all there are.

    Args:
        name: The unknown name.
        names: Those that there are.
        likeliest: How many to suggest at most.
    """
    near = difflib.get_close_matches(name.lower(), names, n=likeliest)
    hint = f"did you mean {', '.join(near)}? There are" if near else "there are"
    return f"{hint} {', '.join(names)}"


def likeliest_name(key: str, own: Sequence[str], known: Sequence[str]) -> str:
    """End of the message about an unknown name: what it may mean, and what there is.

    Args:
        key: The unknown name.
        own: Names of the part in which it was looked for.
        known: Dotted names of the whole config.
    """
    near = difflib.get_close_matches(key, own, n=1, cutoff=0.75)
    if not near:
        last = [name.rpartition(".")[2] for name in known]
        like = difflib.get_close_matches(key, last, n=1, cutoff=0.65)
        near = [name for name, part in zip(known, last, strict=True) if part in like]
    suggestion = f" (did you mean {' or '.join(near)}?)" if near else ""
    return f"{suggestion}, only {', '.join(own)}" if own else ": it has none"


def _fields(kind: Any) -> dict[str, Field[Any]]:
    """Fields that can be set, by name."""
    return {part.name: part for part in fields(kind) if part.init}


@functools.cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    return get_type_hints(kind)


def _is_required(part: Field[Any]) -> bool:
    return part.default is MISSING and part.default_factory is MISSING


def _dotted_names(kind: Any, prefix: str = "") -> list[str]:
    """Names of a dataclass's values and of its parts', as ``--set`` takes them."""
    hints = _hints(kind)
    names: list[str] = []
    for name in _fields(kind):
        nested = is_dataclass(hints[name])
        names += _dotted_names(hints[name], f"{prefix}{name}.") if nested else [prefix + name]
    return names


def _has_parts(value: Any) -> bool:
    return isinstance(value, Mapping) or (is_dataclass(value) and not isinstance(value, type))


def _parts(config: Any) -> dict[str, Any]:
    if isinstance(config, Mapping):
        return dict(config)
    return {name: getattr(config, name) for name in _fields(config)}


def _in_words(hint: Any) -> str:
    """A type as users of JSON would call it."""
    kind, members = get_origin(hint) or hint, get_args(hint)
    if kind is Literal:
        return f"one of {', '.join(map(str, members))}"
    if kind in (UnionType, Union):
        return " or ".join(map(_in_words, members))
    if kind is tuple:
        return f"[{', '.join('...' if m is ... else _in_words(m) for m in members)}]"
    if is_dataclass(kind):
        return f"a JSON object with some of {', '.join(_fields(kind))}"
    if isinstance(kind, type) and issubclass(kind, Mapping):
        return 'a JSON object such as {"name": 1}'
    return _WORDS.get(kind, getattr(kind, "__name__", str(kind)))
