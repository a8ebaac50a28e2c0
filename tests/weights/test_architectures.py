"""Weights of every registered architecture, and of a user's own."""

import json
import subprocess
import sys
from dataclasses import fields

import pytest
import torch

from mobilestereonet import InputError, load_model, save_weights
from mobilestereonet.nets import build_model, list_models, model_config, registry
from mobilestereonet.weights import save_pretrained
from small_views import for_small_views

OWN = '''
from dataclasses import dataclass

import torch
from torch import nn

from mobilestereonet.nets import IMAGENET, Prediction, StereoModel


@dataclass(frozen=True)
class Config:
    max_disparity: int = 64
    kernel: tuple[int, int] = (1, 3)


class MyNet(StereoModel):
    """Regresses a disparity from the mean of both views."""

    config: Config
    size_multiple = 4

    def __init__(self, config):
        super().__init__(config)
        self.net = nn.Conv2d(6, 1, config.kernel, padding="same")
        self.tied = self.net

    def forward(self, left, right):
        disparity = self.net(torch.cat((left, right), 1))[:, 0]
        return Prediction(disparity, None)
'''
SMALLER = {"max_disparity": 96, "hourglasses": 1, "width": 8}


def is_row(name):
    return name.startswith(("table", "appendix")) or ".py:" in name


def same_outputs(net, loaded):
    if hasattr(getattr(net, "features", None), "pools"):  # views of 256 px would take long
        net, loaded = for_small_views(net), for_small_views(loaded)
    size = net.size_multiple * -(-max(32, net.min_side) // net.size_multiple)
    left, right = torch.rand(2, 1, 3, size, size)
    with torch.inference_mode():
        expected, found = net.eval()(left, right), loaded(left, right)
    return found.disparity.equal(expected.disparity)


@pytest.mark.parametrize("name", [name for name in list_models() if not is_row(name)])
def test_any_network_is_the_same_after_a_round_trip(name, tmp_path):
    known = {part.name for part in fields(model_config(name))}
    torch.manual_seed(0)
    net = build_model(name, **{key: value for key, value in SMALLER.items() if key in known})
    save_weights(net, tmp_path / "net.safetensors")
    torch.save({"state_dict": net.state_dict()}, tmp_path / "net.pth")
    save_pretrained(net, tmp_path / "folder")
    loaded = load_model(tmp_path / "net.safetensors")
    assert type(loaded) is type(net)
    assert loaded.config == net.config
    assert same_outputs(net, loaded)
    values = {part: getattr(net.config, part) for part in known}
    others = [load_model(tmp_path / "folder")]
    others += [load_model(tmp_path / "net.pth", model=name, **values)]
    for other in others:
        assert other.config == net.config
        own = other.state_dict()
        assert all(own[key].equal(value) for key, value in net.state_dict().items())


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """What a test registers is forgotten after it."""
    monkeypatch.setattr(registry, "_MODELS", dict(registry._MODELS))


@pytest.fixture
def own(tmp_path):
    """Reference of a class in a file, and weights of it in all forms."""
    (tmp_path / "my_net.py").write_text(OWN)
    reference = f"{tmp_path / 'my_net.py'}:MyNet"
    net = build_model(reference, max_disparity=96)
    save_weights(net, tmp_path / "own.safetensors")
    save_pretrained(net, tmp_path / "folder")
    torch.save(net.state_dict(), tmp_path / "own.pth")
    return reference, net


def test_a_network_of_the_users_own(own, tmp_path):
    reference, net = own
    for name in ("own.safetensors", "folder"):
        loaded = load_model(tmp_path / name, model=reference)
        assert loaded.config == net.config
        assert loaded.config.kernel == (1, 3)
        assert same_outputs(net, loaded)
    loaded = load_model(tmp_path / "own.pth", model=reference)  # keeps its prefix "net."
    assert loaded.max_disparity == 64
    assert same_outputs(net, loaded)
    with pytest.raises(InputError, match=r"own.safetensors: holds .*my_net.py:MyNet, not msnet2d"):
        load_model(tmp_path / "own.safetensors", model="msnet2d")
    text = str(tmp_path)
    assert text not in (tmp_path / "own.safetensors").read_bytes().decode("latin-1")


def test_a_file_never_runs_code_that_it_names(own, tmp_path):
    (tmp_path / "my_net.py").write_text('raise SystemExit("ran")')
    for name in ("own.safetensors", "folder"):
        code = f"from mobilestereonet import load_model; load_model({name!r})"
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 1
        line = done.stderr.splitlines()[-1]
        assert "InputError" in line
        assert f"{name}" in line
        assert "--model my_net.py:MyNet" in line


def test_a_checkpoint_of_a_run_with_the_users_own_network(own, tmp_path):
    reference, net = own
    state = {f"net.{name}": value for name, value in net.state_dict().items()}
    torch.save({"pytorch-lightning_version": "2", "state_dict": state}, tmp_path / "last.ckpt")
    recipe = {"model": reference, "net": {"max_disparity": 96}}
    (tmp_path / "recipe.json").write_text(json.dumps(recipe))
    loaded = load_model(tmp_path / "last.ckpt")  # its class has been imported before
    assert loaded.config == net.config
    assert same_outputs(net, loaded)
    recipe["model"] = "elsewhere/other.py:Other"
    (tmp_path / "recipe.json").write_text(json.dumps(recipe))
    with pytest.raises(InputError, match=r"last.ckpt: .*--model elsewhere/other.py:Other \(that"):
        load_model(tmp_path / "last.ckpt")


def test_a_class_that_registers_itself_in_its_file(tmp_path):
    decorated = OWN.replace("class MyNet", '@register_model("mine")\nclass MyNet').replace(
        "import IMAGENET,", "import register_model, IMAGENET,"
    )
    (tmp_path / "my_net.py").write_text(decorated)
    reference = f"{tmp_path / 'my_net.py'}:MyNet"
    code = (
        "from mobilestereonet import load_model, save_weights\n"
        "from mobilestereonet.nets import build_model\n"
        f"save_weights(build_model({reference!r}), 'own.safetensors')"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    with pytest.raises(InputError, match="holds mine, which is none of the registered networks"):
        load_model(tmp_path / "own.safetensors")
    assert load_model(tmp_path / "own.safetensors", model=reference).max_disparity == 64


def test_a_subclass_of_a_registered_network_is_not_taken_for_it(tmp_path):
    (tmp_path / "sub.py").write_text(
        "from mobilestereonet.nets import register_model\n"
        "from mobilestereonet.nets.msnet import MSNET2D, MobileStereoNet\n"
        "from dataclasses import replace\n\n"
        "@register_model('test-mine', config=replace(MSNET2D, max_disparity=32))\n"
        "class Mine(MobileStereoNet):\n"
        "    def aggregate(self, volume, guidance=None):\n"
        "        return [0 * scores for scores in super().aggregate(volume, guidance)]\n"
    )
    net = build_model(f"{tmp_path}/sub.py:Mine").eval()
    save_weights(net, tmp_path / "mine.safetensors")
    loaded = load_model(tmp_path / "mine.safetensors", model=f"{tmp_path}/sub.py:Mine")
    assert type(loaded).__name__ == "Mine"
    plain = build_model("msnet2d", max_disparity=32)
    save_weights(plain, tmp_path / "plain.safetensors")
    loaded = load_model(tmp_path / "plain.safetensors", model=f"{tmp_path}/sub.py:Mine")
    assert type(loaded).__name__ == "Mine"  # it was asked for
    for name in ("test-mine", f"{tmp_path}/sub.py:Mine"):
        del registry._MODELS[name]
