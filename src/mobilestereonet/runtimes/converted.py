"""What the engines of converted graphs share: the cache of conversions, and the soft-argmax."""

from __future__ import annotations

import copy
import hashlib
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import platformdirs
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet import nets, runtimes
from mobilestereonet.atomic import write_atomically
from mobilestereonet.errors import InputError
from mobilestereonet.nets import SIZE_MULTIPLE, StereoNet
from mobilestereonet.nets.confidence import match_confidence
from mobilestereonet.nets.disparity import regress_disparity
from mobilestereonet.runtimes.graph import narrowest
from mobilestereonet.runtimes.optimise import optimise
from mobilestereonet.runtimes.torch import use_threads

Scores = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]
"""Left and right view (1, 3, H, W) -> scores (1, D, H / 4, W / 4)."""


class ConvertedRuntime(ABC):
    """Runs a network as a converted `Graph`, on the CPU, at any size.

    The engine computes the scores, and PyTorch the soft-argmax, which it does some rows at a
    time: faster than the engines, and without tensors at full resolution. Views narrower than
    `Graph` takes, hardly wider than the disparity range, go through PyTorch altogether.

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
    normalised = True
    multiple = SIZE_MULTIPLE

    def __init__(
        self,
        net: StereoNet,
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
        if threads is not None and threads < 1:
            raise InputError(f"threads must be at least 1, got {threads}")
        self.precision = precision
        self.threads = threads
        self.max_disparity = net.config.max_disparity
        self._net = copy.deepcopy(net).cpu().float().eval()
        self._scores = self._open(_default_cache() if cache is None else Path(cache))

    @classmethod
    def installed(cls) -> bool:
        """Whether the packages that it needs are there."""
        return all(find_spec(package) is not None for package in cls.packages)

    def __call__(self, left: Tensor, right: Tensor) -> Tensor:
        """Match the views, one pair after the other.

        Args:
            left: Left views, (B, 3, H, W), normalised, H and W multiples of 16.
            right: Right views, the same.

        Returns:
            Disparity of the left views in px, (B, H, W) float32, on the device of ``left``.

        Raises:
            InputError: If the shapes do not fit.
        """
        estimator = self._net.config.estimator
        with torch.inference_mode(), use_threads(self.threads):
            maps = [regress_disparity(scores, estimator) for scores in self._each(left, right)]
            return torch.cat(maps).to(left.device)

    def with_confidence(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Match the views, and tell how sure the network is.

        Args:
            left: Left views, (B, 3, H, W), normalised, H and W multiples of 16.
            right: Right views, the same.

        Returns:
            Disparity of the left views in px, and its confidence in 0..1, both (B, H, W) float32
            on the device of ``left``.

        Raises:
            InputError: If the shapes do not fit.
        """
        estimator = self._net.config.estimator
        with torch.inference_mode(), use_threads(self.threads):
            maps = [
                torch.stack(
                    (regress_disparity(scores, estimator), match_confidence(scores, estimator))
                )
                for scores in self._each(left, right)
            ]
            disparity, confidence = torch.cat(maps, dim=1).to(left.device)
            return disparity, confidence

    def _each(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        """Scores (1, D, H / 4, W / 4) of each pair."""
        self._net.check_views(left, right)
        for pair in zip(*(view.float().cpu().split(1) for view in (left, right)), strict=True):
            if left.shape[-1] < narrowest(self._net):
                yield self._narrow_net.scores(*pair)[-1]
            else:
                yield torch.from_numpy(self._scores(*(view.numpy() for view in pair)))

    @cached_property
    def _narrow_net(self) -> StereoNet:
        return optimise(self._net)

    def _open(self, cache: Path) -> Scores:
        path = cache / f"{self.name}-{self._key()}"
        with suppress(OSError):
            checksum, model = _split(path.read_bytes())
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
        for room in (nets, runtimes):
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
    def _convert(self, net: StereoNet) -> bytes:
        """The network in the engine's form."""

    @abstractmethod
    def _load(self, model: bytes) -> Scores:
        """Make the engine ready for what `_convert` gave."""


_KEPT = 8
"""Conversions of an engine that stay in the cache: those of a few networks and precisions."""


def _forget_old(cache: Path, engine: str) -> None:
    files = sorted(cache.glob(f"{engine}-*"), key=lambda file: file.stat().st_mtime)
    for file in files[:-_KEPT]:
        file.unlink()


def _checksum(model: bytes) -> bytes:
    return hashlib.sha256(model).digest()


def _split(content: bytes) -> tuple[bytes, bytes]:
    return content[:32], content[32:]


def _default_cache() -> Path:
    return platformdirs.user_cache_path("mobilestereonet", appauthor=False)
