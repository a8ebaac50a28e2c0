"""Every command takes every network: one of each class, as small as its config allows."""

import json
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from extras import need_extra
from mobilestereonet import InputError, save_weights
from mobilestereonet.data.augment import AugmentConfig, augment
from mobilestereonet.engines import choose
from mobilestereonet.nets import (
    VolumeModel,
    build_model,
    list_models,
    model_config,
    model_info,
    model_name,
)
from mobilestereonet.nets.model import fitting_side
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.named_recipes import RECIPES, default_recipe
from mobilestereonet.training.objective import Objective
from mobilestereonet.training.pool import TrainingBatch
from short_run import fit

HEIGHT, WIDTH = 32, 64
NAMES = [*{model_info(name).network: name for name in reversed(list_models())}.values()]
LARGE_VIEWS = [name for name in NAMES if model_info(name).network.min_side > HEIGHT]
EXPORTABLE = [name for name in NAMES if model_info(name).network.exportable]
SMALL = {"width": 8, "hidden_width": 8, "stem": 8, "hourglasses": 1, "groups": 8, "passes": 1}

large_views_apart = pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.exhaustive if n in LARGE_VIEWS else ()) for n in NAMES],
)


def smallest(name):
    """Values of a config with which a network has least to compute."""
    known = {part.name for part in fields(model_config(name))}
    values = {key: value for key, value in SMALL.items() if key in known}
    for max_disparity in (12, 16, 32, 64):
        with suppress(InputError):
            model_config(name, **values, max_disparity=max_disparity)
            return {**values, "max_disparity": max_disparity}
    raise AssertionError(f"{name} takes no small range of disparities")


def build(name):
    torch.manual_seed(0)
    return build_model(name, **smallest(name))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A pair with its ground truth, and, as they are asked for, weights of every network."""
    root = tmp_path_factory.mktemp("networks")
    rng = np.random.default_rng(0)
    for side in ("left", "right", "disparity"):
        (root / side).mkdir()
    left = rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    cv2.imwrite(str(root / "left/0.png"), left)
    cv2.imwrite(str(root / "right/0.png"), np.roll(left, -5, axis=1))
    np.save(root / "disparity/0.npy", np.full((HEIGHT, WIDTH), 5, np.float32))
    return root


@pytest.fixture
def weights(folder, monkeypatch):
    """Gives the weights file of a network, in the folder that is the current one."""
    monkeypatch.chdir(folder)

    def save(name):
        path = Path(f"{name}.safetensors")
        if not path.exists():
            save_weights(build(name), path)
        return path

    return save


@pytest.mark.parametrize("name", NAMES)
def test_predict(name, weights, msnet):
    command = ("predict", "left/0.png", "right/0.png", "-o", name, "--json")
    own = model_name(build(name).config)  # narrower ones have another or none
    model = ("--model", name) if own == name else ()
    code, out, err = msnet(*command, "--weights", weights(name), *model)
    assert code == 0, err
    assert json.loads(out)["model"] == own
    disparity = np.load(f"{name}/0_disparity.npy")
    assert disparity.shape == (HEIGHT, WIDTH)
    assert np.isfinite(disparity).all()


@pytest.mark.parametrize("name", NAMES)
def test_what_needs_scores_is_refused_where_there_are_none(name, weights, msnet):
    network = model_info(name).network
    command = ("predict", "left/0.png", "right/0.png", "-o", f"scores-{name}")
    if not issubclass(network, VolumeModel):
        for option in ("--confidence", "--refine"):
            code, out, err = msnet(*command, "--weights", weights(name), option)
            assert (code, out) == (2, "")
            assert err.startswith(f"msnet: {network.__name__} has no confidence: leave out")
            assert err.count("\n") == 1 and not Path(f"scores-{name}").exists()
        return
    if name in LARGE_VIEWS:
        pytest.skip("large views, and the same as for the others")
    code, _, err = msnet(*command, "--weights", weights(name), "--confidence", "--refine")
    assert code == 0, err
    sure = np.load(f"scores-{name}/0_confidence.npy")
    assert sure.shape == (HEIGHT, WIDTH) and (sure >= 0).all() and (sure <= 1).all()


@large_views_apart
def test_evaluate(name, weights, msnet):
    command = ("evaluate", "--data", "folder", "--root", ".", "--set", "disparity=disparity/*.npy")
    code, _, err = msnet(*command, "--weights", weights(name), "--json", "figures.json")
    assert code == 0, err
    (figures,) = json.loads(Path("figures.json").read_text())
    assert figures["masks"]["all"]["pixels"] == HEIGHT * WIDTH


@large_views_apart
def test_bench(name, weights, msnet, monkeypatch):
    net = build(name)
    if net.exportable:  # tests of the engines convert networks, which takes seconds
        monkeypatch.setattr(choose, "CONVERTED", {})
    size = [fitting_side(net, side) for side in (1, net.max_disparity + net.size_multiple)]
    command = ("bench", "--size", *size, "--repeats", 1, "--device", "cpu")
    code, out, err = msnet(*command, "--weights", weights(name))
    assert code == 0, err
    # DeepPruner's fresh weights amplify rounding, so that no engine is close enough to be named.
    assert ("fastest in fp32: --runtime torch" in out) == (name != "deeppruner-best")
    if not net.exportable and "onnxruntime" in err:
        assert "left out: onnxruntime fp32" in err and "cannot be exported" in err


@pytest.mark.parametrize("name", NAMES)
def test_cost(name, msnet):
    values = [f"--set=net.{key}={value}" for key, value in smallest(name).items()]
    side = fitting_side(model_info(name).network, 64)
    size = ("--height", side, "--width", side)
    code, out, err = msnet("cost", "--model", name, *values, *size, "--json")
    assert code == 0, err
    total = json.loads(out)["total"]
    assert total["params"] == sum(weight.numel() for weight in build(name).parameters())
    assert total["macs"] > 0


@pytest.mark.parametrize("name", NAMES)
def test_average(name, weights, msnet):
    own = load_file(weights(name))
    other = build(name)
    with torch.no_grad():
        for weight in other.parameters():
            weight.add_(1)
    save_weights(other, "other.safetensors")
    code, _, err = msnet("average", weights(name), "other.safetensors", "-o", "mean.safetensors")
    assert code == 0, err
    mean = load_file("mean.safetensors")
    assert mean.keys() == own.keys()
    key = next(key for key, _ in other.named_parameters())
    torch.testing.assert_close(mean[key], own[key] + 0.5)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", [name for name in EXPORTABLE if name not in LARGE_VIEWS])
def test_export_onnx(name, weights, msnet):
    need_extra("onnx")
    net = build(name)
    size = [fitting_side(net, side) for side in (HEIGHT, net.max_disparity + net.size_multiple)]
    command = ("export", "onnx", "--height", size[0], "--width", size[1], "-o", f"{name}.onnx")
    code, out, err = msnet(*command, "--weights", weights(name))
    assert code == 0, err
    assert "px from torch on average" in out  # and compared


@pytest.mark.parametrize("name", [name for name in NAMES if name not in EXPORTABLE])
def test_what_cannot_be_exported_is_refused(name, weights, msnet):
    for arguments in (["export", "onnx"], ["export", "pt2"]):
        code, out, err = msnet(*arguments, "--weights", weights(name), "-o", f"net.{arguments[1]}")
        assert (code, out) == (2, "")
        assert "cannot be exported" in err and err.count("\n") == 1
    command = ("predict", "left/0.png", "right/0.png", "-o", "out", "--runtime", "onnxruntime")
    code, out, err = msnet(*command, "--weights", weights(name))
    assert (code, out) == (2, "")
    assert "use the engine torch" in err and err.count("\n") == 1


@pytest.fixture(scope="module")
def scene():
    config = SceneConfig(
        **{"height": 96, "width": 160, "max_disparity": 11, "min_disparity": 3},
        **{"noise_textures": 16, "texture_size": 32},
    )
    return ProceduralScenes(config)[0]


@pytest.mark.filterwarnings("ignore")
@large_views_apart
def test_a_step_of_training_lowers_the_loss_on_its_batch(name, scene):
    net = build(name)
    size = {"height": fitting_side(net, HEIGHT), "width": fitting_side(net, WIDTH)}
    crop = AugmentConfig(**size, scale=(-1e-9, 0.0))  # enlarged where it is too small
    pairs = [scene] * (2 if name in LARGE_VIEWS else 1)  # a pool may leave one value per pair
    batch = augment(pairs, crop, [np.random.default_rng(seed) for seed in range(len(pairs))])
    recipe = replace(
        default_recipe(name),
        **{"net": smallest(name), "augment": crop, "steps": 1, "schedule": ((0.0, 1.0),)},
        **{"optimizer": "sgd", "clip": 1.0, "lr": 1e-4, "lr_batch": 8},
    )

    def loss(module):
        torch.manual_seed(1)  # of networks that draw pixels or candidates
        net = module.net.train()
        views = [net.preprocessing(view) for view in (batch.left, batch.right)]
        with torch.no_grad():
            part = module.objective.truth(net, net(*views), batch)
        assert part.pixels > 0
        return part.total

    before = loss(StereoModule(recipe, 1, 1))
    module = fit([TrainingBatch(batch)], recipe)
    assert int(module.skipped) == 0
    assert loss(module) < before


@pytest.mark.parametrize("name", NAMES)
def test_terms_on_scores_are_refused_where_there_are_none(name):
    recipe = replace(RECIPES["procedural-plain"], model=name, net=smallest(name), cross_entropy=5.0)
    net = build(name)
    height, width = (fitting_side(net, side) for side in (HEIGHT, WIDTH))
    recipe = replace(recipe, augment=AugmentConfig(height=height, width=width))
    if isinstance(net, VolumeModel):
        Objective(recipe, net)
        return
    with pytest.raises(InputError, match=f"{name} regresses the disparity directly") as error:
        Objective(recipe, net)
    assert "\n" not in str(error.value)
