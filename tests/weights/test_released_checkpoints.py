"""Released checkpoints of other networks, written here in their documented forms."""

import warnings

import pytest
import torch

from mobilestereonet import InputError, load_model, save_weights
from mobilestereonet.nets import build_model
from mobilestereonet.weights.released_names import released_name

WRAPPED = {
    "psmnet": "state_dict",
    "psmnet-basic": None,
    "gwcnet-g": "model",
    "gwcnet-gc": "model",
    "gwcnet-gc-base": None,
    "gcnet": None,
    "ganet-11": None,
    "ganet-deep": "state_dict",
    "deeppruner-best": "state_dict",
    "deeppruner-fast": "state_dict",
}
"""Under which key a release has its state dict; None where there is no release."""


def released(name):
    """A fresh network, and its state dict as DataParallel and old PyTorch write it."""
    torch.manual_seed(0)
    net = build_model(name)
    state = {
        f"module.{released_name(name, key)}": value
        for key, value in net.state_dict().items()
        if not key.endswith("num_batches_tracked")
    }
    if name == "ganet-deep":  # a block of the release that is never called
        state["module.cost_agg.deconv0b.conv1.conv.weight"] = torch.zeros(8, 8, 3, 4, 4)
    return net, state


def write(path, state, wrapper):
    extra = {"epoch": 10, "train_loss": 1.5, "optimizer": {"state": {}, "param_groups": []}}
    torch.save(state if wrapper is None else {wrapper: state, **extra}, path)


@pytest.mark.parametrize("name", WRAPPED)
def test_reads_a_release(name, tmp_path):
    net, state = released(name)
    write(tmp_path / "released.tar", state, WRAPPED[name])
    loaded = load_model(tmp_path / "released.tar")
    assert type(loaded) is type(net) and loaded.config == net.config
    expected = net.state_dict()
    assert all(expected[key].equal(value) for key, value in loaded.state_dict().items())


@pytest.mark.parametrize(
    ("name", "field", "value", "warning"),
    [
        ("psmnet", "align_corners", True, "align_corners: false by default, but weights from bef"),
        ("deeppruner-best", "sampler", "uniform", 'sampler: "patch_match" by default, but its au'),
    ],
)
def test_what_the_names_do_not_tell_is_asked_for(name, field, value, warning, tmp_path):
    _, state = released(name)
    write(tmp_path / "kitti.tar", state, "state_dict")
    with pytest.warns(UserWarning, match=f"kitti.tar: does not tell {warning}") as caught:
        loaded = load_model(tmp_path / "kitti.tar")
    assert len(caught) == 1 and f"--set net.{field}=" in str(caught[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chosen = load_model(tmp_path / "kitti.tar", **{field: value})
        save_weights(chosen, tmp_path / "chosen.safetensors")
        again = load_model(tmp_path / "chosen.safetensors")
    assert getattr(loaded.config, field) != value
    assert getattr(chosen.config, field) == getattr(again.config, field) == value


def test_incomplete_releases_are_named(tmp_path):
    _, state = released("gwcnet-g")
    state.pop("module.classif3.2.weight")
    write(tmp_path / "cut.ckpt", state, "model")
    with pytest.raises(InputError, match=r"not the authors' gwcnet-g: 1 keys missing, 0 unknown"):
        load_model(tmp_path / "cut.ckpt")
