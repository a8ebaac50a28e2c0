"""Parity of PSMNet with its authors' code: expected outputs in float64 for weights made here."""

from pathlib import Path

import numpy as np
import pytest
import torch
from released_weights import filled, heads

from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from parity import pair

# Every third row and column of the outputs for views of 256 x 256 and 64 disparities.
OUTPUTS = np.load(Path(__file__).parents[1] / "data/psmnet_seed7_h256_w256_d64.npz")


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
        disparity = filled(name, max_disparity=64, **fields)(*views()).disparity[0, ::3, ::3]
    assert np.abs(disparity.numpy() - OUTPUTS[expected]).max() < 1e-6


def test_heads_of_training():
    disparities = heads(filled("psmnet", max_disparity=64), views())[:, ::3, ::3]
    assert np.abs(disparities - OUTPUTS["psmnet-heads"]).max() < 1e-6


def test_small_views_and_ranges_are_refused():
    with pytest.raises(InputError, match="at least 256, got 128 x 512"):
        build_model("psmnet", max_disparity=64)(*torch.zeros(2, 1, 3, 128, 512))
    with pytest.raises(InputError, match="multiple of 16, got 40"):
        build_model("psmnet", max_disparity=40)
