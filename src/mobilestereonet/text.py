"""Structured text of others: JSON and YAML, with limits on all that a file can ask for.

Size, nesting, names given twice, numbers of thousands of digits, aliases that expand without end:
what no honest file has is refused with the file's name.
"""

from __future__ import annotations

import codecs
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import-untyped]

from mobilestereonet.errors import InputError

MAX_TEXT_BYTES = 8 << 20
"""Size of the largest file that is read as structured text."""

MAX_DEPTH = 64
"""Levels of lists and mappings in each other."""

MAX_YAML_NODES = 1_000_000
"""Values of a YAML file, with every alias written out."""

_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16, whose mark it begins with
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}


def read_text(path: str | Path) -> str:
    """Read a text file: UTF-8, or what its byte-order mark says.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If it is larger than `MAX_TEXT_BYTES`, or no text.
    """
    path = Path(path)
    if not path.is_file():  # a pipe would wait for ever
        raise FileNotFoundError(f"{path}: no such file")
    with path.open("rb") as file:
        content = file.read(MAX_TEXT_BYTES + 1)
    if len(content) > MAX_TEXT_BYTES:
        raise InputError(f"{path}: larger than {MAX_TEXT_BYTES >> 20} MB, no file of this kind is")
    return decode(content, str(path))


def decode(content: bytes, name: str) -> str:
    """Decode a text file's content: UTF-8, or what its byte-order mark says.

    Args:
        content: The bytes.
        name: What to call it in messages.

    Raises:
        InputError: If it is no text.
    """
    marked = (code for mark, code in _BYTE_ORDER_MARKS.items() if content.startswith(mark))
    encoding = next(marked, None)
    if encoding is None:  # ASCII in UTF-16 without its mark has a zero in every second byte
        pair = content[:2]
        nul = {b"\0": "utf-16-be"}.get(pair[:1]) or {b"\0": "utf-16-le"}.get(pair[1:])
        encoding = nul or "utf-8"
    try:
        return content.decode(encoding).replace("\r\n", "\n")
    except UnicodeError as error:
        raise InputError(f"{name}: not a text file: {error}") from None


def read_json(path: str | Path) -> Any:
    """Read a JSON file; see `read_text` and `parse_json`."""
    return parse_json(read_text(path), str(path))


def parse_json(text: str, name: str) -> Any:
    """Parse JSON.

    Args:
        text: The text.
        name: What to call it in messages.

    Raises:
        InputError: If it is no JSON, names a value twice, holds NaN or an integer too long for
            Python, or is nested too deeply.
    """
    try:
        found = json.loads(text, object_pairs_hook=_unique, parse_constant=_constant)
        _check_depth(found)
    except RecursionError:
        raise InputError(f"{name}: nested too deeply") from None
    except ValueError as error:  # no JSON, or an InputError of ours
        raise InputError(f"{name}: no JSON that makes sense here: {error}") from None
    return found


def parse_yaml(text: str, name: str) -> Any:
    """Parse the first YAML document that is not empty; None if there is none.

    Args:
        text: The text.
        name: What to call it in messages.

    Raises:
        InputError: If it is no YAML, names a value twice or by something else than text, holds a
            type of its own or a number too long for Python, is nested too deeply, or has aliases
            that expand to more than `MAX_YAML_NODES`.
    """
    try:
        return next((entry for entry in yaml.load_all(text, _Loader) if entry is not None), None)
    except RecursionError:
        raise InputError(f"{name}: nested too deeply") from None
    except (yaml.YAMLError, ValueError, OverflowError, TypeError, AttributeError) as error:
        # PyYAML's constructors meet values that are none with any of these.
        reason = shorten(" ".join(str(error).split()), 300)
        raise InputError(f"{name}: no YAML that makes sense here: {reason}") from None


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """PyYAML's safe loader, with limits."""

    def construct_document(self, node: Any) -> Any:
        """Check the tree before anything is made of it."""
        _count(node, {})
        return super().construct_document(node)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """A mapping whose names are texts, each given once."""
        names = [key.value for key, _ in node.value if key.tag != "tag:yaml.org,2002:merge"]
        found = super().construct_mapping(node, deep=deep)
        for name in found:
            if not isinstance(name, str):
                raise InputError(f"its names must be text, got {shorten(str(name))!r}")
        _unique((name, None) for name in names)
        return found


def _count(node: Any, known: dict[int, tuple[int, int]], depth: int = 0) -> tuple[int, int]:
    """Values of a YAML node with every alias written out, and their levels.

    Raises:
        InputError: If there are too many, or the nesting is too deep or without end.
    """
    if depth > MAX_DEPTH:  # what holds itself has no end
        raise InputError("nested too deeply, or in itself")
    if id(node) not in known:
        children = [] if isinstance(node, yaml.ScalarNode) else node.value
        if isinstance(node, yaml.MappingNode):
            children = [part for pair in children for part in pair]
        counted = [_count(child, known, depth + 1) for child in children]
        values = 1 + sum(count for count, _ in counted)
        known[id(node)] = values, 1 + max((levels for _, levels in counted), default=0)
    values, levels = known[id(node)]
    if values > MAX_YAML_NODES:
        raise InputError(f"its aliases expand to more than {MAX_YAML_NODES:,} values")
    if levels > MAX_DEPTH:
        raise InputError("nested too deeply")
    return values, levels


def _unique(pairs: Iterable[tuple[Any, Any]]) -> dict[Any, Any]:
    found: dict[Any, Any] = {}
    for name, value in pairs:
        if name in found:
            raise InputError(f"{shorten(str(name))!r} is given twice: leave one of them out")
        found[name] = value
    return found


def _constant(name: str) -> float:
    if name == "NaN":
        raise InputError("NaN is no number")
    return float(name)


def _check_depth(value: Any, depth: int = 0) -> None:
    if depth > MAX_DEPTH:
        raise InputError("nested too deeply")
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            _check_depth(part, depth + 1)


def shorten(text: str, length: int = 80) -> str:
    """A text, cut where it is long."""
    return text if len(text) <= length else f"{text[:length]}..."
