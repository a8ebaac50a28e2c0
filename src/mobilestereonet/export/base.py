"""Interface of every file format that networks are exported to."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from torch import Tensor

from mobilestereonet.engines.tracing import Size
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import Prediction

if TYPE_CHECKING:
    from mobilestereonet.accelerate.export import ExportableNet

Pair = tuple[Tensor, Tensor]
"""Left and right view, (1, 3, H, W) float32, RGB in 0..1."""

INPUTS = ("left", "right")

Run = Callable[[Tensor, Tensor], Prediction]
"""An exported file in its own runtime: the views of a `Pair` to what it gives for them."""


@dataclass(frozen=True)
class Job:
    """One conversion: what is converted, and how.

    Attributes:
        network: The network, which takes RGB in 0..1.
        size: Height and width that the file takes; None if it takes any.
        precision: One of the format's ``precisions``.
        metadata: What the file says about itself.
        calibration: Pairs that show a quantiser what values to expect; only with "int8".
    """

    network: ExportableNet
    size: Size | None
    precision: str
    metadata: Mapping[str, str]
    calibration: Sequence[Pair] = field(default=())


class Format(ABC):
    """File format that a network can be exported to.

    All files take two inputs, ``left`` and ``right``, RGB in 0..1, and preprocess them themselves.
    They give ``disparity`` and, of a network with scores, ``confidence``, in this order.

    Attributes:
        name: Name on the command line.
        ending: End of its files' names, such as ".onnx".
        extra: The extra of this package that installs what it needs.
        packages: Distributions that it needs.
        precisions: Number formats of its files, the default first.
        dynamic: Whether the files of networks whose graph allows it take any height and width.
        conv3d_as_2d: Whether its runtimes need 3D layers written as 2D layers.
        note: Advice to users of the format, in a line.
    """

    name: ClassVar[str]
    ending: ClassVar[str]
    extra: ClassVar[str]
    packages: ClassVar[tuple[str, ...]]
    precisions: ClassVar[tuple[str, ...]] = ("fp32",)
    dynamic: ClassVar[bool] = False
    conv3d_as_2d: ClassVar[bool] = False
    note: ClassVar[str] = ""

    @abstractmethod
    def write(self, job: Job, path: Path) -> None:
        """Convert the network and write the file, and files beside it if the format has them."""

    @abstractmethod
    def open(self, path: Path) -> Run | None:
        """Load a file into the format's own runtime; None if that does not run here."""

    @abstractmethod
    def read_metadata(self, path: Path) -> dict[str, str]:
        """Texts by key that `describe` gave and the file holds."""

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
