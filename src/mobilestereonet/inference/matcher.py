"""`StereoMatcher`: any rectified pair in, `StereoResult` out."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch

from mobilestereonet.data.rig import Rig
from mobilestereonet.data.sample import Calibration
from mobilestereonet.engines.base import Engine, confidence_fit
from mobilestereonet.errors import InputError
from mobilestereonet.inference.filter import NO_LIMITS, MetricFilter
from mobilestereonet.inference.first_look import findings_of, put_right, warn_of
from mobilestereonet.inference.pair import (
    ImageLike,
    StereoPair,
    load_batch,
    load_pair,
)
from mobilestereonet.inference.predict import Tile, match_pairs
from mobilestereonet.inference.pretrained import misspelt_options, open_model
from mobilestereonet.inference.quality import DEFAULT_QUALITY, Quality, find_quality
from mobilestereonet.inference.rectify import Rectifier
from mobilestereonet.inference.result import StereoResult
from mobilestereonet.inference.run_info import RunInfo
from mobilestereonet.inference.tensor_matcher import TensorMatcher
from mobilestereonet.nets import StereoModel

if TYPE_CHECKING:
    from mobilestereonet.streams.matched import Source, StreamResult

RigLike: TypeAlias = Rig | Calibration | str | Path | Sequence[str | Path]
"""A rig, the calibration of rectified views, or the file or files that describe one."""


def _read_rig(rig: RigLike) -> Rig:
    """Read a rig; what had to be assumed becomes a warning."""
    if isinstance(rig, Rig):
        return rig
    if isinstance(rig, Calibration):
        return Rig((rig,), "the calibration")
    read = Rig.read(rig)
    for note in read.notes:
        warnings.warn(f"{read.name}: {note}", stacklevel=4)
    return read


class StereoMatcher(TensorMatcher):
    """Matches pairs of any size, rectified ones or those of a rig.

    ``matcher(left, right)`` matches one pair of files, arrays, tensors or PIL images, `batch`
    several; `infer` takes and gives tensors. A pair is read and checked once, goes to the engine's
    device, is preprocessed, padded (or cut into tiles), matched and refined there, and comes back
    as arrays once.

    Attributes:
        filter: Which pixels of its results have a depth.
        rectifier: Rectifies pairs of its rig; None without one.
        quality: Name of the quality level that it was made by, see `QUALITIES`; None for others,
            and for levels with other settings than their own.
    """

    filter: MetricFilter = NO_LIMITS
    quality: str | None = None

    def __init__(
        self,
        model: StereoModel | Engine,
        *,
        name: str | None = None,
        engine: str = "torch",
        precision: str = "fp32",
        device: str | torch.device | None = None,
        threads: int | None = None,
        padding: tuple[int, int] | None = None,
        tile: Tile = "auto",
        confidence: bool = False,
        left_right: bool = False,
        refine: bool | None = None,
        scale: float = 1.0,
        rig: RigLike | None = None,
        shift: int = 0,
    ) -> None:
        """Make a matcher of a network or an engine.

        Args:
            model: A network, or an engine, which has its precision, device and threads already.
            name: What results call the model; by default told from the network's config.
            engine: Engine that runs the network: "torch", "onnxruntime" or "openvino".
            precision: "fp32", "bf16", "fp16" (on a GPU), or "auto": bf16 where the engine has it
                and the processor or GPU instructions for it, else fp32.
            device: Device that runs the network, such as "cpu", "cuda:1" or "mps", or "auto": a
                GPU if there is one (see `open_engine`). By default the network's own.
            threads: Threads on a CPU; None leaves them to the engine.
            padding: Height and width to which every pair is padded with zeros, as the authors do;
                by default its border is repeated up to the next size that the engine takes.
            tile: Height and width of the overlapping tiles in which a larger pair is matched,
                margins included; None for one piece at any size. By default `TILE_SIZE`, for pairs
                above `MAX_UNTILED_PIXELS`: in tiles any pair needs what Full HD needs in one
                piece, some 6 GB with msnet3d in fp32, and half of that in bf16.
            confidence: Results have a confidence, at no cost: see `StereoResult`.
            left_right: Results have the right view's disparity and the left-right check, for
                twice the time.
            refine: Refine the disparity by the views, see `inference.refine` and
                `inference.subpixel`, for some percent more time. By default where the network's
                estimator is "mode", as it is with this package's weights, and not with the
                authors'.
            scale: Factor in 0.25..1 of height and width in which a pair is matched: 0.75 takes
                about two thirds of the time; the result has the size of the views.
            rig: Geometry of the cameras: a `Rig`, a `Calibration`, or what `Rig.read` takes. Pairs
                of images are rectified if they are raw, and results have their calibration;
                tensors given to `infer` are not touched.
            shift: Disparity from which the search begins, in px: the right view is moved to the
                right by as much, and the disparities get it back. Above 0 it reaches nearer
                things, below 0 what converging cameras see with negative disparities.

        Raises:
            InputError: If an engine is unknown or not installed, or lacks the precision or the
                device; if both ``padding`` and ``tile`` are given; or if the engine has no
                confidence, which ``confidence`` and ``refine`` need.
        """
        if isinstance(model, str | Path):
            raise InputError(
                f"StereoMatcher takes a network or an engine, got {str(model)!r}: names and files "
                f"go to StereoMatcher.from_pretrained({str(model)!r})"
            )
        super().__init__(
            model,
            name=name,
            engine=engine,
            precision=precision,
            device=device,
            threads=threads,
            padding=padding,
            tile=tile,
            confidence=confidence,
            refine=refine,
            scale=scale,
            shift=shift,
        )
        self.left_right = left_right
        self.rectifier = None if rig is None else Rectifier(_read_rig(rig))

    @classmethod
    def from_pretrained(
        cls,
        source: str | Path | None = None,
        *,
        quality: str | None = None,
        model: str | None = None,
        revision: str | None = None,
        engine: str = "torch",
        precision: str = "fp32",
        device: str | torch.device = "cpu",
        threads: int | None = None,
        padding: tuple[int, int] | None = None,
        tile: Tile = "auto",
        confidence: bool = False,
        left_right: bool = False,
        refine: bool | None = None,
        scale: float | None = None,
        rig: RigLike | None = None,
        shift: int = 0,
        config: Mapping[str, Any] | None = None,
        **overrides: Any,
    ) -> StereoMatcher:
        """Make a matcher with trained weights.

        Args:
            source: What `load_model` takes: the name of a model whose weights come with the
                package, a weights file or folder, or a repository "org/name" of the Hugging Face
                hub. Or a model that needs no network of this package: "sgbm" (OpenCV's semi-global
                matching), "onnx:FILE" (see `OnnxFileEngine`). None: what ``quality`` chooses.
            quality: "fast", "balanced" or "best", see `QUALITIES`: a network with its weights and
                settings. Without a source either it is "balanced".
            model: Name of the network that ``source`` holds, where a file does not tell.
            revision: Branch, tag or commit of a repository.
            engine: See `StereoMatcher`, and so for those that follow.
            precision: Likewise.
            device: Likewise.
            threads: Likewise.
            padding: Likewise.
            tile: Likewise.
            confidence: Likewise.
            left_right: Likewise.
            refine: Likewise.
            scale: Likewise; by default that of the quality.
            rig: See `StereoMatcher`.
            shift: Likewise.
            config: Values of the network's config in place of those of the weights; for "sgbm" its
                ``max_disparity``.
            **overrides: The same as keywords, such as ``estimator="mean"``.

        Raises:
            FileNotFoundError: If there is no such weights file.
            InputError: If a name is unknown, there are no weights for it, or the file is damaged
                or holds another model than ``model``; if both ``source`` and ``quality`` are
                given; or if the engine is not installed, or lacks
                the precision or the device.
        """
        if source is not None and quality is not None:
            raise InputError(
                f"quality={quality!r} chooses a network and its weights, and so does {source}: "
                "leave one of them out"
            )
        if source is None:
            quality = quality or DEFAULT_QUALITY
        level = Quality(str(source)) if quality is None else find_quality(quality)
        with misspelt_options(cls.from_pretrained, overrides):
            opened, options = open_model(
                level.model if source is None else source,
                model=model,
                revision=revision,
                engine=engine,
                precision=precision,
                device=device,
                threads=threads,
                config={**level.config, **(config or {}), **overrides},
            )
        if quality is not None:
            options["name"] = level.model
        matcher = cls(
            opened,
            padding=padding,
            tile=tile,
            confidence=confidence,
            left_right=left_right,
            refine=refine,
            scale=level.scale if scale is None else scale,
            rig=rig,
            shift=shift,
            **options,
        )
        if not (config or overrides or scale is not None):
            matcher.quality = quality
        return matcher

    @property
    def summary(self) -> str:
        """Quality, model, engine and precision in words."""
        model = f"{self.quality} ({self.model})" if self.quality else self.model
        if self._scale != 1:
            model += f" at {self._scale:g} of the size"
        if self.shift:
            model += f" shifted by {self.shift} px"
        return f"{model} on {self.engine.name} {self.engine.precision}"

    def __repr__(self) -> str:
        engine = self.engine
        return f"StereoMatcher({self.model}, {engine.name}, {engine.precision}, {self.device})"

    def __call__(
        self, left: ImageLike, right: ImageLike | None = None, *, look: bool = True
    ) -> StereoResult:
        """Match one pair.

        Args:
            left: Left view: the path of an image; an array (H, W) or (H, W, 1|3|4) in RGB order,
                uint8, uint16 or floating point in 0..1; a tensor (3, H, W) or (1, 3, H, W); or a
                PIL image. At least 2 x 2 pixels.
            right: Right view of the same size, likewise.
            look: Take a first look at the pair, see `first_look`: views that are swapped, turned
                or mirrored are put right. It takes up to 0.3 s: for the frames of one camera look
                at the first one alone.

        Returns:
            The result, in the size of the views; its findings say what the look found, and a
            warning what was put right or leaves no sensible result.

        Raises:
            FileNotFoundError: If a file does not exist.
            InputError: If a view is missing or not as above, or the sizes differ.
        """
        if right is None:
            raise InputError(
                "no right view: one pair is matcher(left, right), several are matcher.batch(pairs)"
            )
        pair = load_pair(left, right)
        if look:
            pair = put_right(
                pair,
                rectifier=self.rectifier,
                max_disparity=self.max_disparity,
                shift=self.shift,
            )
        result = self.match(pair)
        warn_of(result.findings)
        return result

    def match(self, pair: StereoPair) -> StereoResult:
        """Match a pair that `load_pair` has read and checked."""
        return self._match([pair])[0]

    def batch(
        self, pairs: Iterable[tuple[ImageLike, ImageLike] | StereoPair]
    ) -> list[StereoResult]:
        """Match pairs of one size in one run of the engine.

        Args:
            pairs: Left and right views, each as ``matcher(left, right)`` takes it. Two tensors
                (B, 3, H, W) go in as ``zip(left, right)``.

        Returns:
            One result per pair, also for a single one.

        Raises:
            FileNotFoundError: If a file does not exist.
            InputError: If a view is not as it should be, or the sizes differ.
        """
        loaded = load_batch(pairs)
        results = self._match(loaded) if loaded else []
        for result in results:
            warn_of(result.findings)
        return results

    def stream(
        self, source: Source, *, rig: RigLike | None = None, drop: bool = False, **options: Any
    ) -> Iterator[StreamResult]:
        """Match the frames of a video, a camera, a bag or folders; reading and matching overlap.

            for result in matcher.stream("run/left", right="run/right", rig="calib.yaml"):
                print(result.frame.name, result.depth().max())

        A frame that cannot be read or matched is left out with a warning. What the first look at
        the first frame puts right holds for all, and every result has its findings.

        Args:
            source: What `open_stream` takes first (a file, a folder, a bag, a camera), or what it
                gave.
            rig: Geometry of the cameras, see `StereoMatcher`; by default the matcher's, or the one
                that the source knows.
            drop: True plays a recording as fast as it was taken and drops the frames that come
                while another one is matched, as cameras always do. ``frame.index`` tells the gaps.
            **options: Other arguments of `open_stream`, such as ``right`` or ``left_topic``.

        Yields:
            The results, each with its ``frame`` (name, time, stamp, views).

        Raises:
            FileNotFoundError: If a file or a folder does not exist.
            InputError: If the source cannot be opened, or tells that its pictures are rectified
                while the rig is of raw ones.
        """
        # Upward: streams are made of matchers, and a matcher is where users look for them.
        from mobilestereonet.streams.matched import match_stream

        rectifier = self.rectifier if rig is None else Rectifier(_read_rig(rig))
        return match_stream(self, source, rectifier=rectifier, drop=drop, **options)

    def _match(self, pairs: list[StereoPair]) -> list[StereoResult]:
        """Match pairs of one size: to the device, through the engine, and back as arrays."""
        if self.rectifier is not None:
            pairs = [
                pair if pair.calibration is not None else self.rectifier.pair(pair)
                for pair in pairs
            ]
        started = time.perf_counter()
        maps = match_pairs(
            self._predict,
            pairs,
            self.device,
            confidence=self.confidence,
            left_right=self.left_right,
        )
        info = RunInfo(
            model=self.model,
            engine=self.engine.name,
            precision=self.engine.precision,
            device=str(self.device),
            refined=self.refine,
            width=pairs[0].width,
            height=pairs[0].height,
            seconds=(time.perf_counter() - started) / len(pairs),
            quality=self.quality,
            scale=self._scale,
            shift=self.shift,
            confidence_fitted=confidence_fit(self.engine) is not None,
        )
        return [
            StereoResult(
                left=pair.left_image,
                valid=np.isfinite(maps["disparity"][index]),
                filter=self.filter,
                findings=findings_of(pair),
                info=info,
                calibration=pair.calibration,
                **{name: map_[index] for name, map_ in maps.items()},
            )
            for index, pair in enumerate(pairs)
        ]
