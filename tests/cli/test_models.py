import re

import pytest

from mobilestereonet.nets import build_model
from mobilestereonet.weights import shapes


def test_models_are_listed(msnet, monkeypatch):
    built = []

    def count(network, config):
        built.append(config)
        return build_model("msnet2d")

    monkeypatch.setattr(shapes, "_meta_network", count)
    code, out, _ = msnet("models")
    assert code == 0
    assert re.search(r"msnet2d\W+procedural-1, public\W+2\.353", out)
    assert re.search(r"baseline2d\W+", out)
    assert "table3b-v1-v2" in out
    for name, public in (("psmnet", True), ("crl", True), ("dispnet-c", False)):
        assert bool(re.search(rf"│ {name} +│ public +│", out)) == public
    assert len(built) < 30  # each takes a fiftieth of a second


def test_a_pattern_lists_what_matches(msnet):
    code, out, _ = msnet("models", "table3b-v1-*")
    assert code == 0
    assert re.search(r"table3b-v1-v2\W+1\.011", out)
    assert "msnet2d" not in out
    code, _, err = msnet("models", "table9*")
    assert code == 2
    assert "no network's name matches table9*: `msnet models` lists all" in err


@pytest.mark.parametrize("name", ["msnet3d", "msnet3d.procedural-1"])
def test_a_network_is_described(msnet, name):
    code, out, _ = msnet("models", name)
    assert code == 0
    for line in (
        "network: msnet3d",
        "parameters: 1,855,608",
        "embedded weights: msnet3d.procedural-1",
        "  licence: Apache-2.0",
        "  config: estimator=mode, coarse_pass=True, coarse_levels=2",
        "  000046_10 (KITTI 2015): EPE 0.95 px, D1 2.3 %",
    ):
        assert line in out.splitlines()
    assert "cost_volume=groupwise" in out
    assert "WACV 2022" in out


def test_a_network_without_weights_is_described(msnet):
    for name, recipes in (
        ("baseline3d", "paper-sceneflow, paper-kitti2015"),
        ("gwcnet-gc", "gwcnet-sceneflow, gwcnet-kitti2015"),
        ("crl", "none published"),
    ):
        code, out, _ = msnet("models", name)
        assert code == 0
        assert "embedded weights: none" in out.splitlines()
        assert f"recipes: {recipes}" in out.splitlines()


def test_unknown_names(msnet):
    code, out, err = msnet("models", "msnet3d.procedural-7")
    assert (code, out) == (2, "")
    assert "no version 'msnet3d.procedural-7' comes with the package" in err
    code, _, err = msnet("models", "msnet5d")
    assert code == 2
    assert "unknown model 'msnet5d'" in err
