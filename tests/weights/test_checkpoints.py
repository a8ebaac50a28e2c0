"""Weights in PyTorch's own files: state dicts, and checkpoints of training runs."""

import argparse
import json
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from mobilestereonet import InputError, create_model, load_model, save_weights

pytestmark = pytest.mark.filterwarnings("ignore:.*a state dict does not hold its config")


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(0)
    return create_model("msnet2d")


def same(net, loaded):
    own = loaded.state_dict()
    return loaded.config == net.config and all(
        own[name].equal(value) for name, value in net.state_dict().items()
    )


@pytest.mark.parametrize(
    ("wrapper", "prefix"),
    [
        (None, ""),
        (None, "_orig_mod."),
        ("model", "module."),
        ("state_dict", "net."),
        ("model_state_dict", "module._orig_mod.net."),
        ("state_dict", "module.module."),
        ("network", "_orig_mod.module.model."),
        ("weights of mine", "model.module."),
    ],
)
def test_a_plain_state_dict_tells_its_network(net, tmp_path, prefix, wrapper):
    state = {prefix + name: value for name, value in net.state_dict().items()}
    content = state if wrapper is None else {wrapper: state, "epoch": 3, "lr": [0.1]}
    torch.save(content, tmp_path / "own.pth")
    loaded = load_model(tmp_path / "own.pth")
    assert same(net, loaded)
    assert not loaded.training


def test_a_network_compiled_in_parts(net, tmp_path):
    state = {
        f"features._orig_mod.{k[9:]}": v for k, v in net.state_dict().items() if "features" in k
    }
    state |= {name: value for name, value in net.state_dict().items() if "features" not in name}
    torch.save(state, tmp_path / "own.pt")
    assert same(net, load_model(tmp_path / "own.pt"))


def test_a_state_dict_in_safetensors(net, tmp_path):
    save_file(net.state_dict(), tmp_path / "own.safetensors")
    assert same(net, load_model(tmp_path / "own.safetensors"))


def test_what_a_state_dict_cannot_tell_is_asked_for(tmp_path):
    net = create_model("msnet3d", max_disparity=64)
    path = tmp_path / "own.pth"
    torch.save(net.state_dict(), path)
    with pytest.raises(
        InputError, match=r"fits msnet3d and msnet3d-authors alike: .*--model msnet3"
    ):
        load_model(path)
    assert load_model(path, model="msnet3d").config.v2_skip
    assert not load_model(path, model="msnet3d-authors").config.v2_skip
    assert same(net, load_model(path, model="msnet3d", max_disparity=64))
    with pytest.raises(InputError, match=r"do not fit msnet2d, such as: .*; they resemble msnet3d"):
        load_model(path, model="msnet2d")
    with pytest.raises(InputError, match="unknown model 'msnet5d'"):
        load_model(path, model="msnet5d")
    torch.save(create_model("msnet2d", max_disparity=64).state_dict(), path)
    with pytest.raises(
        InputError,
        match=r"has shape .*: name its network, .* --model msnet2d, .* --set net.max_disp",
    ):
        load_model(path)
    with pytest.raises(InputError, match="do not fit msnet2d"):
        load_model(path, model="msnet2d")
    assert load_model(path, model="msnet2d", max_disparity=64).config.max_disparity == 64
    torch.save({"encoder.0.weight": torch.zeros(3)}, path)
    with pytest.raises(InputError, match=r"'encoder.0.weight', are those of no registered network"):
        load_model(path)


def test_a_coarse_pass_is_told_by_the_names(tmp_path):
    net = create_model("msnet3d", coarse_pass=True)
    path = tmp_path / "own.pth"
    torch.save({f"module.{name}": value for name, value in net.state_dict().items()}, path)
    assert same(net, load_model(path, model="msnet3d"))
    with pytest.raises(InputError, match=r"fits msnet3d and .* alike: choose one.*--model msnet3d"):
        load_model(path)
    with pytest.raises(InputError, match=r"guide.* with coarse_pass=False: leave out"):
        load_model(path, model="msnet3d", coarse_pass=False)


def test_a_state_dict_without_its_config_is_warned_of(net, tmp_path):
    torch.save(net.state_dict(), tmp_path / "own.pth")
    said = r'own.pth: .* estimator="mean" by default; .* --set net.estimator=mode --refine$'
    with pytest.warns(UserWarning, match=said) as caught:
        load_model(tmp_path / "own.pth")
    assert caught[0].filename == __file__
    save_weights(net, tmp_path / "whole.safetensors")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_model(tmp_path / "own.pth", estimator="mode")
        load_model(tmp_path / "whole.safetensors")


def test_weights_that_are_not_finite_are_refused(net, tmp_path):
    state = {name: value.clone() for name, value in net.state_dict().items()}
    for value in (torch.nan, torch.inf):
        state["heads.0.score.weight"][0] = value
        torch.save(state, tmp_path / "own.pth")
        with pytest.raises(InputError, match=r"own.pth: heads.0.score.weight is not finite"):
            load_model(tmp_path / "own.pth")


def test_values_that_no_training_gives_are_refused(net, tmp_path):
    state, path = net.state_dict(), tmp_path / "own.pth"
    variances = next(name for name in state if name.endswith("running_var"))
    for change, message in (
        ({name: torch.zeros_like(value) for name, value in state.items()}, "all its values are 0"),
        ({variances: -state[variances]}, f"{variances} has variances below 0"),
        ({"heads.0.score.weight": state["heads.0.score.weight"].to(torch.int8)}, "int8, quantised"),
    ):
        torch.save({**state, **change}, path)
        with pytest.raises(InputError, match=rf"own.pth: .*{message}"):
            load_model(path)


class Attack:
    ran = False

    def __reduce__(self):
        return exec, ("from test_checkpoints import Attack; Attack.ran = True",)


def test_no_code_of_a_file_runs(net, tmp_path):
    path = tmp_path / "own.pth"
    beside = {"args": argparse.Namespace(lr=1), "attack": Attack(), "loss": np.float64(0.5)}
    beside |= {"seen": {3, 4}, "folder": Path("runs"), "losses": defaultdict(list, a=[1.0])}
    torch.save({**beside, "state_dict": net.state_dict()}, path)
    assert same(net, load_model(path))
    torch.save({**net.state_dict(), **beside}, path)  # also among the tensors
    assert same(net, load_model(path))
    torch.save(
        {**beside, "state_dict": net.state_dict()}, path, _use_new_zipfile_serialization=False
    )
    assert same(net, load_model(path))
    for whole in (net, Attack()):
        torch.save(whole, path)
        with pytest.raises(InputError, match=r"own.pth: .*save its state_dict\(\) alone") as caught:
            load_model(path)
        assert "\n" not in str(caught.value)
    assert not Attack.ran


def test_records_beside_the_network_are_not_taken_for_it(net, tmp_path):
    state = net.state_dict()
    optimizer = {"state": {name: {"exp_avg": value} for name, value in state.items()}}
    content = {"step": torch.tensor(3), "best": torch.tensor(0.1), "optimizer": optimizer}
    torch.save({**content, "ema": state}, tmp_path / "own.pth")
    assert same(net, load_model(tmp_path / "own.pth"))


def test_other_content_is_no_state_dict(net, tmp_path):
    path = tmp_path / "own.ckpt"
    for content in ([1], {}, {"state_dict": {}}, {"model": 3}, {"state_dict": {"weight": "no"}}):
        torch.save(content, path)
        with pytest.raises(InputError, match=r"own.ckpt: holds no state dict"):
            load_model(path)
    for content in (b"", b"no checkpoint"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not a readable PyTorch checkpoint"):
            load_model(path)


def _lightning(net, average):
    """What Lightning writes with a moving average, whose values take the place of the others."""
    state, mean = ({f"net.{k}": v for k, v in x.state_dict().items()} for x in (net, average))
    return {
        "pytorch-lightning_version": "2.6.0",
        "global_step": 3,
        "state_dict": {"skipped": torch.tensor(0), **mean},
        "current_model_state": {"skipped": torch.tensor(0), **state},
        "averaging_state": {"n_averaged": torch.tensor(3)},
        "optimizer_states": [{"state": {0: {"step": torch.tensor(3.0)}}}],
    }


@pytest.mark.parametrize("flat", [True, False], ids=["flat recipe", "values under net"])
def test_a_checkpoint_of_a_run(tmp_path, flat):
    values = {"max_disparity": 64, "estimator": "mode"}
    nets = [create_model("msnet3d", coarse_pass=True, **values) for _ in range(2)]
    path = tmp_path / "last.ckpt"
    torch.save(_lightning(*nets), path)
    with pytest.raises(InputError, match=r"last.ckpt: .*they do not fit|last.ckpt: .*--model"):
        load_model(path)
    network = {**values, "coarse_pass": True}
    recipe = {"model": "msnet3d", "lr": 0.1} | (network if flat else {"net": network})
    (tmp_path / "recipe.json").write_text(json.dumps(recipe))
    assert same(nets[1], load_model(path))
    assert same(nets[1], load_model(path, model="msnet3d"))
    assert load_model(path, estimator="mean").config.estimator == "mean"
    with pytest.raises(InputError, match=r"last.ckpt: holds msnet3d, not msnet2d"):
        load_model(path, model="msnet2d")
    (tmp_path / "recipe.json").write_text("[")
    with pytest.raises(InputError, match=r"recipe\.json: no JSON"):
        load_model(path)
