"""NumPy archives: the released weights of Fast DS-CS (``bn600k.npz``)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.errors import InputError
from mobilestereonet.nets.fast_ds_cs import EPSILON
from mobilestereonet.weights.files import WeightsFile
from mobilestereonet.weights.names import substituted
from mobilestereonet.weights.shapes import registered_shapes

NETWORK = "fast-ds-cs"
_RULES = (
    (r"^encode\.(\d)", r"enc\1"),
    (r"^combine\.0", "cenc"),
    (r"^combine\.(\d)", r"cenc\1"),
    (r"^unet\.down\.(\d)\.0", lambda match: f"u1u1_{5 - int(match[1])}"),
    (r"^unet\.down\.(\d)\.1", lambda match: f"u2_{5 - int(match[1])}"),
    (r"^unet\.grow\.(\d)", lambda match: f"u1u3_{2 + int(match[1])}"),
    (r"^unet\.up\.(\d)\.0", lambda match: f"u4_{2 + int(match[1])}"),
    (r"^unet\.up\.(\d)\.1", lambda match: f"u1u5_{2 + int(match[1])}"),
    (r"(\.\d)?\.weight$", "_w"),
    (r"(\.\d)?\.bias$", "_b"),
)


def read_numpy_file(path: Path) -> WeightsFile:
    """Read the released weights of Fast DS-CS.

    Raises:
        InputError: If the file is no NumPy archive, or holds something else.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: torch.from_numpy(archive[name]) for name in archive.files}
    except Exception as error:  # whatever an unpacker makes of any bytes
        raise InputError(f"{path}: not a readable NumPy archive: {error}") from error
    shapes = registered_shapes(NETWORK)
    missing = [
        released for key in shapes if (released := released_array(key)) not in {None, *arrays}
    ]
    if missing:
        raise InputError(
            f"{path}: not the released weights of {NETWORK}, the one network that is read from "
            f"NumPy archives: {missing[0]} is missing"
        )
    try:
        state = {key: tensor(key, arrays) for key in shapes}
    except RuntimeError as error:  # an array of other dimensions
        raise InputError(f"{path}: not the released weights of {NETWORK}: {error}") from None
    return WeightsFile(str(path), state, NETWORK)


def released_array(name: str) -> str | None:
    """What the release calls a tensor of ours; None for statistics, which it has folded in."""
    if ".running_" in name:
        return None
    return substituted(name, _RULES)


def tensor(name: str, arrays: dict[str, Tensor]) -> Tensor:
    """A tensor of ours from the release's arrays.

    The release has kernels as (height, width, inputs, outputs), adds each bias twice, and numbers
    the channels of its depth to space as TensorFlow does.
    """
    released = released_array(name)
    if released is None:
        layer = re.sub(r"1\.running_\w+$", "2.bias", name)
        zeros = torch.zeros(len(tensor(layer, arrays)), dtype=torch.float64)
        # Norms that do nothing: with their epsilon the variance is 1.
        return zeros + 1 - EPSILON if name.endswith("running_var") else zeros
    value = arrays[released]
    value = value.permute(3, 2, 0, 1) if name.endswith("weight") else 2 * value
    if name.startswith("unet.grow."):
        value = value.unflatten(0, (4, -1)).transpose(0, 1).flatten(0, 1)
    return value.contiguous()
