import json
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load, save_file

from mobilestereonet import InputError, create_model, load_weights, save_weights, weights
from mobilestereonet.nets import model_config
from mobilestereonet.weights import files

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


def test_round_trip_in_half_precision(net, tmp_path):
    path = tmp_path / "new" / "net.safetensors"
    save_weights(net, path)
    loaded = load_weights(path)
    assert loaded.config == net.config
    assert not loaded.training
    saved, own = loaded.state_dict(), net.state_dict()
    for name, value in net.named_parameters():
        assert saved[name].dtype == torch.float32
        assert saved[name].equal(value.half().float()), name
    for name, value in net.named_buffers():
        assert saved[name].equal(value), name
    assert saved.keys() == own.keys()
    parameters = sum(value.numel() for value in net.parameters())
    buffers = sum(v.numel() for n, v in net.named_buffers() if v.is_floating_point())
    assert path.stat().st_size < 2 * parameters + 4 * buffers + 100_000  # the header
    assert list(path.parent.iterdir()) == [path]


def test_single_precision_is_exact(net, tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(net, path, dtype=torch.float32)
    state = load_weights(path).state_dict()
    assert all(state[name].equal(value) for name, value in net.state_dict().items())


def test_file_describes_itself(net, tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(net, path, card={"data": "procedural", "licence": "Apache-2.0"})
    with safe_open(path, framework="pt") as file:
        config = json.loads(file.metadata()["config"])
    assert config["dims"] == 2
    assert config["max_disparity"] == 32
    assert config["cost_volume"] == "interlaced-4"
    assert json.loads(path.with_suffix(".json").read_text())["licence"] == "Apache-2.0"


def test_what_cannot_be_saved_leaves_no_file(net, tmp_path):
    with pytest.raises(InputError, match="safetensors"):
        save_weights(net, tmp_path / "net.pth")
    huge = create_model("msnet2d", **SMALL)
    with torch.no_grad():
        huge.heads[0].score.weight[0] = 70_000  # float16 ends at 65504
    with pytest.raises(InputError, match=r"heads\.0\.score\.weight is not finite as torch.float16"):
        save_weights(huge, tmp_path / "net.safetensors", card={})
    assert list(tmp_path.iterdir()) == []


def test_authors_checkpoints_are_told_by_their_ending(tmp_path):
    (tmp_path / "model.tar").write_bytes(b"no checkpoint")
    with pytest.raises(InputError, match="not a readable PyTorch checkpoint"):
        load_weights(tmp_path / "model.tar")


def test_damaged_and_foreign_files(net, tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(net, path)
    whole = path.read_bytes()
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    state = load(whole)

    def message():
        with pytest.raises(InputError, match=r"net\.safetensors: ") as caught:
            load_weights(path)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    for content in (whole[: len(whole) // 2], whole[:5], b"", b"\x89PNG" * 1000):
        path.write_bytes(content)
        assert "not a whole safetensors file" in message()
    save_file(state, path)
    assert "no network config" in message()
    for config in ('{"dims": 2, "colour": "red"}', '{"dims": 4}', "{", '{"dims": 2, "width": "x"}'):
        save_file(state, path, {"config": config})
        assert "does not fit this version" in message()
    lacking = {name: value for name, value in state.items() if name != "heads.1.score.weight"}
    save_file(lacking, path, metadata)
    assert "1 tensors do not fit" in message()
    assert "heads.1.score.weight" in message()
    save_file(state | {"heads.1.score.weight": torch.zeros(3)}, path, metadata)
    assert "heads.1.score.weight" in message()
    with pytest.raises(FileNotFoundError, match="absent"):
        load_weights(tmp_path / "absent.safetensors")


def test_embedded_weights(net, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_EMBEDDED", tmp_path)
    assert weights.embedded_models() == []
    with pytest.raises(InputError, match="no weights of 'msnet2d' come with the package"):
        weights.load_pretrained("msnet2d")
    save_weights(net, tmp_path / "msnet2d.safetensors", card={"steps": 3})
    assert weights.embedded_models() == ["msnet2d"]
    assert weights.load_pretrained("msnet2d").config == net.config
    assert weights.open_weights(Path("msnet2d")).config == net.config
    with pytest.raises(FileNotFoundError, match=r"msnet3d: neither embedded weights \(msnet2d\)"):
        weights.open_weights("msnet3d")
    with pytest.raises(FileNotFoundError, match="msnet2d: no such weights file"):
        weights.load_weights("msnet2d")
    assert weights.card("msnet2d") == {"steps": 3}
    with pytest.raises(InputError, match=r"no weights of 'baseline3d' .*msnet2d"):
        weights.card("baseline3d")
    with pytest.raises(InputError, match=r"unknown model 'msnet2'.*msnet2d"):
        weights.load_pretrained("msnet2")


def test_every_embedded_model_loads_and_has_a_card():
    for name in weights.embedded_models():
        net = weights.load_pretrained(name)
        assert net.config == model_config(name, estimator="mode", coarse_pass=name == "msnet3d")
        assert weights.card(name)["licence"] == "Apache-2.0"
