"""MkDocs hook: adds the pages of the reference that are made of the code itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from command_line import FOLDER, command_pages
from mkdocs.structure.files import File, Files
from recipes import recipe_page

PAGES = {**command_pages(), **recipe_page()}
"""Markdown by path in the docs."""

DOCS = Path(__file__).parents[1]


def on_config(config: Any) -> None:
    """Put the pages of commands and of weights behind their lists in the menu."""
    commands = [path for path in PAGES if path.startswith(FOLDER)]
    cards = [f"models/{path.name}" for path in sorted((DOCS / "models").glob("*.md"))]
    for pages in (commands, cards):
        _place_behind(config.nav, next(page for page in pages if page.endswith("index.md")), pages)


def on_files(files: Files, config: Any) -> Files:
    """Add all generated pages."""
    for path, content in PAGES.items():
        stub = files.get_file_from_path(path)  # what a checkout shows in the page's place
        if stub is not None:
            files.remove(stub)
        files.append(File.generated(config, path, content=content))
    return files


def _place_behind(menu: list[Any], entry: str, others: list[str]) -> None:
    for part in menu:
        for inner in part.values() if isinstance(part, dict) else ():
            if isinstance(inner, list):
                _place_behind(inner, entry, others)
    if entry in menu:
        menu += [other for other in others if other not in menu]
