"""Calibration files as names with values: FileStorage, YAML, JSON, INI, NumPy archives, lines."""

from __future__ import annotations

import configparser
import io
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np

from mobilestereonet.data.files import read_bytes
from mobilestereonet.errors import InputError
from mobilestereonet.text import decode, parse_json, parse_yaml, shorten

Entries: TypeAlias = dict[str, Any]
"""Names and values: numbers, texts, arrays, lists, and entries in turn."""

MAX_FILE_BYTES = 1 << 25
"""Size above which a file is no calibration; those with the corners of all boards have 1 MB."""

MAX_ENTRIES = 10_000
"""Names and values in one file, nested ones among them."""

_NAME = "not a calibration file"
_NOT_FINITE = re.compile(r"-?\b(NaN|Infinity)\b")
_LINE = re.compile(r"^[ \t]*(\w+)[ \t]*[=:][ \t]*(.*?)[ \t]*$", flags=re.MULTILINE)
_MIDDLEBURY = re.compile(r"^[ \t]*cam[01][ \t]*=", flags=re.MULTILINE)
_KITTI = re.compile(r"^[ \t]*(P|P_rect_)\d+[ \t]*:([ \t]+[-+.,\w]+){6,}[ \t]*$", re.MULTILINE)
_SECTION = re.compile(r"^\[[A-Za-z]\w*\][ \t]*$", flags=re.MULTILINE)


def read_entries(path: str | Path) -> Entries:
    """Read a calibration file as names with values, whatever its syntax.

    Args:
        path: A file of OpenCV's FileStorage (YAML, XML, JSON), plain YAML or JSON, a NumPy archive
            (``.npz``), an INI file, or lines ``name: value`` or ``name=value``. Of several YAML
            documents, such as messages that ROS printed, the first counts. Its encoding, line ends
            and byte-order mark do not matter.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If it is none of these.
    """
    path = Path(path)
    if path.is_file() and path.stat().st_size > MAX_FILE_BYTES:
        raise InputError(f"{path}: more than {MAX_FILE_BYTES >> 20} MB: no calibration file is")
    content = read_bytes(path)
    try:
        if content.startswith(b"PK\x03\x04"):
            return _read_archive(content)
        return _read_text(_decode(content))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _decode(content: bytes) -> str:
    try:
        text = decode(content, "it")
    except InputError:  # a comment in an old code page
        text = content.decode("latin-1")
    if "\0" in text:
        raise InputError("unknown calibration format: it is no text")
    return text.replace("\r", "\n")


def _read_text(text: str) -> Entries:
    start = text.lstrip()
    if start.startswith(("%YAML", "<?xml", "<opencv_storage")) or "!!opencv-" in text:
        return _read_storage(start)
    if start.startswith("{"):
        return _read_storage(start) if '"type_id"' in text else _read_json(start)
    if _SECTION.search(text):
        return _read_sections(text)
    if _MIDDLEBURY.search(text) or _KITTI.search(text):
        return _lines(text)
    return _read_yaml(text)


def _lines(text: str) -> Entries:
    found: Entries = {}
    for name, value in _LINE.findall(text):
        if found.setdefault(name, value) != value:
            told = f"{shorten(found[name])} and {shorten(value)}"
            raise InputError(f"{name} is given twice, as {told}: leave one of them out")
    return found


def _read_storage(text: str) -> Entries:
    """A file of OpenCV's FileStorage; what OpenCV cannot read may be other YAML."""
    body = re.sub(r"^(%.*\n)*(---.*\n)?", "", text)
    yml = not text.startswith(("<", "{"))
    try:
        storage = cv2.FileStorage(
            "%YAML:1.0\n---\n" + body if yml else text,
            cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY,
        )
        root = storage.root()
        return {name: _node_value(root.getNode(name)) for name in root.keys()}  # noqa: SIM118
    except (cv2.error, SystemError, ValueError) as error:
        if yml and "!!opencv-" not in text:
            return _read_yaml(body)
        reason = " ".join(str(error.__cause__ or error).split())
        raise InputError(f"not a calibration file: {reason}") from None


def _node_value(node: cv2.FileNode) -> Any:
    """A node's value; None of a matrix that OpenCV cannot read, which nobody may need."""
    if node.isMap():
        names = node.keys()
        if "dt" in names:
            try:
                return node.mat()
            except (cv2.error, SystemError):
                return None
        return {name: _node_value(node.getNode(name)) for name in names}
    if node.isSeq():
        return [_node_value(node.at(index)) for index in range(node.size())]
    return node.string() if node.isString() else node.real()


def _read_json(text: str) -> Entries:
    # Programs write NaN beside what they could calibrate; None is no number either.
    return _mapping(parse_json(_NOT_FINITE.sub("null", text), _NAME))


def _read_yaml(text: str) -> Entries:
    document = parse_yaml(text, _NAME)
    return {} if document is None else _mapping(document)


def _mapping(value: Any) -> Entries:
    if not isinstance(value, dict):
        raise InputError("unknown calibration format: it has no names with values")
    return {str(name): entry for name, entry in value.items()}


def _read_sections(text: str) -> Entries:
    parser = configparser.ConfigParser(interpolation=None, strict=False, delimiters=("=", ":"))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise InputError(f"not a calibration file: {' '.join(str(error).split())}") from None
    return {name: dict(section) for name, section in parser.items() if section}


def _read_archive(content: bytes) -> Entries:
    """A NumPy archive; entries that would run code to be read are left out."""
    entries: Entries = {}
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MAX_FILE_BYTES:
            raise InputError(f"{size} bytes are too many for a calibration")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            for name in arrays.files:
                try:
                    entries[name] = arrays[name]
                except ValueError:  # objects
                    entries[name] = None
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise InputError(f"not a calibration file: {error}") from None
    return entries


def flattened(entries: Mapping[str, Any], prefix: str = "", depth: int = 4) -> Entries:
    """Entries of entries under joined names: ``left_K`` for ``left: {K: ...}``.

    Matrices (mappings with ``data``) stay as they are.

    Raises:
        InputError: If there are more than `MAX_ENTRIES`.
    """
    flat: Entries = {}
    for name, value in entries.items():
        if isinstance(value, Mapping) and value.keys().isdisjoint(("data", "rows")) and depth:
            flat |= flattened(value, f"{prefix}{name}_", depth - 1)
        else:
            flat[f"{prefix}{name}"] = value
        if len(flat) > MAX_ENTRIES:
            raise InputError(f"more than {MAX_ENTRIES} names in it: this is no calibration")
    return flat
