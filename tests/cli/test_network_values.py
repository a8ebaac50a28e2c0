"""Values of the network's config, ``--set net.NAME=value``, in every command that opens one."""

import json
import re

import cv2
import numpy as np
import pytest
import torch

from extras import need_extra
from mobilestereonet import create_model, save_weights

COMMANDS = {
    "demo": "demo -o out",
    "predict": "predict left/a.png right/a.png -o out",
    "video": "video left right --frames out",
    "batch": "batch left right -o out",
    "evaluate": "evaluate --data folder --root . --set disparity=disparity/*.npy",
    "submit": "submit kitti2015 --root . -o out.zip",
    "export": "export onnx -o out.onnx",
    "bench": "bench --size 32 64 --repeats 1",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with one pair, its ground truth, and weights of a small network."""
    rng = np.random.default_rng(0)
    for side in ("left", "right", "disparity"):
        (tmp_path / side).mkdir()
    for side in ("left", "right"):
        cv2.imwrite(str(tmp_path / side / "a.png"), rng.integers(0, 256, (32, 64, 3), np.uint8))
    np.save(tmp_path / "disparity" / "a.npy", np.full((32, 64), 5, np.float32))
    torch.manual_seed(1)
    save_weights(create_model("msnet2d", max_disparity=32), tmp_path / "net.safetensors")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_a_value_that_the_network_lacks_is_refused(msnet, folder, command):
    arguments = COMMANDS[command].split()
    code, out, err = msnet(*arguments, "--weights", "net.safetensors", "--set", "net.colour=red")
    assert (code, out) == (2, "")
    assert re.fullmatch(r"msnet: .*no value 'colour'.*\n", err)


def test_the_page_tells_a_value_that_its_networks_lack_at_the_start(msnet):
    need_extra("gradio")
    code, out, err = msnet("web", "--set", "net.colour=red")
    assert (code, out) == (2, "")
    assert re.fullmatch(r"msnet: .*no value 'colour'.*\n", err)


def test_a_value_changes_what_is_scored(msnet, folder):
    errors = []
    for value in ("mean", "mode"):
        settings = ("--set", f"net.estimator={value}", "--no-refine", "--json", "figures.json")
        code, _, _ = msnet(*COMMANDS["evaluate"].split(), "--weights", "net.safetensors", *settings)
        assert code == 0
        errors.append(json.loads((folder / "figures.json").read_text())[0])
    assert errors[0] != errors[1]


def test_beside_networks_sgbm_keeps_its_values(msnet, folder):
    models = ("--model", "net.safetensors", "--model", "sgbm", "--set", "net.estimator=mode")
    code, _, _ = msnet(*COMMANDS["evaluate"].split(), *models)
    assert code == 0
    code, _, err = msnet(*COMMANDS["evaluate"].split(), *models[2:])
    assert code == 2
    assert "sgbm has no option 'estimator'" in err
