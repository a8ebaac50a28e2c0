"""A network and a loss from files of the user's own, from the command line."""

import json

import pytest
import torch

from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.named_recipes import default_recipe
from mobilestereonet.training.objective import Objective
from mobilestereonet.training.recipe import Recipe
from mobilestereonet.weights import load_model

pytestmark = pytest.mark.filterwarnings("ignore")

NETWORK = '''
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional as F

from mobilestereonet.nets import Prediction, StereoModel


@dataclass(frozen=True)
class Config:
    max_disparity: int = 64
    width: int = 4


class Outputs(NamedTuple):
    disparity: torch.Tensor


class MyNet(StereoModel):
    """Regresses the disparity directly."""

    config: Config
    size_multiple = 8

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.layers = nn.Sequential(
            nn.Conv2d(6, config.width, 3, padding=1),
            nn.BatchNorm2d(config.width),
            nn.ReLU(),
            nn.Conv2d(config.width, 1, 3, padding=1),
        )
        self.steps = []

    def set_step(self, step):
        print("step", step)

    def forward(self, left, right):
        self.check_views(left, right)
        x = self.layers(torch.cat((left, right), dim=1)).squeeze(1)
        disparity = (self.max_disparity - 1) * x.sigmoid()
        return Outputs(disparity) if self.training else Prediction(disparity)

    def training_loss(self, outputs, disparity, valid):
        return F.l1_loss(outputs.disparity[valid], disparity[valid])
'''
LOSS = """
def twice(outputs, disparity, valid):
    return 2 * (outputs.disparity - disparity)[valid].abs().mean()
"""
VALUES = {
    "scenes.height": 48,
    "scenes.width": 64,
    "scenes.max_disparity": 20,
    "scenes.min_disparity": 4,
    "scenes.noise_textures": 16,
    "scenes.texture_size": 32,
    "augment.height": 32,
    "augment.width": 48,
    "augment.patch": "[2,6]",
    "batch_size": 2,
    "val_scenes": 1,
    "net.width": 6,
}


@pytest.fixture
def files(tmp_path):
    (tmp_path / "my_net.py").write_text(NETWORK)
    (tmp_path / "my_loss.py").write_text(LOSS)
    return tmp_path


def test_it_trains_is_resumed_and_loaded(files, msnet, monkeypatch):
    monkeypatch.chdir(files)
    settings = [f"--set={name}={value}" for name, value in VALUES.items()]
    options = ["--accelerator", "cpu", "--no-progress"]
    command = ["train", "run", "--model", "my_net.py:MyNet", *settings, *options]
    code, out, err = msnet(*command, "--set", "steps=2")
    assert code == 0, err
    assert [line for line in out.splitlines() if line.startswith("step")] == ["step 0", "step 1"]
    log = (files / "run/csv/version_0/metrics.csv").read_text()
    assert "val/epe" in log and "train/epe" in log
    recipe = json.loads((files / "run/recipe.json").read_text())
    assert recipe["model"] == f"{files}/my_net.py:MyNet" and recipe["net"] == {"width": 6}

    (files / "elsewhere").mkdir()
    monkeypatch.chdir(files / "elsewhere")
    code, out, err = msnet("train", "../run", "--resume", "--set", "steps=3", *options)
    assert code == 0, err
    assert [line for line in out.splitlines() if line.startswith("step")] == ["step 2"]

    net = load_model(files / "run/weights.safetensors", model=f"{files}/my_net.py:MyNet")
    assert net.config.width == 6 and not net.training
    view = torch.rand(1, 3, 16, 24)
    assert net(view, view).disparity.shape == (1, 16, 24)
    command = ["train", "more", "--model", f"{files}/my_net.py:MyNet", *settings, *options]
    command += ["--weights", "../run/weights.safetensors", "--set", "steps=1", "--set", "lr=1e-12"]
    code, _, err = msnet(*command)
    assert code == 0, err
    more = load_model("more/weights.safetensors", model=f"{files}/my_net.py:MyNet")
    torch.testing.assert_close(more.layers[3].weight, net.layers[3].weight, atol=1e-6, rtol=0)


def test_what_needs_scores_is_refused(files):
    model = f"{files}/my_net.py:MyNet"
    assert default_recipe(model).cross_entropy == 0
    assert default_recipe("msnet3d").cross_entropy == 5
    plain = default_recipe("psmnet")  # it has no estimator to choose
    assert (plain.model, plain.net, plain.full_heads) == ("psmnet", {}, None)
    StereoModule(plain, 1, 1)
    both = default_recipe("msnet2d", model)  # what the two of a comparison take
    assert (both.model, both.net, both.cross_entropy) == ("msnet2d", {}, 0)
    for values, words in (
        ({"cross_entropy": 5.0}, "cross_entropy need.*--set cross_entropy=0"),
        ({"full_heads": 1}, "full_heads need.*--set full_heads=null"),
        ({"volume_cross_entropy": 1.0}, "--set volume_cross_entropy=0, or --recipe procedural-pl"),
        ({"cross_entropy": 5.0, "teacher": "msnet2d"}, "teacher need matching scores"),
        ({"zero_residuals": True}, "MyNet cannot start .* at zero: --set zero_residuals=false"),
        ({"net": {"widht": 3}}, r"no value 'widht' \(did you mean width\?\), only max_disparity"),
        ({"net": {"width": "wide"}}, "width must be a whole number, got 'wide'"),
    ):
        with pytest.raises(InputError, match=words):
            StereoModule(Recipe(model=model, steps=1, **values), 1, 1)


def test_heads_without_a_gradient_are_refused():
    """Distributed training would stop at them."""
    for full_heads in (1, 3):
        recipe = Recipe(steps=1, full_heads=full_heads)
        with pytest.raises(InputError, match=f"full_heads={full_heads} without cross_entropy .*=5"):
            StereoModule(recipe, 1, 1)
    for values in ({"full_heads": 4}, {}, {"full_heads": 1, "cross_entropy": 1.0}):
        Objective(Recipe(steps=1, **values), build_model("msnet2d"))


def test_targets_between_planes_need_scores_with_a_closed_form():
    for target in ("disparity", "surfaces"):
        recipe = Recipe(steps=1, cross_entropy=1.0, cross_entropy_target=target)
        Objective(recipe, build_model("psmnet"))
        with pytest.raises(InputError, match=f"cross_entropy_target={target} is for .*=planes"):
            Objective(recipe, build_model("gcnet"))


def test_cross_entropies_need_half_pixel_centres():
    net = build_model("psmnet", align_corners=True)
    Objective(Recipe(model="psmnet", steps=1), net)
    for values in ({"cross_entropy": 1.0}, {"volume_cross_entropy": 1.0}):
        with pytest.raises(InputError, match=r"psmnet has net.align_corners: --set net.align_corn"):
            Objective(Recipe(model="psmnet", steps=1, **values), net)


def test_crops_that_a_network_does_not_take_are_refused():
    net = build_model("psmnet", max_disparity=16)
    for side, fitting in ((100, 256), (260, 272)):
        recipe = Recipe(model="psmnet", steps=1, augment=AugmentConfig(height=512, width=side))
        with pytest.raises(InputError, match=f"width is {side}: --set augment.width={fitting}$"):
            Objective(recipe, net)
    crop = default_recipe("ganet-11").augment
    assert (crop.height, crop.width) == (288, 528)


def test_a_loss_of_the_users_own(files):
    net = build_model("table3a-v1-v1", max_disparity=32)
    left, right = torch.rand(2, 1, 3, 32, 48)
    disparity = torch.rand(1, 32, 48) * 40
    pairs = StereoSample(left, right, disparity, disparity > 5, name="pair")
    outputs = net(left, right)
    recipe = Recipe(steps=1, loss=f"{files}/my_loss.py:twice")
    part = Objective(recipe, net).truth(net, outputs, pairs)
    mask = (disparity > 5) & (disparity < 32)
    expected = 2 * (outputs.disparity - disparity)[mask].abs().sum()
    assert part.total.item() == pytest.approx(expected.item(), rel=1e-5)
    assert int(part.pixels) == int(mask.sum())
    for loss, words in (
        (f"{files}/my_loss.py:thrice", "thrice is no function"),
        ("l1", "loss must be \"model\" or such as my_loss.py:function, got 'l1'"),
    ):
        with pytest.raises(InputError, match=words):
            Objective(Recipe(steps=1, loss=loss), net)
    with pytest.raises(FileNotFoundError, match=r"none\.py: no such file to import twice from"):
        Objective(Recipe(steps=1, loss=f"{files}/none.py:twice"), net)


def test_nothing_to_learn_from_counts_nothing(files):
    """The mean over no pixel is not finite in the user's network: it must not reach the sum."""
    net = build_model(f"{files}/my_net.py:MyNet")
    left, right = torch.rand(2, 1, 3, 16, 24)
    disparity = torch.rand(1, 16, 24) + 1
    pairs = StereoSample(left, right, disparity, disparity < 0, name="pair")
    part = Objective(Recipe(steps=1), net).truth(net, net(left, right), pairs)
    assert part.total == 0 and part.pixels == 0
    part.total.backward()
    assert all(not p.grad.any() for p in net.parameters())
