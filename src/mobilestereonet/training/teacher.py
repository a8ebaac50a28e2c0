"""A trained network that another one learns from."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from mobilestereonet.data.sample import StereoSample
from mobilestereonet.engines.choose import open_engine
from mobilestereonet.engines.network import regress
from mobilestereonet.engines.torch import TorchEngine
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel, VolumeModel
from mobilestereonet.weights import load_model


class Teacher:
    """A trained network as the teacher of another; no module, so that no checkpoint holds it.

    Args:
        weights: Anything that `load_model` takes: the name of embedded weights, a weights file.
        student: The network that learns.

    Raises:
        FileNotFoundError: If there is nothing of that name.
        InputError: If the file holds no weights, or a network whose scores are not of the
            student's kind.
    """

    def __init__(self, weights: str, student: StereoModel) -> None:
        try:
            net = load_model(weights)
        except FileNotFoundError as error:
            raise FileNotFoundError(
                f"teacher {error}: set teacher to one of these, or to where the file is now"
            ) from None
        if not isinstance(net, VolumeModel):
            raise InputError(
                f"teacher {weights} regresses the disparity directly: one with matching scores is "
                "needed, such as msnet3d"
            )
        if net.max_disparity != student.max_disparity:
            raise InputError(
                f"teacher {weights} searches {net.max_disparity} disparities, the network in "
                f"training {student.max_disparity}: set net.max_disparity to the former"
            )
        scale = student.regression.scale if isinstance(student, VolumeModel) else None
        if net.regression.scale != scale:
            raise InputError(
                f"teacher {weights} scores every {net.regression.scale} pixels, the network in "
                f"training every {scale}: choose a teacher of its kind"
            )
        if net.regression.align_corners:
            raise InputError(
                f"teacher {weights} upsamples its scores with aligned corners, and the network in "
                "training with half-pixel centres: choose a teacher of its kind"
            )
        self.net = net
        self._engine: TorchEngine | None = None

    def __call__(self, pairs: StereoSample) -> tuple[Tensor, Tensor, Tensor]:
        """Match a batch on the device on which the first one is.

        Args:
            pairs: Views (B, 3, H, W) in 0..1, H and W multiples of the teacher's ``size_multiple``.

        Returns:
            Scores (B, D, H / s, W / s) in bfloat16 where the device has it, else float32;
            disparity (B, H, W) in px, and its confidence in 0..1.

        Raises:
            InputError: If the shapes do not fit.
        """
        if self._engine is None:
            device = pairs.left.device
            engine = open_engine("torch", self.net, precision="auto", device=device)
            self._engine = cast(TorchEngine, engine)
        views = (self.net.preprocessing(view) for view in (pairs.left, pairs.right))
        # Cloned: tensors of the inference mode must not be part of a gradient.
        scores = self._engine.scores(*views).clone()
        with torch.no_grad():
            found = regress(cast(VolumeModel, self._engine.net), scores, confidence=True)
        return scores, found.disparity, cast(Tensor, found.confidence)
