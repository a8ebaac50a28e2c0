"""The documentation's pages, their code blocks, links and words."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
GENERATED = ("reference/command-line/",)
"""Folders of pages that `docs/generate/hook.py` makes while the site is built."""
SET_UP = ("demo", "test")
"""Markers of the README's first two commands, which CI runs."""


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, the comment just above it, and where it is."""

    page: Path
    line: int
    language: str
    marker: str
    text: str

    @property
    def file(self) -> str | None:
        """Name under which a reader saves the block."""
        kind, _, name = self.marker.partition(": ")
        return name if kind == "file" else None

    @property
    def runs(self) -> bool:
        return self.language in ("bash", "python") and not self.marker

    def commands(self) -> list[list[str]]:
        """The words of each command, without comments."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [words for line in lines if (words := shlex.split(line, comments=True))]


def page_id(page: Path) -> str:
    """What tests call a page."""
    return str(page.relative_to(DOCS if DOCS in page.parents else ROOT))


def blocks(page: Path) -> list[Block]:
    """All fenced blocks of a page."""
    fence = re.compile(
        r"^(?:<!-- (?P<marker>[^\n]*) -->\n)?```(?P<language>\w*)\n(?P<text>.*?)^```$", re.M | re.S
    )
    content = page.read_text(encoding="utf-8")
    return [
        Block(
            page,
            content[: match.start("text")].count("\n") + 1,
            match["language"],
            match["marker"] or "",
            match["text"],
        )
        for match in fence.finditer(content)
    ]


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)


def inline_code(page: Path) -> list[str]:
    """What stands between backticks in a page's text."""
    return [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose(page))]


def msnet_arguments(words: list[str]) -> list[str] | None:
    """What `msnet` is given in a command; None if the command is another one."""
    if words[0].split("/")[-1] == "msnet":
        return words[1:]
    is_module = ["-m", "mobilestereonet"] in [words[i : i + 2] for i in range(len(words))]
    return words[words.index("mobilestereonet") + 1 :] if is_module else None
