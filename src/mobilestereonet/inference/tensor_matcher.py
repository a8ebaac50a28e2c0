"""`TensorMatcher`: rectified views as tensors in, disparity out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from mobilestereonet.accelerate.modules import device_of
from mobilestereonet.engines.base import Engine, confidence_fit
from mobilestereonet.engines.choose import open_engine
from mobilestereonet.engines.scaled import ScaledEngine, check_scale
from mobilestereonet.errors import InputError
from mobilestereonet.inference.pair import check_tensors
from mobilestereonet.inference.predict import Tile, predict_disparity, shifted
from mobilestereonet.nets import StereoModel, VolumeModel, model_name
from mobilestereonet.nets.model import Prediction

if TYPE_CHECKING:
    from typing_extensions import Self


class TensorMatcher:
    """Matches batches of rectified views that are tensors: a network or engine and its settings.

    Views go to the engine's device, and are preprocessed, padded (or cut into tiles), matched and
    refined there. The arguments are those of `StereoMatcher`, which makes results of pairs by it.

    Attributes:
        engine: Engine that computes the disparity; it has the name, precision and device.
        model: Name of the model.
        confidence: Whether a confidence is asked for, see `StereoMatcher`.
        padding: Height and width to which views are padded with zeros; None if they are not.
        tile: Height and width of the tiles in which larger views are matched, or "auto".
        refine: Whether the disparity is refined.
        shift: Disparity from which the search begins, in px.
    """

    engine: Engine

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
        refine: bool | None = None,
        scale: float = 1.0,
        shift: int = 0,
    ) -> None:
        if isinstance(scale, bool) or not isinstance(scale, int | float):
            raise InputError(f"scale must be a number in 0.25..1, got {scale!r}")
        check_scale(scale)
        if isinstance(shift, bool) or not isinstance(shift, int):
            raise InputError(f"shift must be a whole number of pixels, got {shift!r}")
        if padding is not None and scale != 1:
            raise InputError(
                f"padding to {padding} and a scale of {scale}: choose one of them (the quality "
                "fast has a scale)"
            )
        for what, size in (("padding", padding), ("tile", tile)):
            if size not in ("auto", None) and not (isinstance(size, Sequence) and len(size) == 2):
                raise InputError(f"{what} must be (height, width), got {size!r}")
        if padding is not None and tile not in ("auto", None):
            raise InputError(f"tiles of {tile} and padding to {padding}: choose one of them")
        self._scale = scale
        self.shift = shift
        self._net = model if isinstance(model, StereoModel) else None
        self._options: dict[str, Any] = {"precision": precision, "threads": threads}
        if isinstance(model, StereoModel):
            name = name or model_name(model.config)
            self._options["name"] = engine
            self.to(device_of(model) if device is None else device)
        elif (engine, precision, device, threads) != ("torch", "fp32", None, None):
            raise InputError(
                f"{model.name} is an engine already: choose its precision, device and threads "
                "where it is made"
            )
        else:
            self.engine = self._scaled(model)
        if refine is None:
            refine = isinstance(model, VolumeModel) and model.regression.estimator == "mode"
        if (confidence or refine) and not self.engine.has_confidence:
            what = type(model).__name__ if self._net is not None else name or self.engine.name
            raise InputError(
                f"{what} has no confidence: leave out confidence, "
                "min-confidence and refine; left-right works"
            )
        self.model = name or str(getattr(self.engine, "model", self.engine.name))
        self.confidence = confidence
        self.padding = padding
        self.tile = tile
        self.refine = refine

    def to(self, device: str | torch.device) -> Self:
        """Move the matcher to a device: the engine is made anew there from the network.

        Args:
            device: Such as "cpu", "cuda:1", "mps" or a `torch.device`; "auto" is a GPU if there
                is one.

        Returns:
            The matcher itself.

        Raises:
            InputError: If there is no such device, the engine does not run there, or the matcher
                was made of an engine instead of a network.
        """
        if self._net is None:
            raise InputError(
                f"{self.engine.name} was given as an engine on {self.device}: make it on {device}"
            )
        self.engine = self._scaled(open_engine(net=self._net, device=device, **self._options))
        return self

    def _scaled(self, engine: Engine) -> Engine:
        return engine if self._scale == 1 else ScaledEngine(engine, self._scale)

    @property
    def max_disparity(self) -> int:
        """Disparities from ``shift`` on and below this are searched, in px."""
        return self.engine.max_disparity + self.shift

    @property
    def device(self) -> torch.device:
        """Device that the engine runs on."""
        return self.engine.device

    def infer(self, left: Tensor, right: Tensor) -> Prediction:
        """Match a batch of tensors; the values are not checked.

        Args:
            left: Left views, (B, 3, H, W), RGB in 0..1, on any device.
            right: Right views, likewise.

        Returns:
            Disparity of the left views in px, (B, H, W) float32, and its confidence in 0..1,
            likewise, or None where the engine has none; on the device of ``left``.

        Raises:
            InputError: If the shapes differ, or exceed the ``padding`` of this matcher, or if its
                tiles are too small for their margins.
        """
        return self._infer(left, right, self.engine.has_confidence)

    def disparity(self, left: Tensor, right: Tensor) -> Tensor:
        """Disparity alone of `infer`, a function as the evaluation takes it."""
        return self._infer(left, right, False).disparity

    def _infer(self, left: Tensor, right: Tensor, confidence: bool) -> Prediction:
        check_tensors(left, right)
        views = (view.to(self.device, torch.float32) for view in (left, right))
        with torch.inference_mode():
            maps = self._predict(next(views), next(views), confidence)
        # Copies: what was made in inference mode cannot take part in training.
        disparity, *more = (map_.to(left.device).clone() for map_ in maps if map_ is not None)
        return Prediction(disparity, *more)

    def _predict(self, left: Tensor, right: Tensor, confidence: bool) -> Prediction:
        disparity, sure = predict_disparity(
            self.engine,
            left,
            shifted(right, self.shift),
            padding=self.padding,
            tile=self.tile,
            refine=self.refine,
            confidence=confidence,
        )
        fit = confidence_fit(self.engine)
        if sure is not None and fit is not None:
            sure = fit(sure)
        return Prediction(disparity + self.shift, sure)
