"""The pages' code blocks: they run, or say why not, and every command in them exists."""

import ast
import importlib
import re
import shlex
import shutil
import sys
from pathlib import Path
from unittest.mock import patch

import pytest
import typer
from pages import PAGES, ROOT, SET_UP, blocks, inline_code, msnet_arguments, page_id

from extras import need_extra
from mobilestereonet.cli.main import app, main
from mobilestereonet.data.scanners import registry as data_registry
from mobilestereonet.export import FORMATS
from mobilestereonet.inference import DEFAULT_MODEL
from mobilestereonet.nets import registry as net_registry
from mobilestereonet.settings import parse_assignments
from mobilestereonet.training.named_recipes import get_recipe
from mobilestereonet.training.recipe import override

EXTRAS = {"streams.md": ("av", "ray.data"), "tutorials/camera.md": ("av",)}
"""What pages need that the base package does not bring."""

pages = pytest.mark.parametrize("page", PAGES, ids=page_id)


def find_command(arguments):
    """The command that the first words name, and the other words."""
    command = typer.main.get_command(app)
    while hasattr(command, "commands") and arguments and not arguments[0].startswith("-"):
        assert arguments[0] in command.commands, f"msnet has no command {arguments[0]}"
        command, arguments = command.commands[arguments[0]], arguments[1:]
    return command, arguments


def check_extras(words):
    """What `pip install` asks of this package exists."""
    text = (ROOT / "pyproject.toml").read_text()
    extras = re.findall(r"^(\w+) = \[", text[text.index("optional-dependencies") :], flags=re.M)
    for names in re.findall(r"(?:mobilestereonet|\.)\[([\w,]+)\]", " ".join(words)):
        assert set(names.split(",")) <= set(extras)


@pages
def test_blocks_that_do_not_run_say_why(page):
    for block in blocks(page):
        where = f"{page.name}:{block.line}"
        assert block.language in ("bash", "python", "text", "json"), where
        set_up = page.name == "README.md" and block.marker in SET_UP
        assert not block.marker or set_up or re.match(r"(not run|file): \w", block.marker), where


def test_the_set_up_commands_are_the_readmes():
    assert [b.marker for b in blocks(ROOT / "README.md") if b.marker] == list(SET_UP)


@pages
def test_commands_exist(page, monkeypatch):
    # The files and folders that a page speaks of; a model's name is none.
    monkeypatch.setattr(Path, "exists", lambda path: "." in path.name or "/" in str(path))
    monkeypatch.setattr(Path, "is_file", Path.exists)
    monkeypatch.setattr(Path, "is_dir", lambda path: True)
    for block in blocks(page):
        if block.language != "bash" or block.marker in SET_UP:
            continue
        for words in block.commands():
            check_extras(words)
            arguments = msnet_arguments(words)
            if arguments is None:
                continue
            command, rest = find_command(arguments)
            if "--help" in rest:
                continue
            given = command.make_context(command.name, list(rest)).params  # parsed, not run
            if "recipe" in given and not str(given["recipe"]).endswith(".json"):
                recipe = get_recipe(given["recipe"] or "procedural")
                override(recipe, parse_assignments(given["assignments"] or []))


def test_the_exported_files_are_those_that_the_text_uses():
    page = ROOT / "docs" / "export.md"
    written = set()
    for line in next(
        block for block in blocks(page) if "msnet export onnx" in block.text
    ).text.split("\n"):
        words, _, comment = line.partition("#")
        if comment and "--list" not in words:
            _, rest = find_command(shlex.split(words)[1:])
            model = rest[rest.index("--model") + 1] if "--model" in rest else DEFAULT_MODEL
            precision = f"-{rest[rest.index('--precision') + 1]}" if "--precision" in rest else ""
            name = model + precision + FORMATS[rest[0]].ending
            assert comment.split()[0].rstrip(":") == name
            written.add(name)
    used = {
        name
        for block in blocks(page)
        if block.language == "python"
        for name in re.findall(r'"(msnet\w+\.\w+)"', block.text)
    }
    assert used and used <= written


@pages
def test_commands_in_the_text_exist(page):
    for code in inline_code(page):
        if not code.startswith("msnet "):
            continue
        command, rest = find_command(shlex.split(code)[1:])
        options = {name for parameter in command.params for name in parameter.opts} | {"--help"}
        used = {word for word in rest if re.match(r"--?[a-z]", word)}
        assert used <= options, f"{page.name}: `{code}`"


@pages
def test_python_blocks_import_what_exists(page):
    for block in blocks(page):
        if block.language != "python":
            continue
        for node in ast.walk(ast.parse(block.text, f"{page.name}:{block.line}")):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("mobilestereonet"):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, alias.name) for alias in node.names)


def _run_command(words, monkeypatch, capsys, where):
    if words[:2] == ["pip", "install"]:
        return
    arguments = msnet_arguments(words)
    assert arguments is not None, f"{where}: cannot run {words[0]}: mark the block"
    monkeypatch.setattr(sys, "argv", ["msnet", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    printed = capsys.readouterr()
    assert not ended.value.code, f"{where}: {shlex.join(words)}: {printed.out}{printed.err}"


@pytest.mark.slow
@pages
@patch.dict(data_registry._REGISTRY)
@patch.dict(net_registry._MODELS)
@patch.dict(FORMATS)
def test_blocks_run(page, shared_files, tmp_path, monkeypatch, capsys):
    """What a page registers is gone after it."""
    if page.name == "CONTRIBUTING.md":
        pytest.skip("CI runs these commands")
    for module in EXTRAS.get(page_id(page), ()):
        need_extra(module)
    shutil.copytree(shared_files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    names = {"__name__": page.name}
    for block in (block for other in PAGES for block in blocks(other) if block.file):
        Path(block.file).write_text(block.text)
    for block in filter(lambda block: block.runs, blocks(page)):
        where = f"{page.name}:{block.line}"
        if block.language == "python":
            exec(compile(block.text, where, "exec"), names)
            continue
        for words in block.commands():
            _run_command(words, monkeypatch, capsys, where)
