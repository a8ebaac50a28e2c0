"""Networks with cost volumes: parity with their authors' code, in float64, and counts."""

import numpy as np
import pytest
import torch
from released_weights import OUTPUTS, filled, heads

from mobilestereonet.costs import count_costs
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from parity import pair


@pytest.mark.parametrize(
    ("name", "fields", "size"),
    [
        ("gwcnet-g", {}, (64, 256)),
        ("gwcnet-gc", {}, (64, 256)),
        ("gwcnet-gc-base", {}, (64, 256)),
        ("gcnet", {"max_disparity": 64}, (64, 160)),
        ("ganet-11", {}, (48, 144)),
        ("ganet-deep", {}, (48, 144)),
    ],
)
def test_equals_the_authors_network(name, fields, size):
    found = heads(filled(name, **fields), pair(7, *size).double())[:, ::3, ::3]
    expected = OUTPUTS[name]  # some fixtures have the last head alone
    assert np.abs(found[-len(expected) :] - expected).max() < 1e-6


@pytest.mark.parametrize("name", ["gwcnet-gc", "ganet-11"])
def test_the_last_head_is_the_prediction(name):
    net = filled(name, max_disparity=96)
    views = pair(8, 96, 96).double()
    with torch.inference_mode():
        disparity = net(*views).disparity.numpy()
    assert np.array_equal(disparity, heads(net, views)[-1:])


@pytest.mark.parametrize(
    ("name", "macs", "paper_macs", "params"),
    [
        ("gwcnet-g", 160_014_794_752, 246_268_035_072, 6_518_560),
        ("gwcnet-gc", 174_233_485_312, 260_493_017_088, 6_909_728),
        ("gwcnet-gc-base", 140_410_617_856, 169_421_045_760, 4_628_192),
        ("gcnet", 501_347_254_272, 718_043_316_224, 3_179_553),
        ("psmnet", 184_695_472_128, 256_659_013_504, 5_224_768),
        ("psmnet-basic", 188_772_335_616, 189_355_376_512, 3_672_896),
        ("deeppruner-best", 119_412_981_760, 129_228_177_280, 7_390_142),
        ("deeppruner-fast", 49_262_383_104, 51_832_082_304, 7_469_646),
    ],
)
def test_counts(name, macs, paper_macs, params):
    total = count_costs(name)["total"]
    assert (total.macs, total.paper_macs, total.params) == (macs, paper_macs, params)


@pytest.mark.parametrize(
    ("name", "gmacs", "params"),
    [
        ("ganet-11", 284.561, 4_483_728),
        # The release's 6,580,112 hold a block that is never called.
        ("ganet-deep", 474.635, 6_580_112 - 6_560),
    ],
)
def test_counts_of_ganet_at_288_x_576(name, gmacs, params):
    total = count_costs(name, 48, 96)["total"]  # in proportion to the number of pixels
    assert 36 * total.macs / 1e9 == pytest.approx(gmacs, abs=0.0006)
    assert total.params == params


@pytest.mark.parametrize(
    ("name", "max_disparity", "message"),
    [
        ("gwcnet-gc", 40, "multiple of 16, got 40"),
        ("gcnet", 48, "multiple of 32, got 48"),
        ("ganet-11", 64, "multiple of 12, got 64"),
    ],
)
def test_ranges_are_refused(name, max_disparity, message):
    with pytest.raises(InputError, match=message):
        build_model(name, max_disparity=max_disparity)
