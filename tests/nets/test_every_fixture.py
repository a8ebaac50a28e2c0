"""Parity at the second size of the networks with cost volumes, where the larger fixtures are.

pytest -m exhaustive tests/nets/test_every_fixture.py
"""

import re

import numpy as np
import pytest
import torch
from released_weights import filled

from extras import SHARED, needs_shared
from parity import pair

SECOND = re.compile(r"seed8_h(\d+)_w(\d+)(?:_d(\d+))?(_aligned)?(_every3)?")
FIXTURES = [
    "gwcnet_g",
    "gwcnet_gc",
    "gwcnet_gc_base",
    "gcnet",
    "ganet_11",
    "ganet_deep",
    "psmnet",
    "psmnet_basic",
]


@needs_shared
@pytest.mark.exhaustive
@torch.inference_mode()
@pytest.mark.parametrize("fixture", FIXTURES)
def test_equals_the_authors_network_at_the_second_size(fixture):
    outputs = np.load(SHARED / "parity" / f"{fixture}.npz")
    cases = [match for key in outputs if (match := SECOND.fullmatch(key))]
    assert cases
    for case in cases:
        height, width, reach, aligned, every3 = case.groups()
        fields = {"align_corners": True} if aligned else {}
        net = filled(fixture.replace("_", "-"), max_disparity=int(reach or 192), **fields)
        found = net(*pair(8, int(height), int(width)).double()).disparity[0].numpy()
        found = found[::3, ::3] if every3 else found
        assert np.abs(found - outputs[case.group()]).max() < 1e-6, case.group()
