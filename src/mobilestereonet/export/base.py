"""What every file format must be able to do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import ClassVar

from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel

Pair = tuple[Tensor, Tensor]
"""Left and right view, (1, 3, H, W) float32, RGB in 0..1."""

INPUTS = ("left", "right")
OUTPUT = "disparity"

Run = Callable[[Tensor, Tensor], Tensor]
"""An exported file in its own runtime: the views of a `Pair` to disparity (1, H, W) in px."""


@dataclass(frozen=True)
class Job:
    """What to convert, and how.

    Attributes:
        net: The network, in eval mode.
        size: Height and width that a file of fixed size takes; others are traced with it.
        precision: One of the format's ``precisions``.
        metadata: What the file says about itself.
        calibration: Pairs that show a quantiser what values to expect; only with "int8".
    """

    net: StereoModel
    size: tuple[int, int]
    precision: str
    metadata: Mapping[str, str]
    calibration: Sequence[Pair] = field(default=())


class Format(ABC):
    """A file format that a network can be exported to.

    All files take two inputs, ``left`` and ``right``, RGB in 0..1, and normalise them themselves.

    Attributes:
        name: What the command line calls it.
        ending: How its files end.
        extra: The extra of this package that installs what it needs.
        packages: What it needs, by the names of the package registry.
        precisions: What it can be asked for, the default first.
        dynamic: Whether the files take any height and width.
        note: What a user of the format should know, in a line.
    """

    name: ClassVar[str]
    ending: ClassVar[str]
    extra: ClassVar[str]
    packages: ClassVar[tuple[str, ...]]
    precisions: ClassVar[tuple[str, ...]] = ("fp32",)
    dynamic: ClassVar[bool] = False
    note: ClassVar[str] = ""

    @abstractmethod
    def write(self, job: Job, path: Path) -> None:
        """Convert the network and write the file, and files beside it if the format has them."""

    @abstractmethod
    def open(self, path: Path) -> Run | None:
        """Load a file into the format's own runtime; None if that does not run here."""

    @abstractmethod
    def read_metadata(self, path: Path) -> dict[str, str]:
        """What a file says about itself."""

    def versions(self, precision: str = "fp32") -> dict[str, str | None]:
        """Installed versions of what a precision needs; None where a package is missing."""
        quantiser = ("nncf",) if precision == "int8" else ()
        return {name: _version(name) for name in (*self.packages, *quantiser)}

    def check(self, precision: str) -> None:
        """Check that the format can be made here.

        Raises:
            InputError: If the precision is unknown, or a package is missing.
        """
        if precision not in self.precisions:
            raise InputError(
                f"{self.name} has no precision {precision!r}, only {', '.join(self.precisions)}"
            )
        missing = [name for name, found in self.versions(precision).items() if found is None]
        if missing:
            extras = f"{self.extra},int8" if precision == "int8" else self.extra
            raise InputError(
                f"{self.name} ({precision}) needs {', '.join(missing)}: "
                f'pip install "mobilestereonet[{extras}]"'
            )


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
