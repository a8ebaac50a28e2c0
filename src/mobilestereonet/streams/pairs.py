"""Pairs of image files in folders: finding and reading them."""

from __future__ import annotations

import re
import warnings
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from operator import itemgetter
from pathlib import Path

from mobilestereonet.data.files import visible
from mobilestereonet.data.sample import Calibration
from mobilestereonet.data.scanners import PairFolder
from mobilestereonet.data.scanners.base import Frame
from mobilestereonet.errors import InputError
from mobilestereonet.inference.pair import load_pair
from mobilestereonet.streams.laser import Pose
from mobilestereonet.streams.pairing import pair_by_time, tolerance_of
from mobilestereonet.streams.stream import StereoFrame

IMAGE_ENDINGS = {
    *(".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm"),
    *(".mpo", ".jps", ".pns"),  # with both views
}
"""Endings of image files in folders."""

_WILDCARD = re.compile(r"[*?[]")
_STAMP = re.compile(r"\d{9,}(\.\d+)?|\d{9,10}[_-]\d{9}")
"""A name that is a time stamp: seconds, or a smaller unit, since 1970; or both, as ROS has it."""

_SECONDS_NANOSECONDS = re.compile(r"(?<!\d)(\d{9,10})[._-](\d{9})$")


@dataclass(frozen=True)
class PairFiles:
    """Files of a pair.

    Attributes:
        name: What to call the pair in reports and file names; may hold slashes.
        left: File of the left view.
        right: File of the right view; None if the left one has both, see `load_pair`.
        calibration: Its geometry, if the folders tell it.
        to_laser: From the left camera's frame to the laser scanner's, if the folders tell it.
    """

    name: str
    left: Path
    right: Path | None
    calibration: Calibration | None = None
    to_laser: Pose | None = field(default=None, compare=False)

    @property
    def files(self) -> list[Path]:
        """One file or two."""
        return [self.left] if self.right is None else [self.left, self.right]


def pair_folders(
    left: str | Path, right: str | Path, pair_by: str | None = None
) -> list[PairFiles]:
    """Find the pairs of two folders or patterns, in the order of their names.

    Args:
        left: Folder of left views, or a pattern.
        right: Folder of right views whose files have the same names, or a pattern whose wildcards
            stand for the same.
        pair_by: "name"; "order"; or "nearest", by the time stamps that the names end in, in any
            unit. By default by name, and by stamps where no name is in both folders and all names
            are stamps. A warning says how many views have no partner at their time.

    Raises:
        FileNotFoundError: If a folder or a view does not exist.
        InputError: If a view has no partner, two have one name, or the folders do not tell which
            images are meant.
    """
    patterns = [_pattern(source) for source in (left, right)]
    views = [sorted(visible(*own), key=lambda path: _natural(path.name)) for own in patterns]
    if pair_by is None:
        shared = {path.name for path in views[0]} & {path.name for path in views[1]}
        stamped = all(_STAMP.fullmatch(path.stem) for own in views for path in own)
        pair_by = "nearest" if stamped and not shared and all(views) else "name"
    if pair_by == "order":
        return _by_order(*views)
    if pair_by == "nearest":
        return _by_stamp(*views)
    if pair_by != "name":
        raise InputError(f"views are paired by name, order or nearest; got {pair_by!r}")
    frames = _PairFolders(*patterns).frames
    alone = set(views[1]) - {frame.right for frame in frames}
    if alone:
        raise InputError(
            f"{len(frames)} left views, but {len(frames) + len(alone)} right ones: "
            f"{min(alone)} has no left view"
        )
    return _named(PairFiles(frame.name, frame.left, frame.right) for frame in frames)


def joined_files(source: str | Path) -> list[PairFiles]:
    """Find the files of a folder or a pattern that have both views each, in order of their names.

    Args:
        source: Folder or pattern of MPO files, or of pictures with both views side by side.

    Raises:
        FileNotFoundError: If there is no such folder, or the pattern stands for nothing.
        InputError: If two have one name, or the folder does not tell which images are meant.
    """
    folder, pattern = _pattern(source)
    files = list(visible(folder, pattern))
    if not files:
        raise FileNotFoundError(f"{source}: no such file, folder or pattern")
    names = (file.relative_to(folder).with_suffix("").as_posix() for file in files)
    return _named(PairFiles(name, file, None) for name, file in zip(names, files, strict=True))


def _named(pairs: Iterable[PairFiles]) -> list[PairFiles]:
    """Pairs in the order of their names, which must differ."""
    named: dict[str, PairFiles] = {}
    for pair in pairs:
        other = named.setdefault(pair.name, pair)
        if other is not pair:
            raise InputError(
                f"{other.left} and {pair.left} would both be called {pair.name}, and so would "
                "their maps: give a pattern that holds one of them, such as '*.png'"
            )
    return [named[name] for name in sorted(named, key=_natural)]


def _by_order(lefts: Sequence[Path], rights: Sequence[Path]) -> list[PairFiles]:
    if len(lefts) != len(rights):
        raise InputError(
            f"{len(lefts)} left views, but {len(rights)} right ones: to pair them by order, there "
            "must be as many"
        )
    return [PairFiles(one.stem, one, other) for one, other in zip(lefts, rights, strict=True)]


def _by_stamp(lefts: Sequence[Path], rights: Sequence[Path]) -> list[PairFiles]:
    """Pairs of the nearest time stamps, half of the usual interval apart at most."""
    stamps = [sorted((_stamp(path), path) for path in views) for views in (lefts, rights)]
    start = min(own[0][0] for own in stamps)  # differences are small, and floats exact for them
    lefts_at, rights_at = ([(float(stamp - start), path) for stamp, path in own] for own in stamps)
    tolerance = tolerance_of(*([moment for moment, _ in own] for own in (lefts_at, rights_at)))
    dropped: list[tuple[float, Path]] = []
    paired = pair_by_time(lefts_at, rights_at, itemgetter(0), tolerance, dropped)
    pairs = [PairFiles(one.stem, one, other) for (_, one), (_, other) in paired]
    if not pairs:
        raise InputError(
            f"{lefts[0]} and {rights[0]}: no two time stamps are nearer than half of the interval "
            "between views: are they of one recording? --pair order pairs them by their order"
        )
    if dropped:
        warnings.warn(
            f"{len(lefts) - len(pairs)} of {len(lefts)} left views and {len(rights) - len(pairs)} "
            f"of {len(rights)} right ones have no partner at their time, such as {dropped[0][1]}: "
            "they are left out",
            stacklevel=3,
        )
    return pairs


def _stamp(path: Path) -> Decimal:
    """The number that a file's name ends in; seconds and nanoseconds are one."""
    if match := _SECONDS_NANOSECONDS.search(path.stem):
        return Decimal(f"{match[1]}.{match[2]}")
    numbers = re.findall(r"\d+(?:\.\d+)?", path.stem)
    if not numbers:
        raise InputError(f"{path}: no time stamp in its name: pair by name or by order")
    return Decimal(numbers[-1])


class _PairFolders(PairFolder):
    """Pairs whose views lie in two folders, each with its own pattern below it."""

    def __init__(self, left: tuple[Path, str], right: tuple[Path, str]) -> None:
        self.right_root = right[0]
        super().__init__(left[0], left=left[1], right=right[1])

    def frame(self, left: Path) -> Frame:
        frame = super().frame(left)
        return replace(frame, right=self.right_root / frame.right.relative_to(self.root))


def _pattern(source: str | Path) -> tuple[Path, str]:
    """Resolve a folder or a pattern to an existing folder and a pattern below it."""
    path = Path(source).resolve()
    if path.is_file():
        raise InputError(
            f"{source}: one image, not a folder or a pattern of many: `msnet predict LEFT RIGHT` "
            "matches one pair"
        )
    if not path.is_dir():
        # A folder that exists is meant as it is, even if its name looks like a pattern.
        folder = next(parent for parent in path.parents if parent.is_dir())
        pattern = path.relative_to(folder).as_posix()
        if not _WILDCARD.search(pattern):
            raise FileNotFoundError(f"{source}: no such file, folder or pattern")
        return folder, pattern
    endings = {file.suffix for file in visible(path, "*") if file.suffix.lower() in IMAGE_ENDINGS}
    if len(endings) != 1:
        found = f"images that end in {' and '.join(sorted(endings))}" if endings else "no image"
        raise InputError(f"{source}: {found}; give a pattern such as '{source}/*.png'")
    return path, f"*{endings.pop()}"


def _natural(name: str) -> list[tuple[int, str]]:
    return [
        (int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)
    ]


def read_pairs(
    pairs: Iterable[PairFiles], fps: float = 1.0, *, layout: str | None = None
) -> Generator[StereoFrame]:
    """Read pairs one after the other; what cannot be read becomes a frame with a problem.

    Args:
        pairs: Their files.
        fps: Pairs per second of the stream.
        layout: How both views lie in one file, see `load_pair`.
    """
    for index, files in enumerate(pairs):
        pair, problem = None, ""
        try:
            pair = load_pair(files.left, files.right, layout=layout)
        except (InputError, OSError) as error:
            problem = str(error)
        yield StereoFrame(
            index,
            files.name,
            index / fps,
            pair,
            problem,
            files.calibration,
            to_laser=files.to_laser,
        )
