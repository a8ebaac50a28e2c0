"""A trained network that another one learns from."""

from __future__ import annotations

from typing import Any, cast

import torch
from torch import Tensor

from mobilestereonet.accelerate.soft_argmax import ClosedFormSoftArgmax
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.engines.choose import open_engine
from mobilestereonet.engines.network import NetworkEngine
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import IMAGENET, VolumeModel
from mobilestereonet.weights import load_model


class Teacher:
    """Matches pairs for another network; no module, so that no checkpoint of that one holds it.

    Args:
        weights: The name of embedded weights, or a weights file.
        student: Config of the network that learns.

    Raises:
        FileNotFoundError: If there are neither such embedded weights nor such a file.
        InputError: If the file holds no weights, or those of a network that searches other
            disparities than the student.
    """

    def __init__(self, weights: str, student: Any) -> None:
        try:
            self.net = load_model(weights)
        except FileNotFoundError as error:
            raise FileNotFoundError(
                f"teacher {error}: set teacher to one of these, or to where the file is now"
            ) from None
        if self.net.config.max_disparity != student.max_disparity:
            raise InputError(
                f"teacher {weights} searches {self.net.config.max_disparity} disparities, the "
                f"network in training {student.max_disparity}: set max_disparity to the former"
            )
        self._runtime: NetworkEngine | None = None

    def __call__(self, pairs: StereoSample) -> tuple[Tensor, Tensor, Tensor]:
        """Match a batch on the device on which the first one is.

        Args:
            pairs: Views (B, 3, H, W) in 0..1, H and W multiples of 16.

        Returns:
            Scores (B, D, H / 4, W / 4) in bfloat16 where the device has it, else float32;
            disparity (B, H, W) in px, and its confidence in 0..1.

        Raises:
            InputError: If the shapes do not fit, or the device is neither a CPU nor CUDA's.
        """
        if self._runtime is None:
            device = pairs.left.device
            self._runtime = open_engine("torch", self.net, precision="auto", device=device)
        scores = self._runtime.scores(IMAGENET(pairs.left), IMAGENET(pairs.right))
        # Tensors of the inference mode must not be part of a gradient.
        scores = scores.clone()
        regression = ClosedFormSoftArgmax(cast(VolumeModel, self.net).regression)
        with torch.no_grad():
            return scores, regression(scores), regression.confidence(scores)
