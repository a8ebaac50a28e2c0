"""Common base of the engines that convert a network first, with a cache of conversions."""

from __future__ import annotations

import copy
import hashlib
import logging
import threading
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import platformdirs
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.accelerate import accelerate
from mobilestereonet.atomic import write_atomically
from mobilestereonet.engines.network import NetworkEngine, regress
from mobilestereonet.engines.tracing import Size
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import Prediction, StereoModel
from mobilestereonet.nets.volume_model import VolumeModel
from mobilestereonet.timing import long_work

if TYPE_CHECKING:
    from mobilestereonet.accelerate.export import ExportableNet

_LOG = logging.getLogger(__name__)

CONVERSION_VERSION = 5
"""Part of every conversion's key in the cache.

To be raised when the conversion of an unchanged network changes: by `accelerate`'s form for export,
or by an engine's ``_convert``.
"""

Run = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]
"""Left and right view (1, 3, H, W) -> scores (1, D, H / s, W / s), or disparity (1, H, W)."""


class ConvertedEngine(NetworkEngine):
    """Runs a network that was converted for another library, one pair after the other.

    Of a `VolumeModel` the library computes the scores, and PyTorch regresses from them some rows
    at a time: faster, and without tensors at full resolution.

    A network whose graph serves any size is converted once. Others are converted for each size of
    views that comes. Views narrower than the graph takes, hardly wider than the disparity range,
    go through PyTorch altogether.

    Args:
        net: The network, in any mode and on any device; it stays as it is.
        precision: One of `precisions`. Disparities are regressed from scores in float32 always.
        threads: Threads on a CPU; None leaves them to the library.
        device: Where the library computes: "cpu", or as the engine's class says.
        cache: Folder in which conversions are kept; by default in the user's cache folder of the
            platform. One that cannot be written to is left alone. Networks that are defined
            outside of this package are not kept, as their code may change.

    Raises:
        InputError: If the library is missing, or lacks the precision or the device.

    Attributes:
        extra: Extra of this package that installs the library.
        packages: Modules that the engine needs.
        target: The library's name of the device.
    """

    extra: ClassVar[str]
    packages: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        net: StereoModel,
        *,
        precision: str = "fp32",
        threads: int | None = None,
        device: str | torch.device = "cpu",
        cache: str | Path | None = None,
    ) -> None:
        if not self.installed():
            raise InputError(
                f'{self.name} is not installed: pip install "mobilestereonet[{self.extra}]"'
            )
        self.target, results = self.find_device(device)
        if precision not in self.precisions(self.target):
            raise InputError(
                f"{self.name} computes in {' or '.join(self.precisions(self.target))} on "
                f"{self.target}, not in {precision!r}"
            )
        super().__init__(net, precision, threads, results)
        self._net = copy.deepcopy(net).cpu().float().eval()
        self._cache = user_cache() if cache is None else Path(cache)
        network = self._exportable()
        any_size = network.any_size and self._takes_any_size
        self._min_width = network.min_width if any_size else None
        self._graphs: dict[Size | None, Run] = {}
        self._lock = threading.Lock()
        if self._min_width is not None:
            self._graph(None)

    @classmethod
    def installed(cls) -> bool:
        """Whether the modules that the engine needs are there."""
        return all(find_spec(package) is not None for package in cls.packages)

    @classmethod
    @abstractmethod
    def find_device(cls, device: str | torch.device) -> tuple[str, torch.device]:
        """The library's name of a device, and PyTorch's device for results from there.

        Raises:
            InputError: If the library does not have it here; says what it has.
        """

    @classmethod
    @abstractmethod
    def precisions(cls, target: str) -> tuple[str, ...]:
        """Number formats that the library computes in on one of its devices."""

    def _predict(self, left: Tensor, right: Tensor, confidence: bool) -> Iterator[Prediction]:
        if isinstance(self._inference_net, VolumeModel):
            for scores in self._scores(left, right):
                yield regress(self._inference_net, scores, confidence)
        else:
            for disparity in self._run(left, right):
                yield Prediction(disparity)

    def _scores(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        return self._run(left, right)

    def _run(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        """What the graph gives for one pair after the other."""
        self._net.check_views(left, right)
        height, width = left.shape[-2:]
        for pair in zip(*(view.float().cpu().split(1) for view in (left, right)), strict=True):
            if self._min_width is not None and width < self._min_width:
                yield self._run_in_torch(*pair)
            else:
                graph = self._graph((height, width) if self._min_width is None else None)
                result = graph(*(view.contiguous().numpy() for view in pair))
                yield torch.from_numpy(result).to(self.device)

    def _run_in_torch(self, left: Tensor, right: Tensor) -> Tensor:
        left, right = left.to(self.device), right.to(self.device)
        net = self._inference_net
        result = net.scores(left, right) if isinstance(net, VolumeModel) else net(left, right)[0]
        assert isinstance(result, Tensor)
        return result

    @cached_property
    def _inference_net(self) -> StereoModel:
        """The network in PyTorch, for what the graph does not do."""
        net = accelerate(copy.deepcopy(self._net).to(self.device), "inference")
        assert isinstance(net, StereoModel)
        return net

    @property
    def _takes_any_size(self) -> bool:
        """Whether the library runs graphs of variable size on the device."""
        return True

    def _exportable(self) -> ExportableNet:
        return accelerate(self._net, "export", scores=self.has_confidence)

    def _graph(self, size: Size | None) -> Run:
        """The graph for a size, or for any size: from memory, from the cache, or converted."""
        with self._lock:
            if size not in self._graphs:
                self._graphs[size] = self._open(size)
            return self._graphs[size]

    def _open(self, size: Size | None) -> Run:
        path = self._cache / f"{self.name}-{self._key(size)}"
        kept = type(self._net).__module__.startswith("mobilestereonet.")
        with suppress(OSError):
            content = path.read_bytes() if kept else b""
            checksum, model = content[:_CHECKSUM_SIZE], content[_CHECKSUM_SIZE:]
            if checksum == _checksum(model):
                return self._load(model)
        shape = "any size" if size is None else f"{size[0]}x{size[1]}"
        with long_work(_LOG, f"converting the network for {self.name}, {shape}, once"):
            model = self._converted(size)
        if kept:
            with suppress(OSError, InputError):  # a cache that cannot be written is done without
                write_atomically(path, lambda file: file.write_bytes(_checksum(model) + model))
                _forget_old(self._cache, self.name)
        return self._load(model)

    def _converted(self, size: Size | None) -> bytes:
        """The network in the library's form.

        Raises:
            InputError: If the library's converter fails.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the converters' own business
            try:
                return self._convert(self._exportable(), size)
            except Exception as error:
                reason = str(error).strip().split("\n")[0]
                raise InputError(
                    f"{self.name} cannot convert this network: {type(error).__name__}: {reason}: "
                    "use engine torch"
                ) from error

    def _key(self, size: Size | None) -> str:
        """Digest of all that a conversion depends on."""
        network = type(self._net)
        facts = (
            CONVERSION_VERSION,
            f"{network.__module__}.{network.__qualname__}",
            self._net.config,
            self.precision,
            self.target,
            size,
            self._machine(),
            [import_module(name).__version__ for name in ("torch", *self.packages)],
        )
        digest = hashlib.sha256(repr(facts).encode())
        for name, tensor in self._net.state_dict().items():
            digest.update(name.encode())
            digest.update(tensor.reshape(-1).view(torch.uint8).numpy())
        return digest.hexdigest()[:32]

    def _machine(self) -> object:
        """What a conversion depends on of the machine."""
        return None

    @abstractmethod
    def _convert(self, network: ExportableNet, size: Size | None) -> bytes:
        """The network in the library's form, for a size, or for any if it is None."""

    @abstractmethod
    def _load(self, model: bytes) -> Run:
        """Make the library ready to run what `_convert` gave."""


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
