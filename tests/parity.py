"""Parity with the authors' networks: weights and pairs by rule, and what the authors' code gave."""

import functools
import zlib
from pathlib import Path

import numpy as np
import torch

from mobilestereonet import create_model
from mobilestereonet.weights.released_names import released_name

REPOSITORY = Path(__file__).parents[1]
# The outputs of the authors' code, in float64, for the weights of `fill` and the pair of `pair`.
OUTPUTS = np.load(REPOSITORY / "tests/data/parity_seed7_h64_w256.npz")
MODELS = {"msnet2d": "msnet2d", "msnet3d": "msnet3d-authors"}
# These random weights amplify rounding: float32 is off by hundredths of a pixel on any machine.
TOLERANCE = {
    ("msnet2d", torch.float64): 1e-6,
    ("msnet3d", torch.float64): 1e-6,
    ("msnet2d", torch.float32): 0.05,
    ("msnet3d", torch.float32): 0.1,
}


def fill(shapes):
    """State dict with one tensor per key, each drawn from a stream seeded by the key's name."""
    state = {}
    for key, shape in shapes.items():
        rng = np.random.RandomState(zlib.crc32(key.encode()))
        if key.endswith("num_batches_tracked"):
            state[key] = torch.zeros(shape, dtype=torch.int64)
            continue
        if key.endswith("running_var"):
            value = rng.uniform(0.5, 1.5, shape)
        elif key.endswith("running_mean"):
            value = 0.1 * rng.standard_normal(shape)
        elif len(shape) == 1 and key.endswith("weight"):
            value = rng.uniform(0.7, 1.3, shape)
        elif len(shape) == 1:
            value = 0.1 * rng.standard_normal(shape)
        else:
            value = np.sqrt(2.0 / np.prod(shape[1:])) * rng.standard_normal(shape)
            if key.startswith("classif") and key.endswith("2.weight"):
                value *= 0.02 if len(shape) == 4 else 0.5  # keeps the softmax from one-hot
        state[key] = torch.as_tensor(value, dtype=torch.float32)
    return state


def pair(seed, height, width):
    views = np.random.RandomState(seed).standard_normal((2, 1, 3, height, width))
    return torch.from_numpy(views.astype(np.float32))


@functools.cache
def authors_state(name):
    network = MODELS[name]
    return fill(
        {released_name(network, k): v.shape for k, v in create_model(network).state_dict().items()}
    )


def largest_error(net, dtype, output, seed):
    left, right = pair(seed, *output.shape).to(dtype)
    with torch.inference_mode():
        disparity = net.to(dtype)(left, right).disparity[0].double().numpy()
    return np.abs(disparity - output).max()
