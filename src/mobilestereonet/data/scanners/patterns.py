"""Base of the data sets whose layout is given as file patterns: both views and the ground truth."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.scanners.base import Frame, StereoDataSet, occlusion_from_right_view

_WILDCARD = re.compile(r"\*\*/|\*|\?|\[[^]]*\]")


class PatternDataSet(StereoDataSet):
    """Data set whose layout is given as file patterns.

    What the wildcards of ``left`` match in a file's path is filled in for those of ``right`` and
    ``disparity``, in the same order; these may have fewer. ``{split}`` is the split's name.

    Attributes:
        left: Glob of the left views below the root.
        right: Pattern of the right views.
        disparity: Pattern of the ground truth; None where there is none.
        right_disparity: Pattern of the right view's ground truth, with the wildcards of
            ``disparity``: occlusion follows from it where there is such a file.
        archive: Folder that the archives bring: the root is it or holds it.
        split_texts: What ``{split}`` stands for, where it is not the split's name.
    """

    left: str
    right: str
    disparity: str | None
    right_disparity: ClassVar[str | None] = None
    archive: ClassVar[str] = ""
    split_texts: ClassVar[Mapping[str, str]] = {}

    def patterns(self) -> Sequence[str]:
        """Glob of the left views, below the root and below the archives' own folder."""
        left = self._of_split(self.left)
        return [left, f"{self.archive}/{left}"] if self.archive else [left]

    def frame(self, left: Path) -> Frame:
        """Paths from the other patterns, filled in."""
        base, values = self._wildcards(self.left, left)
        truth = self.disparity
        return Frame(
            name=left.relative_to(base).with_suffix("").as_posix(),
            left=left,
            right=base / self._filled(self.right, values),
            disparity=None if truth is None else base / self._filled(truth, values),
        )

    def read_occluded(self, truth: Path, disparity: FloatMap, valid: Mask) -> Mask | None:
        """Compute occlusion, if the right view's ground truth is there too."""
        if self.right_disparity is None or self.disparity is None:
            return None
        base, values = self._wildcards(self.disparity, truth)
        right = base / self._filled(self.right_disparity, values)
        if not right.is_file():
            return None
        return occlusion_from_right_view(disparity, valid, *self.read_disparity(right))

    def _of_split(self, pattern: str) -> str:
        return pattern.replace("{split}", self.split_texts.get(self.split, self.split))

    def _wildcards(self, pattern: str, path: Path) -> tuple[Path, list[str]]:
        """Folder to which a pattern belongs, and what its wildcards are in a path."""
        below = bool(self.archive) and path.relative_to(self.root).parts[0] == self.archive
        base = self.root / self.archive if below else self.root
        return base, _wildcard_values(self._of_split(pattern), path.relative_to(base).as_posix())

    def _filled(self, pattern: str, values: Sequence[str]) -> str:
        remaining = iter(values)
        return _WILDCARD.sub(lambda _: next(remaining), self._of_split(pattern))


def count_wildcards(pattern: str) -> int:
    """Number of a pattern's wildcards."""
    return len(_WILDCARD.findall(pattern))


def _wildcard_values(pattern: str, path: str) -> list[str]:
    groups = {"**/": "((?:.*/)?)", "*": "([^/]*)", "?": "([^/])"}
    texts, wildcards = _WILDCARD.split(pattern), _WILDCARD.findall(pattern)
    expression = re.escape(texts[0])
    for wildcard, text in zip(wildcards, texts[1:], strict=True):
        expression += groups.get(wildcard, "([^/])") + re.escape(text)
    match = re.fullmatch(expression, path)
    assert match is not None, f"{path} was found by the glob {pattern}"
    return list(match.groups())
