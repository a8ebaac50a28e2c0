"""What the engines of converted graphs share: the cache of conversions."""

from __future__ import annotations

import copy
import hashlib
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, cast

import platformdirs
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet import accelerate, engines, nets
from mobilestereonet.accelerate.inference import inference_form
from mobilestereonet.atomic import write_atomically
from mobilestereonet.engines.scores import ScoresRuntime
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel, VolumeModel

Scores = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]
"""Left and right view (1, 3, H, W) -> scores (1, D, H / 4, W / 4)."""


class ConvertedRuntime(ScoresRuntime):
    """Runs a network as a converted `ExportableNet`, on the CPU, at any size.

    The engine computes the scores, and PyTorch the soft-argmax, which it does some rows at a
    time: faster than the engines, and without tensors at full resolution. Views narrower than
    `ExportableNet` takes, hardly wider than the disparity range, go through PyTorch altogether.

    Attributes:
        name: What the command line calls the engine, and its package.
        extra: The extra of this package that installs it.
        packages: What it needs, by the names of their modules.
        precisions: What it can compute in.
    """

    name: ClassVar[str]
    extra: ClassVar[str]
    packages: ClassVar[tuple[str, ...]]
    precisions: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        net: StereoModel,
        *,
        precision: str = "fp32",
        threads: int | None = None,
        cache: str | Path | None = None,
    ) -> None:
        """Convert the network, or load what an earlier conversion left in the cache.

        Args:
            net: The network, with any weights, in any mode.
            precision: One of ``precisions``. The soft-argmax is computed in float32 always.
            threads: Threads; None leaves it to the engine.
            cache: Folder in which conversions are kept; by default in the user's cache folder of
                the platform. One that cannot be written to is left alone.

        Raises:
            InputError: If the engine's package is missing, it lacks the precision, or ``threads``
                is below 1.
        """
        if not self.installed():
            raise InputError(
                f'{self.name} is not installed: pip install "mobilestereonet[{self.extra}]"'
            )
        if precision not in self.precisions:
            raise InputError(
                f"{self.name} computes in {' or '.join(self.precisions)}, not in {precision!r}"
            )
        super().__init__(cast(VolumeModel, net), precision, threads)
        self._net = copy.deepcopy(net).cpu().float().eval()
        self._run = self._open(user_cache() if cache is None else Path(cache))

    @classmethod
    def installed(cls) -> bool:
        """Whether the packages that it needs are there."""
        return all(find_spec(package) is not None for package in cls.packages)

    def _scores(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        """Scores of one pair after the other."""
        self._net.check_views(left, right)
        for pair in zip(*(view.float().cpu().split(1) for view in (left, right)), strict=True):
            if left.shape[-1] < self._net.max_disparity + self._net.size_multiple:
                yield cast(VolumeModel, self._narrow_net).scores(*pair)
            else:
                yield torch.from_numpy(self._run(*(view.numpy() for view in pair)))

    @cached_property
    def _narrow_net(self) -> StereoModel:
        return inference_form(self._net)

    def _open(self, cache: Path) -> Scores:
        path = cache / f"{self.name}-{self._key()}"
        with suppress(OSError):
            content = path.read_bytes()
            checksum, model = content[:_CHECKSUM_SIZE], content[_CHECKSUM_SIZE:]
            if checksum == _checksum(model):
                return self._load(model)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the converters' own business
            model = self._convert(self._net)
        with suppress(OSError):
            write_atomically(path, lambda file: file.write_bytes(_checksum(model) + model))
            _forget_old(cache, self.name)
        return self._load(model)

    def _key(self) -> str:
        """Tells all that a conversion depends on: weights, code, versions, precision, machine."""
        versions = [import_module(name).__version__ for name in ("torch", *self.packages)]
        facts = (self._net.config, self.precision, self._machine(), versions)
        digest = hashlib.sha256(repr(facts).encode())
        for room in (nets, accelerate, engines):
            for path in sorted(Path(room.__path__[0]).glob("*.py")):
                digest.update(path.read_bytes())
        for name, tensor in self._net.state_dict().items():
            digest.update(name.encode())
            digest.update(tensor.cpu().reshape(-1).view(torch.uint8).numpy())
        return digest.hexdigest()[:32]

    def _machine(self) -> object:
        """What a conversion depends on of the machine."""
        return None

    @abstractmethod
    def _convert(self, net: StereoModel) -> bytes:
        """The network in the engine's form."""

    @abstractmethod
    def _load(self, model: bytes) -> Scores:
        """Make the engine ready for what `_convert` gave."""


def user_cache() -> Path:
    """This package's folder in the user's cache folder of the platform."""
    return platformdirs.user_cache_path("mobilestereonet", appauthor=False)


_KEPT = 8
"""Conversions of an engine that stay in the cache: those of a few networks and precisions."""


def _forget_old(cache: Path, engine: str) -> None:
    files = sorted(cache.glob(f"{engine}-*"), key=lambda file: file.stat().st_mtime)
    for file in files[:-_KEPT]:
        file.unlink()


_CHECKSUM_SIZE = hashlib.sha256().digest_size


def _checksum(model: bytes) -> bytes:
    return hashlib.sha256(model).digest()
