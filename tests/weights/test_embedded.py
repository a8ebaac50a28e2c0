import hashlib
import json
import re

import pytest
import torch

from mobilestereonet import (
    InputError,
    StereoMatcher,
    create_model,
    load_model,
    save_weights,
    versions,
    weights,
)
from mobilestereonet.nets import ConfidenceFit, is_model, model_config


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder in place of the package's."""
    monkeypatch.setattr(versions, "FOLDER", tmp_path)
    return tmp_path


def test_a_name_is_its_newest_version(folder):
    assert weights.embedded_models() == []
    with pytest.raises(InputError, match=r"no weights of 'msnet2d' come .* \(of none, they do\)"):
        load_model("msnet2d")
    tags = [("indoor-9", "2026-01-03", 32), ("outdoor-1", "2026-02-01", 48)]
    tags += [("outdoor-10", "2026-02-01", 64), ("outdoor-9", "2026-02-01", 80)]
    for tag, date, disparities in tags:
        net = create_model("msnet2d", max_disparity=disparities, width=8, hourglasses=1)
        save_weights(net, folder / f"msnet2d.{tag}.safetensors", card={"date": date, "tag": tag})
    assert weights.embedded_models() == ["msnet2d"]
    names = ["msnet2d.indoor-9", "msnet2d.outdoor-1", "msnet2d.outdoor-9", "msnet2d.outdoor-10"]
    assert weights.embedded_versions("msnet2d") == names
    assert weights.card("msnet2d")["tag"] == "outdoor-10"
    assert weights.card("msnet2d.indoor-9")["tag"] == "indoor-9"
    assert load_model("msnet2d").max_disparity == 64
    assert load_model("msnet2d.indoor-9").max_disparity == 32
    assert create_model("msnet2d.outdoor-9", pretrained=True).max_disparity == 80
    for call in (load_model, weights.card, lambda name: create_model(name, pretrained=True)):
        with pytest.raises(InputError, match=r"no version 'msnet2d.outdoor-2' .*: only msnet2d.in"):
            call("msnet2d.outdoor-2")
        with pytest.raises(InputError, match=r"no weights of 'baseline3d' .*\(of msnet2d, they do"):
            call("baseline3d")
        with pytest.raises(InputError, match=r"unknown model 'msnet2'.*msnet2d"):
            call("msnet2")


def test_a_former_version_is_explained(folder):
    (folder / "msnet2d.outdoor-2.safetensors").touch()
    (folder / "msnet2d.outdoor-2.json").write_text("{}")
    rows = {"outdoor-1": {"commit": "0123abc"}, "indoor-1": {}}
    records = {f"msnet2d.{tag}": {"package": "0.1.0", **row} for tag, row in rows.items()}
    (folder / "versions.json").write_text(json.dumps(records))
    told = (
        r"^msnet2d.indoor-1 came with mobilestereonet==0.1.0, and now there is msnet2d.outdoor-2: "
    )
    with pytest.raises(InputError, match=told + "install that one, or pass the file$"):
        load_model("msnet2d.indoor-1")
    with pytest.raises(
        InputError, match=r"git show 0123abc:\S+/weights/msnet2d.outdoor-1.safetensors"
    ):
        StereoMatcher.from_pretrained("msnet2d.outdoor-1")


def test_every_version_is_recorded_with_its_checksum():
    records = versions.recorded_versions()
    for name in versions.packaged_versions():
        checksum = hashlib.sha256(versions.packaged_file(name).read_bytes()).hexdigest()
        assert records.get(name, {}).get("sha256") == checksum, f"{name} in weights/versions.json"
    former = records.keys() - versions.packaged_versions()
    assert all("commit" in records[name] for name in former), "the commit to take them from"
    assert all(re.fullmatch(r"[0-9a-f]{64}", record["sha256"]) for record in records.values())
    assert all(re.fullmatch(r"[\d.]+", record["package"]) for record in records.values())


def test_a_revision_of_embedded_weights_is_a_name():
    with pytest.raises(InputError, match=r"revision='v2' is of the hub.*msnet2d\.procedural-1"):
        load_model("msnet2d", revision="v2")


def test_embedded_weights_are_checked_against_the_model_and_take_other_values():
    with pytest.raises(InputError, match=r"msnet2d: holds msnet2d, not msnet3d"):
        load_model("msnet2d", model="msnet3d")
    assert load_model("msnet2d", model="msnet2d", estimator="mean").config.estimator == "mean"
    with pytest.raises(
        InputError, match=r"guide.weight is unknown, with coarse_pass=False, coarse_levels=1: "
    ):
        load_model("msnet3d", coarse_pass=False, coarse_levels=1)
    with pytest.raises(InputError, match="coarse_levels=2 needs coarse_pass=true"):
        load_model("msnet3d", coarse_pass=False)
    with pytest.raises(InputError, match=r"no value 'estimate'|'estimate'"):
        load_model("msnet2d", estimate="mean")
    with pytest.raises(InputError, match="max_disparity must be a multiple of 16"):
        load_model("msnet2d", max_disparity=33)


def test_a_created_model_is_fresh_unless_pretrained():
    torch.manual_seed(0)
    fresh = create_model("msnet2d", max_disparity=32)
    assert fresh.training
    trained = create_model("msnet2d", pretrained=True, estimator="mean")
    assert not trained.training
    assert trained.config == model_config("msnet2d")
    loaded, created = load_model("msnet2d").state_dict(), trained.state_dict()
    assert all(value.equal(created[name]) for name, value in loaded.items())


@pytest.mark.parametrize("name", weights.embedded_models())
def test_every_version_loads_and_has_a_card(name):
    for version in weights.embedded_versions(name):
        card, net = weights.card(version), load_model(version)
        assert is_model(net.config, name)
        assert f"{card['model']}.{card['version']}" == version
        assert card["licence"] == "Apache-2.0"
        assert net.config == model_config(name, **card["config"])
        preprocessing = card["preprocessing"]
        assert tuple(preprocessing["mean"]) == net.preprocessing.mean
        assert tuple(preprocessing["std"]) == net.preprocessing.std
        assert preprocessing["scale"] == net.preprocessing.scale
        assert net.confidence_fit == ConfidenceFit(**card["confidence"]["fit"])
        assert card["confidence"]["error"] < 0.03 < card["confidence"]["error_before"]
        for row in card["metrics"]["pairs"]:
            assert row["epe_px"] > 0
            assert 0 < row["d1_percent"] < 100


def test_the_fit_of_the_confidence_holds_for_another_search():
    name = "msnet3d-cascade"
    fit = load_model(name).confidence_fit
    for search in ({"coarse_levels": 1}, {"max_disparity": 96}):
        assert load_model(name, **search).confidence_fit == fit
    for other in ({"band": 24}, {"estimator": "mean"}):
        assert load_model(name, **other).confidence_fit is None


@pytest.mark.parametrize("name", weights.embedded_models())
def test_the_chain_of_a_card_leads_to_the_weights(name):
    training = weights.card(name)["training"]
    known = {"fresh", *versions.packaged_versions()} - {f"{name}.procedural-1"}
    for other in weights.embedded_models():  # stages of other cards, such as "13 of msnet3d"
        stages = weights.card(other)["training"]["stages"]
        known |= {f"{stage.get('mean') or stage['run']} of {other}" for stage in stages}
    for stage in training["stages"]:
        parts = stage["of"] if "mean" in stage else {stage["start"]: 1.0}
        if not stage.get("start", "").startswith("msnet"):  # an earlier version of other weights
            assert parts.keys() <= known
        assert sum(parts.values()) == pytest.approx(1)
        known.add(stage.get("mean") or stage["run"])
    assert stage["mean"] == "embedded"
    assert sum(stage.get("steps", 0) for stage in training["stages"]) == training["steps"]
    resolved = training["resolved"]
    (run,) = (stage for stage in training["stages"] if stage.get("run") == resolved["run"])
    recipe = resolved["recipe"]
    assert [recipe["augment"][side] for side in ("height", "width")] == run["crop"]
    assert [recipe["scenes"][side] for side in ("height", "width")] == run["scenes"]
    assert (recipe["steps"], recipe["batch_size"]) == (run["steps"], run["pairs_per_step"])
