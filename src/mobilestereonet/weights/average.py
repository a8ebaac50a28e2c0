"""The mean of several weights of one network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel
from mobilestereonet.weights.build import config_differences
from mobilestereonet.weights.load import load_model


def average_weights(paths: Sequence[str | Path], *, model: str | None = None) -> StereoModel:
    """A network with the mean of several weights.

    Where one training went on from the other, the mean is often better than each of them
    (Wortsman et al., "Model soups", ICML 2022). Batch norms' statistics are averaged, too.

    Args:
        paths: Two or more of one network, each as `load_model` takes it.
        model: The network, where the files do not tell, see `load_model`.

    Returns:
        The network, in eval mode, without a fit of the confidence.

    Raises:
        FileNotFoundError: If there is nothing of a name.
        InputError: If there are fewer than two, one is damaged, or they are of different networks.
    """
    if len(paths) < 2:
        raise InputError(
            f"a mean takes two or more weights files or names of embedded weights, got {len(paths)}"
        )
    nets = [load_model(path, model=model) for path in paths]
    for path, net in zip(paths, nets, strict=True):
        if net.config != nets[0].config:
            raise InputError(
                f"{path} holds another network than {paths[0]}: "
                + config_differences(net.config, nets[0].config)
            )
    states = [net.state_dict() for net in nets]
    for name, target in states[0].items():
        if target.is_floating_point():
            target.copy_(torch.stack([state[name].double() for state in states]).mean(dim=0))
    nets[0].confidence_fit = None  # that of other weights
    return nets[0]
