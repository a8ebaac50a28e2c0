"""Stereo matching for users: any pair in, `StereoResult` out."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, overload

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.data.images import to_picture
from mobilestereonet.engines.base import Engine
from mobilestereonet.engines.choose import open_engine, open_standalone
from mobilestereonet.engines.threads import use_threads
from mobilestereonet.engines.torch import TorchEngine
from mobilestereonet.errors import InputError
from mobilestereonet.inference.consistency import occluded_pixels
from mobilestereonet.inference.prepare import View, load_pair, pad, unpad
from mobilestereonet.inference.refine import refine_disparity
from mobilestereonet.inference.result import StereoResult
from mobilestereonet.inference.tiling import TILE, WHOLE_PIXELS, match_in_tiles
from mobilestereonet.nets import StereoModel, model_name
from mobilestereonet.weights import load_model

DEFAULT_MODEL = "msnet2d"


class StereoMatcher:
    """Matches rectified pairs of any size: checks, normalises, pads, runs an engine, unpads.

    ``matcher(left, right)`` takes one pair, `batch` takes several, `disparity` takes and gives
    tensors.
    """

    def __init__(
        self,
        engine: StereoModel | Engine,
        *,
        model: str | None = None,
        padding: tuple[int, int] | None = None,
        tile: tuple[int, int] | Literal["auto"] | None = "auto",
        confidence: bool = False,
        left_right: bool = False,
        refine: bool = False,
    ) -> None:
        """Wrap an engine.

        Args:
            engine: A network, which PyTorch runs on the CPU, or a runtime.
            model: What ``facts`` call it; by default told from the network's config.
            padding: Height and width to which every pair is padded with zeros, as the authors do;
                by default its border is repeated up to the next multiples that the engine takes.
            tile: Height and width of the overlapping tiles in which a larger pair is matched,
                margins included; None for one piece at any size. By default `TILE`, for pairs
                above `WHOLE_PIXELS`: in tiles any pair needs what Full HD needs in one piece,
                with msnet2d less than 4 GB.
            confidence: Results have a confidence, at no cost.
            left_right: Results have the right view's disparity and the left-right check, for
                twice the time.
            refine: Refine the disparity by the picture, see `inference.refine`, for some percent
                more time.

        Raises:
            InputError: If both ``padding`` and ``tile`` are given, or the engine tells no
                confidence, which ``confidence`` and ``refine`` need.
        """
        if padding is not None and tile not in ("auto", None):
            raise InputError(f"tiles of {tile} and padding to {padding}: choose one of them")
        if isinstance(engine, StereoModel):
            model = model or model_name(engine.config)
            engine = TorchEngine(engine)
        if (confidence or refine) and not engine.has_confidence:
            raise InputError(
                f"{engine.name} tells no confidence: leave out confidence, min-confidence and "
                "refine; left-right works"
            )
        self.runtime: Engine = engine
        self.model = model or engine.name
        self.padding = padding
        self.tile = tile
        self.confidence = confidence
        self.left_right = left_right
        self.refine = refine

    @classmethod
    def from_pretrained(
        cls,
        model: str | None = None,
        *,
        weights: str | Path | None = None,
        runtime: str = "torch",
        padding: tuple[int, int] | None = None,
        tile: tuple[int, int] | Literal["auto"] | None = "auto",
        confidence: bool = False,
        left_right: bool = False,
        refine: bool | None = None,
        **options: Any,
    ) -> StereoMatcher:
        """Matcher with trained weights.

        Args:
            model: Name of a model whose weights come with the package, or "sgbm" (OpenCV's
                semi-global matching). By default "msnet2d", or what ``weights`` holds.
            weights: File to read instead: ours, or a checkpoint of the authors.
            runtime: Engine that runs the network: "torch", "onnxruntime" or "openvino".
            padding: See `StereoMatcher`.
            tile: Likewise.
            confidence: Likewise.
            left_right: Likewise.
            refine: Likewise; by default where the network's estimator is "mode", as it is with our
                weights, and not with the authors'.
            **options: For the engine: ``precision``, ``threads``, ``device`` and ``cache`` of
                `open_engine`, or ``max_disparity`` of `StereoSGBM`.

        Raises:
            FileNotFoundError: If there is no such weights file.
            InputError: If a name is unknown, there are no weights for it, or the file is damaged
                or holds another model than ``model``; or if the engine is not installed, or lacks
                the precision or the device.
        """
        wanted: dict[str, Any] = {
            "padding": padding,
            "tile": tile,
            "confidence": confidence,
            "left_right": left_right,
        }
        if model is not None and (standalone := open_standalone(model, **options)):
            if weights is not None:
                raise InputError(f"{model} has no weights to read from {weights}: leave them out")
            return cls(standalone, **wanted, refine=bool(refine))
        name, net = pretrained_net(model, weights)
        wanted["refine"] = net.config.estimator == "mode" if refine is None else refine
        return cls(open_engine(runtime, net, **options), model=name, **wanted)

    @overload
    def __call__(self, left: View, right: View) -> StereoResult: ...

    @overload
    def __call__(self, left: Sequence[tuple[View, View]]) -> list[StereoResult]: ...

    def __call__(self, left: Any, right: Any = None) -> Any:
        """Match one pair, or several of one size in one run of the engine.

        Args:
            left: Left view: the path of an image; an array (H, W) or (H, W, 1|3|4) in RGB order,
                uint8, uint16 or floating point in 0..1; or a tensor (3, H, W) or (B, 3, H, W).
                At least 2 x 2 pixels. Or a list of (left, right) pairs of one size.
            right: Right view of the same size, likewise; left out with a list.

        Returns:
            The result, in the size of the views; a list of results, one per pair, for a list of
            pairs and for tensors with B above 1.

        Raises:
            FileNotFoundError: If a file does not exist.
            InputError: If a view is not as above, or the sizes differ.
        """
        if right is None:
            return self.batch(left)
        if all(isinstance(view, Tensor) and view.ndim == 4 for view in (left, right)):
            if len(left) != len(right):
                raise InputError(f"batches of {len(left)} left and {len(right)} right views")
            results = self.batch(zip(left, right, strict=True))
            return results[0] if len(results) == 1 else results
        return self.batch([(left, right)])[0]

    def batch(self, pairs: Iterable[tuple[View, View]]) -> list[StereoResult]:
        """Match pairs of one size in one run of the engine.

        Args:
            pairs: Left and right views, each as ``matcher(left, right)`` takes it. Two tensors
                (B, 3, H, W) go in as ``zip(left, right)``.

        Returns:
            One result per pair.

        Raises:
            FileNotFoundError: If a file does not exist.
            InputError: If a view is not as it should be, or the sizes differ.
        """
        loaded = [load_pair(left, right) for left, right in pairs]
        if not loaded:
            return []
        sizes = {f"{left.shape[-1]}x{left.shape[-2]}" for left, _ in loaded}
        if len(sizes) > 1:
            raise InputError(
                f"a batch needs pairs of one size, got {', '.join(sorted(sizes))}: match them "
                "one by one"
            )
        left, right = (torch.stack(views) for views in zip(*loaded, strict=True))
        started = time.perf_counter()
        disparities, *more = self._maps(left, right, self.confidence).cpu()
        confidences: Sequence[Tensor | None] = more[0].unbind() if more else [None] * len(loaded)
        right_disparities: Sequence[Tensor | None] = [None] * len(loaded)
        if self.left_right:
            right_disparities = self.right_disparity(left, right).cpu().unbind()
        facts = {
            "model": self.model,
            "runtime": self.runtime.name,
            "precision": self.runtime.precision,
            "refined": self.refine,
            "width": left.shape[-1],
            "height": left.shape[-2],
            "seconds": (time.perf_counter() - started) / len(loaded),
        }
        return [
            _result(*maps, dict(facts))
            for maps in zip(left, disparities, confidences, right_disparities, strict=True)
        ]

    def disparity(self, left: Tensor, right: Tensor) -> Tensor:
        """Match a batch of tensors that need no check of their values.

        Args:
            left: Left views, (B, 3, H, W) float, RGB in 0..1.
            right: Right views, the same.

        Returns:
            Disparity of the left views in px, (B, H, W) float32, on the device of ``left``.

        Raises:
            InputError: If the shapes differ, or exceed the ``padding`` of this matcher, or if its
                tiles are too small for their margins.
        """
        return self._maps(left, right)[0]

    def right_disparity(self, left: Tensor, right: Tensor) -> Tensor:
        """Disparity of the right views: both are mirrored, and change places.

        Args:
            left: Left views, (B, 3, H, W) float, RGB in 0..1.
            right: Right views, the same.

        Returns:
            Disparity of the right views in px, (B, H, W) float32: right pixel (x, y) matches left
            pixel (x + disparity, y).

        Raises:
            InputError: As `disparity` does.
        """
        return self.disparity(right.flip(-1), left.flip(-1)).flip(-1)

    def _maps(self, left: Tensor, right: Tensor, confidence: bool = False) -> Tensor:
        """Disparity, and the confidence if it is asked for: (1 or 2, B, H, W)."""
        if left.shape != right.shape or left.ndim != 4 or left.shape[1] != 3:
            raise InputError(
                "left and right must both be (B, 3, H, W), "
                f"got {tuple(left.shape)} and {tuple(right.shape)}"
            )
        match = partial(self._match_whole, confidence=confidence or self.refine)
        tile = self._tile_for(*left.shape[-2:])
        if tile is None:
            maps = match(left, right)
        else:
            maps = match_in_tiles(
                match,
                left,
                right,
                tile=tile,
                max_disparity=self.runtime.max_disparity,
                multiple=self.runtime.size_multiple,
            )
        if not self.refine:
            return maps
        disparity, sure = maps
        with use_threads(getattr(self.runtime, "threads", None)):
            disparity = refine_disparity(disparity, sure, left)
        return torch.stack((disparity, sure)) if confidence else disparity[None]

    def _tile_for(self, height: int, width: int) -> tuple[int, int] | None:
        if self.tile != "auto":
            return self.tile
        return TILE if self.padding is None and height * width > WHOLE_PIXELS else None

    def _match_whole(self, left: Tensor, right: Tensor, *, confidence: bool) -> Tensor:
        height, width = left.shape[-2:]
        padded = self._padded_size(height, width)
        left_view, right_view = (
            pad(self.runtime.preprocessing(view), *padded, zeros=self.padding is not None)
            for view in (left, right)
        )
        found = self.runtime(left_view, right_view, confidence)
        maps = torch.stack([map_ for map_ in found if map_ is not None])
        return unpad(maps, height, width).to(left.device)

    def _padded_size(self, height: int, width: int) -> tuple[int, int]:
        multiple = self.runtime.size_multiple
        if self.padding is None:
            return math.ceil(height / multiple) * multiple, math.ceil(width / multiple) * multiple
        if height > self.padding[0] or width > self.padding[1]:
            raise InputError(
                f"views of {height} x {width} (height x width) are larger than the padding to "
                f"{self.padding[0]} x {self.padding[1]}"
            )
        return self.padding


def _result(
    left: Tensor,
    disparity: Tensor,
    confidence: Tensor | None,
    right_disparity: Tensor | None,
    facts: dict[str, Any],
) -> StereoResult:
    disparities = disparity.contiguous().numpy()
    right = occluded = None
    if right_disparity is not None:
        right = right_disparity.contiguous().numpy()
        occluded = occluded_pixels(disparities, right)
    return StereoResult(
        left=to_picture(left),
        disparity=disparities,
        valid=np.isfinite(disparities),
        confidence=None if confidence is None else confidence.contiguous().numpy(),
        right_disparity=right,
        occluded=occluded,
        facts=facts,
    )


def pretrained_net(model: str | None, weights: str | Path | None) -> tuple[str, StereoModel]:
    """A network with trained weights, and what it is called.

    Args:
        model: Name of a model whose weights come with the package; by default "msnet2d", or what
            ``weights`` holds.
        weights: File to read instead: ours, or a checkpoint of the authors.

    Raises:
        FileNotFoundError: If there is no such weights file.
        InputError: If the name is unknown, there are no weights for it, or the file is damaged,
            holds another model than ``model`` or is the name of one.
    """
    if weights is None:
        model = model or DEFAULT_MODEL
        return model, load_model(model)
    net = load_model(weights, model=model)
    return model or model_name(net.config), net
