"""Parity of PSMNet with its authors' code: expected outputs in float64 for weights made here."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from parity import fill, pair

# Every third row and column of the outputs for views of 256 x 256 and 64 disparities.
OUTPUTS = np.load(Path(__file__).parents[1] / "data/psmnet_seed7_h256_w256_d64.npz")

# Our names, and those of the authors' release by which the weights are drawn.
RULES = [
    (r"features\.trunk\.first\.(\d)", lambda n: f"feature_extraction.firstconv.{2 * n}"),
    (r"features\.trunk\.stage(\d)", lambda n: f"feature_extraction.layer{n}"),
    (r"features\.branches\.(\d)", lambda n: f"feature_extraction.branch{4 - n}.1"),
    (r"features\.fusion\.(\d)", lambda n: f"feature_extraction.lastconv.{2 * n}"),
    (r"pre_hourglass\.first\.(\d)", lambda n: f"dres0.{2 * n}"),
    (r"pre_hourglass\.second\.(\d)", lambda n: f"dres1.{2 * n}"),
    (r"hourglasses\.(\d)", lambda n: f"dres{n + 2}"),
    (r"heads\.(\d)", lambda n: f"classif{n + 1}"),
    (r"blocks\.(\d)\.0", lambda n: f"dres{n + 2}.0"),
    (r"blocks\.(\d)\.1", lambda n: f"dres{n + 2}.2"),
    (r"head(?!s)()", lambda n: "classify"),
]


def released_key(key):
    for pattern, name in RULES:
        if match := re.match(pattern, key):
            number = int(match[1]) if match[1] else 0
            key = name(number) + key[match.end() :]
            break
    key = re.sub(r"(layer\d\.\d+\.conv1)\.", r"\1.0.", key)
    key = re.sub(r"(dres\d\.conv[134])\.", r"\1.0.", key)
    key = re.sub(r"\.up(\d)\.", r".conv\1.", key)
    return re.sub(r"(classif\w+)\.conv\.", r"\1.0.", key).replace(".score.", ".2.")


FACTORS = [
    (r"layer\d+\.\d+\.conv2\.1\.(weight|bias)$", 0.2),
    (r"lastconv\.2\.weight$", 0.1),
]
"""Factors of the drawn weights that keep the softmax soft, by the released names."""

BASIC_FACTORS = [(r"^dres[1-4]\.2\.1\.(weight|bias)$", 0.5)]


def network(name, **fields):
    net = build_model(name, max_disparity=64, **fields)
    own = net.state_dict()
    state = fill({released_key(key): value.shape for key, value in own.items()})
    for key, value in state.items():
        for pattern, factor in FACTORS + BASIC_FACTORS * (name == "psmnet-basic"):
            if re.search(pattern, key):
                value *= factor
    net.load_state_dict({key: state[released_key(key)] for key in own})
    return net.double().eval()


def views():
    return pair(7, 256, 256).double()


@pytest.mark.parametrize(
    ("name", "fields", "expected"),
    [
        ("psmnet", {}, "psmnet"),
        ("psmnet", {"align_corners": True}, "psmnet-aligned"),
        ("psmnet-basic", {}, "psmnet-basic"),
    ],
)
def test_equals_the_authors_network(name, fields, expected):
    with torch.inference_mode():
        disparity = network(name, **fields)(*views()).disparity[0, ::3, ::3]
    assert np.abs(disparity.numpy() - OUTPUTS[expected]).max() < 1e-6


def test_heads_of_training():
    net = network("psmnet")
    net.training = True  # the heads alone: batch norms stay in eval mode
    with torch.inference_mode():
        disparities = torch.cat(net(*views()).disparities)[:, ::3, ::3]
    assert np.abs(disparities.numpy() - OUTPUTS["psmnet-heads"]).max() < 1e-6


def test_small_views_and_ranges_are_refused():
    with pytest.raises(InputError, match="at least 256, got 128 x 512"):
        build_model("psmnet", max_disparity=64)(*torch.zeros(2, 1, 3, 128, 512))
    with pytest.raises(InputError, match="multiple of 16, got 40"):
        build_model("psmnet", max_disparity=40)
