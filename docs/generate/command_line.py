"""Pages of the command line's reference, from the options that Typer knows."""

from __future__ import annotations

import html
import re
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import typer

from mobilestereonet.cli.main import app

FOLDER = "reference/command-line"


def command_pages() -> dict[str, str]:
    """Markdown by path in the docs: a page per command, and one that lists them."""
    program = typer.main.get_command(app)
    commands = dict(_commands(program, "msnet"))
    pages = {f"{FOLDER}/{_file(name)}": _page(command, name) for name, command in commands.items()}
    lines = ["# Command line", "", _text(program.help), ""]
    lines += ["| command | what it does |", "| --- | --- |"]
    for name, command in commands.items():
        summary = command.get_short_help_str(limit=200)
        lines.append(f"| [`{name}`]({_file(name)}) | {_cell(summary)} |")
    context = program.context_class(program, info_name="msnet")
    lines += ["", *_tables(program, context)]
    return {f"{FOLDER}/index.md": "\n".join(lines) + "\n", **pages}


def _commands(group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, f"{prefix} {name}")
        else:
            yield f"{prefix} {name}", command


def _file(name: str) -> str:
    return name.removeprefix("msnet ").replace(" ", "-") + ".md"


def _page(command: Any, name: str) -> str:
    context = command.context_class(command, info_name=name)
    usage = command.get_usage(context).removeprefix("Usage: ")
    lines = [f"# {name}", "", _text(command.help), "", "```text", usage, "```", ""]
    lines += _tables(command, context)
    if command.epilog:
        lines += [
            "## Example",
            "",
            "```text",
            command.epilog.strip().removeprefix("Example: "),
            "```",
            "",
        ]
    return "\n".join(lines)


def _tables(command: Any, context: Any) -> list[str]:
    """A table per group of options, in the order in which the help text has them."""
    groups: dict[str, list[str]] = defaultdict(list)
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is None:
            continue
        is_argument = parameter.param_type_name == "argument"
        default = "Arguments" if is_argument else "Options"
        title = getattr(parameter, "rich_help_panel", None) or default
        names = " ".join(record[0].split()).replace("|", "\\|")
        groups[title].append(f"| `{names}` | {_cell(record[1])} |")
    lines = []
    for title, rows in groups.items():
        lines += [f"## {title}", "", "| | |", "| --- | --- |", *rows, ""]
    return lines


def _text(text: str | None) -> str:
    """A help text as Markdown: its ends of lines and form feeds say nothing here."""
    paragraphs = re.split(r"\n\s*\n", (text or "").replace("\f", "\n\n").strip())
    return "\n\n".join(_plain(" ".join(paragraph.split())) for paragraph in paragraphs)


def _cell(text: str) -> str:
    return _plain(" ".join(text.split()))


def _plain(text: str) -> str:
    """Text whose signs mean nothing in Markdown, but for code between backticks."""
    parts = re.split(r"(`[^`]*`)", text)
    signs = re.compile(r"([*_\[\]\\])")
    escaped = [
        part if part.startswith("`") else signs.sub(r"\\\1", html.escape(part, quote=False))
        for part in parts
    ]
    return "".join(escaped).replace("|", "\\|")
