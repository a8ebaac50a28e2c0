"""Networks with the weights that their parity fixtures were made with."""

import re

import numpy as np
import torch

from mobilestereonet.nets import build_model
from mobilestereonet.weights.released_names import released_name
from parity import REPOSITORY, fill

OUTPUTS = np.load(REPOSITORY / "tests/data/peers_every3.npz")
"""Every third row and column of what the authors' code gave, for all heads of training."""

_RESIDUALS = (r"layer\d+\.\d+\.conv2\.1\.(weight|bias)$", 0.2)
_REDUCED = (r"lastconv\.2\.weight$", 0.1)
_GWCNET = [_RESIDUALS, (r"^classif\d\.2\.weight$", 0.1)]
_GANET = [(r"conv32x1\.weight$", 100.0)]
FACTORS = {
    "psmnet": [_RESIDUALS, _REDUCED],
    "psmnet-basic": [_RESIDUALS, _REDUCED, (r"^dres[1-4]\.2\.1\.(weight|bias)$", 0.5)],
    "gwcnet-g": _GWCNET,
    "gwcnet-gc": _GWCNET,
    "gwcnet-gc-base": _GWCNET,
    "gcnet": [
        (r"^res_block\.\d+\.bn2\.(weight|bias)$", 0.2),
        (r"^conv1\.weight$", 0.5),
        (r"^deconv5\.weight$", 0.3),
    ],
    "ganet-11": _GANET,
    "ganet-deep": _GANET,
}
"""Factors of the drawn weights, by the released names, that keep the softmax soft."""


def released_state(name):
    """State dict of a network as its authors' checkpoints hold it."""
    own = build_model(name).state_dict()
    state = fill({released_name(name, key): value.shape for key, value in own.items()})
    for key in state:
        for pattern, factor in FACTORS[name]:
            if re.search(pattern, key):
                state[key] = state[key] * factor
        if name.startswith("ganet") and key == "guidance.weight_lg2.1.weight":
            state[key] = state[key].abs()
    return state


def filled(name, **fields):
    """The network with this state, in float64 and eval mode."""
    net, state = build_model(name, **fields), released_state(name)
    net.load_state_dict({key: state[released_name(name, key)] for key in net.state_dict()})
    return net.double().eval()


def heads(net, views):
    """Disparities (H, W) of all heads of training, batch norms being in eval mode."""
    net.training = True
    with torch.inference_mode():
        outputs = net(*views)
    net.training = False
    return torch.cat(outputs.disparities).numpy()
