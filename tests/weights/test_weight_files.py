import json
import re

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import load, load_file, save_file

from mobilestereonet import InputError, create_model, load_model, save_weights
from mobilestereonet.nets import build_model

SMALL = {"max_disparity": 32, "hourglasses": 1, "width": 8}


@pytest.fixture(scope="module")
def net():
    """A small network whose batch norm variances leave the range of half precision."""
    torch.manual_seed(0)
    net = create_model("msnet2d", **SMALL)
    for name, buffer in net.named_buffers():
        if name.endswith("running_var"):
            buffer.copy_(10 ** torch.linspace(-9, 6, len(buffer)))
        elif name.endswith("running_mean"):
            buffer.normal_()
    return net


def test_a_saved_network_is_the_same_when_loaded(net, tmp_path):
    path = tmp_path / "new" / "net.safetensors"
    save_weights(net, path)
    loaded = load_model(path)
    assert loaded.config == net.config
    assert not loaded.training
    saved, own = loaded.state_dict(), net.state_dict()
    assert saved.keys() == own.keys()
    for name, value in own.items():
        assert saved[name].equal(value), name
    assert list(path.parent.iterdir()) == [path]


BLOCKS = st.sampled_from(["conv", "v1", "v2"])
CONFIGS = st.fixed_dictionaries(
    {
        "dims": st.sampled_from([2, 3]),
        "features": BLOCKS,
        "hourglass": BLOCKS,
        "hourglasses": st.integers(1, 2),
        "width": st.sampled_from([8, 16]),
        "cost_volume": st.sampled_from(["interlaced-2", "correlation", "groupwise"]),
        "groups": st.just(8),
        "max_disparity": st.sampled_from([32, 64]),
        "estimator": st.sampled_from(["mean", "mode"]),
    }
)


@given(config=CONFIGS, dtype=st.sampled_from([torch.float32, torch.float64, torch.bfloat16]))
@settings(max_examples=10, deadline=None)
def test_any_config_comes_back_with_every_value(config, dtype, tmp_path_factory):
    path = tmp_path_factory.mktemp("any") / "net.safetensors"
    net = build_model("msnet2d", **config).to(dtype)
    save_weights(net, path)
    loaded = load_model(path)
    assert loaded.config == net.config
    saved, own = loaded.state_dict(), net.state_dict()
    assert saved.keys() == own.keys()
    assert all(saved[name].equal(value.to(saved[name].dtype)) for name, value in own.items())


def test_half_precision_on_request(net, tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(net, path, dtype=torch.float16)
    saved = load_model(path).state_dict()
    for name, value in net.named_parameters():
        assert saved[name].dtype == torch.float32
        assert saved[name].equal(value.half().float()), name
    for name, value in net.named_buffers():
        assert saved[name].equal(value), name
    parameters = sum(value.numel() for value in net.parameters())
    buffers = sum(v.numel() for n, v in net.named_buffers() if v.is_floating_point())
    assert path.stat().st_size < 2 * parameters + 4 * buffers + 100_000  # the header


def test_every_parameter_keeps_its_own_precision(tmp_path):
    net = create_model("msnet2d", **SMALL).double()
    net.heads[0].score.weight.data = net.heads[0].score.weight.data.bfloat16()
    save_weights(net, tmp_path / "net.safetensors")
    saved = load_file(tmp_path / "net.safetensors")
    assert saved["heads.0.score.weight"].dtype == torch.bfloat16
    assert saved["heads.1.score.weight"].dtype == torch.float64
    assert saved["heads.1.score.weight"].equal(net.heads[1].score.weight)


def test_file_describes_itself(net, tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(net, path, card={"data": "procedural", "licence": "Apache-2.0"})
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    config = json.loads(metadata["config"])
    assert metadata["model"] == "msnet2d"
    assert config["dims"] == 2
    assert config["max_disparity"] == 32
    assert config["cost_volume"] == "interlaced-4"
    assert json.loads(path.with_suffix(".json").read_text())["licence"] == "Apache-2.0"


def test_files_that_name_no_network_are_of_the_first_family(net, tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(net, path)
    with safe_open(path, framework="pt") as file:
        config = file.metadata()["config"]
    save_file(load_file(path), path, {"config": config})
    assert load_model(path).config == net.config


def test_what_cannot_be_saved_leaves_no_file(net, tmp_path):
    with pytest.raises(InputError, match="safetensors"):
        save_weights(net, tmp_path / "net.pth")
    huge = create_model("msnet2d", **SMALL)
    with torch.no_grad():
        huge.heads[0].score.weight[0] = 70_000  # float16 ends at 65504
    with pytest.raises(InputError, match=r"heads\.0\.score\.weight is not finite as torch.float16"):
        save_weights(huge, tmp_path / "net.safetensors", card={}, dtype=torch.float16)
    assert list(tmp_path.iterdir()) == []


def test_damaged_and_foreign_files(net, tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(net, path)
    whole = path.read_bytes()
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    state = load(whole)

    def message():
        with pytest.raises(InputError, match=r"net\.safetensors: ") as caught:
            load_model(path)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    for content in (whole[: len(whole) // 2], whole[:5], b"", b"\x89PNG" * 1000):
        path.write_bytes(content)
        assert "not a whole safetensors file" in message()
    save_file({"weight": torch.zeros(3)}, path)
    assert "such as 'weight', are those of no registered network" in message()
    for config in ('{"dims": 2, "colour": "red"}', '{"dims": 4}', '{"dims": 2, "width": "x"}'):
        save_file(state, path, {"config": config})
        assert "does not fit this version" in message()
    for config in ("{", "[]", "3"):
        save_file(state, path, {"config": config})
        assert re.search("network config(:| is) no JSON", message())
    lacking = {name: value for name, value in state.items() if name != "heads.1.score.weight"}
    save_file(lacking, path, metadata)
    assert "1 tensor does not fit msnet2d, such as: heads.1.score.weight is missing" in message()
    save_file(state | {"more": torch.zeros(3)}, path, metadata)
    assert "more is unknown" in message()
    save_file(state | {"heads.1.score.weight": torch.zeros(3)}, path, metadata)
    assert "heads.1.score.weight has shape (3,), not (8, 8, 3, 3)" in message()
    state["heads.1.score.weight"][0] = torch.nan
    save_file(state, path, metadata)
    assert "heads.1.score.weight is not finite" in message()
    with pytest.raises(FileNotFoundError, match="absent"):
        load_model(tmp_path / "absent.safetensors")
