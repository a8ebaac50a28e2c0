"""Structured text with everything that no honest file has."""

import codecs
import os

import pytest

from mobilestereonet.errors import InputError
from mobilestereonet.settings import parse_assignments
from mobilestereonet.text import MAX_TEXT_BYTES, parse_json, parse_yaml, read_json, read_text

DEEP = 100_000
LAUGHS = "\n".join(
    ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    + [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32", "utf-16-le"])
def test_encodings(tmp_path, encoding):
    (tmp_path / "a.json").write_bytes('{"a":\r\n "\u00fc"}'.encode(encoding))
    assert read_json(tmp_path / "a.json") == {"a": "\u00fc"}


def test_byte_order_of_utf_16(tmp_path):
    (tmp_path / "a.txt").write_bytes(codecs.BOM_UTF16_BE + "a\u00fc".encode("utf-16-be"))
    assert read_text(tmp_path / "a.txt") == "a\u00fc"


def test_what_is_no_text_file(tmp_path):
    pipe, large, binary = (tmp_path / name for name in ("pipe", "large", "binary"))
    os.mkfifo(pipe)
    with large.open("wb") as file:
        file.truncate(MAX_TEXT_BYTES + 1)
    binary.write_bytes(b"\x89PNG\r\n\xff")
    for path in (pipe, tmp_path, tmp_path / "absent"):
        with pytest.raises(FileNotFoundError, match=path.name):
            read_text(path)
    with pytest.raises(InputError, match="large: larger than 8 MB"):
        read_text(large)
    with pytest.raises(InputError, match="binary: not a text file"):
        read_text(binary)


@pytest.mark.parametrize(
    "text",
    [
        "[" * DEEP + "]" * DEEP,
        '{"a":' * 70 + "1" + "}" * 70,
        '{"a": 1, "a": 2}',
        '{"b": {"a": 1, "a": 1}}',
        '{"a": NaN}',
        "9" * 5000,
        "{",
        "",
    ],
)
def test_json_is_refused_with_the_files_name(text):
    with pytest.raises(InputError, match=r"^a\.json: "):
        parse_json(text, "a.json")


@pytest.mark.parametrize(
    "text",
    [
        LAUGHS,
        "a: &a [*a]",
        "a: &a {b: *a}",
        "a: " + "[" * 2000,
        "a0: &b0 1\n" + "\n".join(f"a{n}: &b{n} [[[[[[[[*b{n - 1}]]]]]]]]" for n in range(1, 20)),
        "a: 1\na: 2",
        "b: {a: 1, a: 1}",
        "1: 2",
        "null: 2",
        "[1]: 2",
        "2020-01-01: 3",
        "a: !!python/object/apply:os.system [echo]",
        "a: !mine 3",
        "a: 2020-99-99",
        "a: " + "9" * 5000,
        "a: !!int x",
        "a: !!float x",
        "a: !!timestamp x",
        "a: !!binary \u00fc",
        "%YAML:1.0\n---\na: 1",
        "a: \x07",
        "<<: 3",
        "*a",
        "a: &a\n<<: *b",
    ],
)
def test_yaml_is_refused_with_the_files_name(text):
    with pytest.raises(InputError, match=r"^a\.yaml: ") as refused:
        parse_yaml(text, "a.yaml")
    assert len(str(refused.value)) < 500


def test_yaml_of_honest_files():
    dumped = "left: &id001\n- 1.0\n- 2\nright: *id001\n"
    assert parse_yaml(dumped, "a") == {"left": [1.0, 2], "right": [1.0, 2]}
    merged = "base: &b {x: 1, y: 2}\nown: {<<: *b, y: 3}"
    assert parse_yaml(merged, "a")["own"] == {"x": 1, "y": 3}
    assert parse_yaml("---\n---\na: 1\n---\nb: 2", "a") == {"a": 1}
    assert parse_yaml("", "a") is None


@pytest.mark.parametrize("value", ["9" * 5000, "[" * DEEP, "NaN", '{"a": 1, "a": 2}'])
def test_assignments_that_json_cannot_hold(value):
    with pytest.raises(InputError, match=r"^lr="):
        parse_assignments([f"lr={value}"])
