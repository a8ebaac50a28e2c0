import json
import tempfile
from dataclasses import fields
from itertools import pairwise
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mobilestereonet.errors import InputError
from mobilestereonet.nets import list_models, model_info
from mobilestereonet.nets.model import fitting_side
from mobilestereonet.settings import differences
from mobilestereonet.training.named_recipes import RECIPE_FILES, RECIPES, get_recipe, read_recipe
from mobilestereonet.training.optimizers import OPTIMIZERS, make_optimizer
from mobilestereonet.training.recipe import Recipe, override

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", RECIPES)
def test_json_round_trip(name, tmp_path):
    path = tmp_path / "recipe.json"
    path.write_text(get_recipe(name).to_json())
    assert read_recipe(path) == get_recipe(name)


def test_an_older_recipe_takes_defaults(tmp_path):
    path = tmp_path / "recipe.json"
    path.write_text(json.dumps({"steps": 7, "augment": {"height": 64}}))
    recipe = read_recipe(path)
    assert (recipe.steps, recipe.augment.height, recipe.lr) == (7, 64, 1e-3)
    assert recipe.zero_residuals is False


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "not a recipe"),
        ('{"steps": 1, "scenes": {"height": 10000000}}', "must be at most 16384"),
        ('{"steps": 1, "augment": {"width": 10000000}}', "must be at most 16384"),
        ('{"steps": 1, "augment": {"patch": [9, 1]}}', "patch must be a range"),
        ('{"steps": 1, "cross_entropy": -1}', "must not be negative"),
        ("[1, 2]", "recipe must be a JSON object with some of model, net, data"),
        ('{"steps": 1, "colour": "red"}', "no value 'colour'"),
        ('{"steps": 1, "lr": "fast"}', "lr must be a number, got 'fast'"),
    ],
)
def test_a_file_that_is_no_recipe(text, words, tmp_path):
    path = tmp_path / "recipe.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as error:
        read_recipe(path)
    assert str(path) in str(error.value)


def test_missing_recipe(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_recipe(tmp_path / "recipe.json")
    with pytest.raises(InputError, match=r"unknown recipe 'fast'.*paper-sceneflow"):
        get_recipe("fast")


def test_a_recipe_of_version_0_1_0(tmp_path):
    """It held three values of the network itself, and all heads were four."""
    path = tmp_path / "recipe.json"
    old = {"steps": 7, "model": "msnet3d", "max_disparity": 192, "estimator": "mode"}
    path.write_text(json.dumps(old | {"coarse_pass": True, "full_heads": 4}))
    expected = Recipe(steps=7, model="msnet3d", net={"estimator": "mode", "coarse_pass": True})
    assert read_recipe(path) == expected
    assert read_recipe(path).full_heads is None
    path.write_text(json.dumps({"steps": 7, "max_disparity": 96, "full_heads": 1}))
    assert read_recipe(path) == Recipe(steps=7, net={"max_disparity": 96}, full_heads=1)


def test_changes_in_words():
    before = get_recipe("procedural")
    after = override(before, {"net.estimator": "mean", "net.coarse_pass": True, "lr": 0.5})
    assert before.changes(after) == (
        "net.estimator mode -> mean, net.coarse_pass unset -> True, lr 0.001 -> 0.5"
    )
    assert before.changes(before) == ""


def test_override():
    before = get_recipe("procedural")
    values = {
        "lr": 1,
        "model": "msnet3d",
        "augment.noise": 0.02,
        "augment.exposure": None,
        "augment.patch": [3, 4],
        "scenes.seed": 7,
        "scenes.kinds.room": 0.5,
        "val_options.split": "val",
        "schedule": [[0, 1], [1, 0.5]],
    }
    after = override(before, values)
    assert (after.lr, after.model, after.scenes.seed) == (1.0, "msnet3d", 7)
    assert after.augment.noise == 0.02 and after.augment.exposure is None
    assert after.augment.patch == (3, 4) and after.augment.blur == before.augment.blur
    assert after.scenes.kinds["room"] == 0.5 and before.scenes.kinds["room"] == 0.25
    assert after.val_options == {"split": "val"}
    assert after.schedule == ((0.0, 1.0), (1.0, 0.5))
    assert override(before, {}) == before


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"colour": "red"}, "no value 'colour', only model"),
        ({"augment.colour": 1}, "augment has no value 'colour'"),
        ({"crop_height": 256}, r"'crop_height' \(did you mean scenes.height or augment.height\?\)"),
        ({"scene.height": 256}, r"no value 'scene' \(did you mean scenes\?\)"),
        ({"scenes.heigth": 256}, r"no value 'heigth' \(did you mean height\?\)"),
        ({"lr.fast": 1}, "lr has no parts"),
        ({"augment": 5}, "augment must be a JSON object with some of height, width"),
        ({"steps": "many"}, "steps must be a whole number or null, got 'many'"),
        ({"steps": 1.5}, "steps must be a whole number"),
        ({"batch_size": True}, "batch_size must be a whole number, got True"),
        ({"zero_residuals": 1}, "zero_residuals must be true or false, got 1"),
        ({"augment.exposure": [1, 2, 3]}, r"exposure must be \[a number, a number\] or null"),
        ({"epochs": 3}, "either epochs or steps.*to null"),
        ({"steps": None}, "either epochs or steps"),
        ({"duration": "soon"}, "duration must be a number with s, m or h, such as 12m, got 'soon'"),
        ({"duration": "0m"}, "duration must be positive, got 0m"),
        ({"duration": "1m", "epochs": 3}, "either epochs or a duration"),
        ({"uses": 0}, "uses must be positive"),
        ({"lr": 0}, "lr must be positive"),
        ({"clip": -1.0}, "clip must be positive"),
        ({"ema": 1.0}, "ema must be in"),
        ({"cross_entropy_target": "line"}, "must be planes or disparity or surfaces, got 'line'"),
        ({"seed": -1}, "seed must be in"),
        ({"optimizer": "lion"}, "optimizer must be adam or muon or rmsprop or sgd, got 'lion'"),
        ({"optimizer_options.momentum": 0.9}, "muon has no option 'momentum': it has none"),
        ({"optimizer": "adam", "optimizer_options.lr": 1}, "adam has no option 'lr', only betas"),
        ({"optimizer": "sgd", "optimizer_options.momentum": "much"}, "momentum must be a number"),
        ({"optimizer": "sgd", "optimizer_options.momentum": -1}, "optimizer_options: Invalid mom"),
        ({"optimizer": "sgd", "optimizer_options.nesterov": True}, "Nesterov momentum requires"),
        ({"schedule": [[0.5, 1], [0.2, 1]]}, "shares that rise"),
        ({"schedule": [[0, 1], [1.5, 1]]}, "shares that rise"),
        ({"augment.height": -5}, "augment: height must be positive, got -5"),
        ({"scenes.kinds.cave": 1.0}, "kinds"),
        ({"scenes.kinds": "{room: 1}"}, "kinds must be a JSON object .*, got '{room: 1}'"),
        ({"data_options": "all"}, "data_options must be a JSON object"),
        ({"coarse_pass": True}, r"no value 'coarse_pass' \(did you mean net.coarse_pass\?\)"),
        ({"max_disparity": 96}, r"did you mean scenes.max_disparity or net.max_disparity\?"),
        ({"net": "wide"}, "net must be a JSON object"),
    ],
)
def test_refused_overrides(values, words):
    with pytest.raises(InputError, match=words):
        override(get_recipe("procedural"), values)


def test_a_duration():
    recipe = override(get_recipe("procedural"), {"duration": "12m"})
    assert recipe.seconds == 720 and recipe.steps is not None
    assert override(recipe, {"duration": "1.5h", "steps": None}).seconds == 5400
    assert override(recipe, {"duration": "90s"}).seconds == 90
    assert get_recipe("procedural").seconds is None


def test_a_run_by_the_clock_records_its_steps(tmp_path):
    before = override(get_recipe("procedural"), {"duration": "12m", "steps": None})
    path = tmp_path / "recipe.json"
    path.write_text(override(before, {"steps": 1234}).to_json())
    after = get_recipe(str(path))
    assert after.steps == 1234 and before.changes(after) == ""
    assert override(before, {"duration": "13m"}).changes(after) == "duration 13m -> 12m"
    assert override(after, {"duration": None}).steps == 1234


def _lr_by_epoch(recipe: Recipe, steps_per_epoch: int) -> list[float]:
    """Learning rate of every epoch, which must not change within it."""
    assert recipe.epochs is not None
    steps = recipe.epochs * steps_per_epoch
    factors = [recipe.lr_factor(step / steps) for step in range(steps)]
    epochs = [factors[i : i + steps_per_epoch] for i in range(0, steps, steps_per_epoch)]
    assert all(max(epoch) - min(epoch) < 1e-12 for epoch in epochs)
    return [recipe.lr * epoch[0] for epoch in epochs]


def test_paper_schedule_on_sceneflow():
    recipe = get_recipe("paper-sceneflow")
    # 20 epochs, halved after epochs 10, 12, 14 and 16.
    expected = [1e-3] * 10 + [5e-4] * 2 + [2.5e-4] * 2 + [1.25e-4] * 2 + [6.25e-5] * 4
    for steps_per_epoch in (1, 7, 4431):
        assert _lr_by_epoch(recipe, steps_per_epoch) == pytest.approx(expected)
    assert (recipe.batch_size, recipe.augment.height, recipe.augment.width) == (8, 256, 512)
    assert recipe.full_heads is None and recipe.cross_entropy == 0


def test_paper_schedule_on_kitti():
    # 400 epochs, divided by 10 after 200; 160 pairs in batches of 8 are 20 steps.
    lr = _lr_by_epoch(get_recipe("paper-kitti2015"), 20)
    assert lr == pytest.approx([1e-3] * 200 + [1e-4] * 200)


def test_published_schedules():
    for steps_per_epoch in (1, 13):
        for name, expected in {
            "gwcnet-sceneflow": [1e-3] * 10 + [5e-4] * 2 + [2.5e-4] * 2 + [1.25e-4] * 2,
            "gwcnet-kitti2015": [1e-3] * 200 + [1e-4] * 100,
            "psmnet-sceneflow": [1e-3] * 10,
            "deeppruner-sceneflow": [1e-3] * 20 + [7e-4] * 20 + [3e-4] * 20 + [1e-4] * 4,
            "deeppruner-kitti2015": [1e-4] * 500 + [5e-5] * 500 + [1e-5] * 40,
            "ganet-kitti2015": [1e-3] * 400 + [1e-4] * 400,
            "mccnn-slow-kitti2015": [3e-3] * 11 + [3e-4] * 3,
        }.items():
            assert _lr_by_epoch(get_recipe(name), steps_per_epoch) == pytest.approx(expected)
    for name, expected in {
        "dispnet-c-sceneflow": {0: 1, 299_999: 1, 300_000: 0.5, 400_000: 0.25, 500_000: 0.125},
        "fast-ds-cs-sceneflow": {0: 0.1, 4_999: 0.1, 5_000: 1, 349_999: 1},
        "fast-ds-cs-kitti2015": {0: 1, 149_999: 1, 150_000: 0.1, 199_999: 0.1, 200_000: 0.01},
    }.items():
        recipe = get_recipe(name)
        assert recipe.steps is not None
        found = {step: recipe.lr_factor(step / recipe.steps) for step in expected}
        assert found == pytest.approx(expected), name


def test_published_recipes_are_those_that_their_networks_name():
    page = (ROOT / "docs/training.md").read_text("utf-8")
    for name in list_models():
        assert set(model_info(name).recipes) <= RECIPES.keys()
    for name, recipe in RECIPES.items():
        info = model_info(recipe.model)
        assert name in info.recipes or name.startswith("procedural")
        assert f"| `{name}` " in page
        crop = [side for side in (recipe.augment.height, recipe.augment.width) if side is not None]
        assert [fitting_side(info.network, side) for side in crop] == crop
        assert set(recipe.net) <= {part.name for part in fields(info.config)}


def test_an_optimizer_has_its_options():
    weights = [torch.nn.Parameter(torch.ones(3))]
    for name, options in {
        "adam": {"weight_decay": 0.25, "betas": [0.5, 0.75]},
        "sgd": {"momentum": 0.5},
        "rmsprop": {"alpha": 0.5},
        "muon": {},
    }.items():
        recipe = override(RECIPES["procedural"], {"optimizer": name, "optimizer_options": options})
        optimizer = make_optimizer(name, weights, recipe.lr, recipe.optimizer_options)
        assert type(optimizer) is OPTIMIZERS[name]
        (group, *_) = optimizer.param_groups
        assert group["lr"] == recipe.lr
        assert {key: group[key] for key in options} == {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in options.items()
        }


def test_our_schedule_warms_up_and_decays():
    recipe = get_recipe("procedural")
    factors = [recipe.lr_factor(share) for share in (0.0, 0.01, 0.02, 0.5, 0.75, 1.0)]
    assert factors == pytest.approx([0.01, 0.505, 1.0, 1.0, 0.505, 0.01])
    tail = [recipe.lr_factor(0.5 + 0.05 * i) for i in range(11)]
    assert all(a > b for a, b in pairwise(tail))


POSITIVE = st.integers(1, 10_000)
VALUES = st.fixed_dictionaries(
    {},
    optional={
        "batch_size": POSITIVE,
        "lr": st.floats(1e-9, 10, allow_nan=False),
        "seed": st.integers(0, 2**32 - 1),
        "clip": st.none() | st.floats(1e-3, 10),
        "full_heads": st.none() | st.integers(1, 4),
        "textures": st.none() | st.text(min_size=1, max_size=20),
        "net.max_disparity": st.sampled_from([64, 192]),
        "net.cost_volume": st.sampled_from(["correlation", "interlaced-2"]),
        "augment.noise": st.floats(0, 1),
        "augment.scale": st.tuples(st.floats(-0.5, 0), st.floats(0, 0.5)),
        "scenes.seed": st.integers(0, 1000),
    },
)


@settings(max_examples=40, deadline=None)
@given(name=st.sampled_from(list(RECIPES)), values=VALUES)
def test_any_recipe_comes_back_from_its_json(name, values):
    recipe = override(get_recipe(name), values)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recipe.json"
        path.write_text(recipe.to_json(), "utf-8")
        assert read_recipe(path) == recipe


def test_named_recipes_are_commented_files():
    assert [path.stem for path in RECIPE_FILES] == list(RECIPES)
    assert all(path.read_text("utf-8").startswith("# ") for path in RECIPE_FILES)
    changed = differences(RECIPES["procedural-plain"], RECIPES["procedural"])
    names = {"full_heads", "cross_entropy", "volume_cross_entropy", "zero_residuals"}
    assert changed.keys() == {"net.estimator", *names}
