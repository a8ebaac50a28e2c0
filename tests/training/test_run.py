import csv
import itertools
import logging
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from mobilestereonet.data import write_pfm, write_png
from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from mobilestereonet.scenes import SceneConfig
from mobilestereonet.training.callbacks import AtomicCheckpoints, TimeLimit
from mobilestereonet.training.data import RunData
from mobilestereonet.training.named_recipes import get_recipe, read_recipe
from mobilestereonet.training.recipe import Recipe, override
from mobilestereonet.training.run import train
from mobilestereonet.weights import load_model, save_weights

pytestmark = pytest.mark.filterwarnings("ignore")
RECIPE = Recipe(
    model="table3a-v1-v1",
    net={"max_disparity": 32},
    scenes=SceneConfig(
        height=48, width=64, max_disparity=20, min_disparity=4, noise_textures=16, texture_size=32
    ),
    augment=AugmentConfig(height=32, width=48),
    val_scenes=1,
    batch_size=1,
    steps=2,
    ema=0.9,
)


def _train(folder, recipe=RECIPE, **options):
    return train(recipe, folder, accelerator="cpu", progress=False, **options)


def test_a_run_and_its_folder(tmp_path, monkeypatch):
    said = []
    for module in ("run", "module"):
        monkeypatch.setattr(f"mobilestereonet.training.{module}.rank_zero_info", said.append)
    folder = tmp_path / "new" / "run"
    module = _train(folder)
    assert said[-1] == f"{folder}/weights.safetensors: {RECIPE.model} after 2 of 2 steps"
    names = {path.name for path in folder.iterdir()}
    assert names == {"recipe.json", "last.ckpt", "csv", "tensorboard", "weights.safetensors"}
    assert read_recipe(folder / "recipe.json") == RECIPE
    figures = (folder / "csv" / "version_0" / "metrics.csv").read_text()
    assert sum(bool(row["val/epe"]) for row in csv.DictReader(figures.splitlines())) == 1
    weights = load_file(folder / "weights.safetensors")
    saved = load_model(folder / "weights.safetensors").state_dict()
    for name, value in module.net.named_parameters():
        assert torch.equal(saved[name], value), name

    of_checkpoint = load_model(folder / "last.ckpt")
    assert of_checkpoint.config == load_model(folder).config
    for name, value in of_checkpoint.named_parameters():
        assert torch.equal(saved[name], value), name

    with pytest.raises(InputError, match="holds a run already"):
        _train(folder)
    with pytest.raises(InputError, match="not from msnet2d: leave --weights out"):
        _train(folder, replace(RECIPE, weights="msnet2d"), resume=True)
    # Nothing is left to do, but the weights were lost: they are the averaged ones again.
    (folder / "weights.safetensors").unlink()
    _train(folder, resume=True)
    again = load_file(folder / "weights.safetensors")
    assert all(torch.equal(again[name], weights[name]) for name in weights)
    current = torch.load(folder / "last.ckpt", weights_only=False)["current_model_state"]
    name = "heads.1.score.weight"
    assert not torch.equal(weights[name], current[f"net.{name}"])

    assert not any("has changed" in line for line in said)
    noisy = replace(RECIPE, lr=2 * RECIPE.lr, augment=replace(RECIPE.augment, noise=0.5))
    _train(folder, noisy, resume=True, precision="bf16-mixed")
    change = f"augment.noise {RECIPE.augment.noise} -> 0.5, lr {RECIPE.lr} -> {2 * RECIPE.lr}"
    assert any(line.endswith(change) for line in said)
    change = "precision has changed: 32-true -> bf16-mixed; --precision 32-true keeps it"
    assert any(line.endswith(change) for line in said)


def test_pairs_without_ground_truth_are_refused_before_the_first_step(tmp_path):
    for view in ("left", "right"):
        write_png(tmp_path / "pairs" / view / "0.png", np.zeros((32, 48, 3), np.uint8))
    recipe = replace(RECIPE, data="folder", root=str(tmp_path / "pairs"))
    with pytest.raises(InputError, match=r"no ground truth: .*data_options\.disparity"):
        _train(tmp_path / "run", recipe)
    assert not (tmp_path / "run").exists()


def test_initial_weights(tmp_path):
    initial = tmp_path / "initial.safetensors"
    torch.manual_seed(99)
    save_weights(build_model(RECIPE.model, max_disparity=32), initial, dtype=torch.float32)
    before = load_file(initial)
    recipe = replace(RECIPE, steps=1, lr=1e-9, ema=0.0, weights=str(initial))
    after = _train(tmp_path / "run", recipe).net.state_dict()
    for name in ("features.first.0.0.weight", "heads.1.score.weight"):
        assert torch.allclose(after[name], before[name], atol=1e-7)
    with pytest.raises(InputError, match=r"table3a-v1-v1; add --set net\.max_disparity=32$"):
        _train(tmp_path / "other", override(recipe, {"net.max_disparity": 64}))
    with pytest.raises(
        InputError,
        match=r"v1-v1: it holds msnet2d; add --set model=msnet2d --set net.max_disparity=192",
    ):
        _train(tmp_path / "other", replace(recipe, weights="msnet2d"))
    assert not (tmp_path / "other").exists()


def test_a_coarse_pass_starts_from_weights_without_one(tmp_path):
    initial = tmp_path / "initial.safetensors"
    save_weights(build_model("table3b-v1-v2", max_disparity=32), initial)
    crop = AugmentConfig(height=32, width=64)
    recipe = replace(RECIPE, model="table3b-v1-v2", weights=str(initial), steps=1, augment=crop)
    _train(tmp_path / "coarse", override(recipe, {"net.coarse_pass": True}))
    coarse = str(tmp_path / "coarse/weights.safetensors")
    assert load_model(coarse).config.coarse_pass
    with pytest.raises(InputError, match=r"table3b-v1-v2; add --set net\.coarse_pass=true$"):
        _train(tmp_path / "plain", replace(recipe, weights=coarse))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"precision": "fp99"}, "Precision 'fp99'"),
        ({"max_time": "3h"}, "DD:HH:MM:SS"),
        ({"resume": True}, "nothing to resume"),
        ({"recipe": replace(RECIPE, batch_size=10**6)}, "a batch_size of 1000000 with crops of"),
        ({"recipe": replace(RECIPE, model="msnet4d")}, "unknown model"),
        ({"recipe": replace(RECIPE, data="kitti2015")}, "--root"),
        ({"recipe": replace(RECIPE, root="pairs")}, "root is .*pairs: choose a data set"),
    ],
)
def test_refused_settings(options, words, tmp_path):
    with pytest.raises(InputError, match=words):
        _train(tmp_path / "run", **options)


def test_wrong_number_of_processes(tmp_path, monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(InputError, match="2 processes were started for 1 x 1 devices"):
        _train(tmp_path / "run")


def test_every_process_validates_something():
    data = RunData(replace(RECIPE, val_scenes=3), 0)
    shares = []
    for rank in range(2):
        data.trainer = SimpleNamespace(
            world_size=2, global_rank=rank, strategy=SimpleNamespace(root_device="cpu")
        )
        data.setup("fit")
        shares.append([sample.name for sample in data.val_dataloader()])
    assert shares == [["scene 0", "scene 2"], ["scene 1"]]
    data.trainer.world_size = 4
    with pytest.raises(InputError, match="3 validation pairs are too few for 4 processes"):
        data.val_dataloader()


def test_validation_scenes_are_not_trained_on():
    data = RunData(RECIPE, 0)
    train_scenes, val_scenes = data.training("cpu"), data.validation("cpu")
    assert not torch.allclose(train_scenes[0].left, val_scenes[0].left, atol=0.1)


def test_worker_processes_change_nothing():
    found = []
    for workers in (0, 1, 3):
        data = RunData(replace(RECIPE, uses=2, pool=4, batch_size=2), workers)
        strategy = SimpleNamespace(root_device=torch.device("cpu"))
        data.trainer = SimpleNamespace(
            world_size=1, global_rank=0, global_step=0, max_steps=5, strategy=strategy
        )
        data.setup("fit")
        loader = data.train_dataloader()
        assert loader.num_workers == workers
        batches = [data.on_after_batch_transfer(delivery, 0).augmented for delivery in loader]
        assert len(batches) == 5
        found.append(batches)
    # Where there are workers, a GPU is left to the training.
    strategy.root_device = torch.device("cuda")
    data.setup("fit")
    assert data.train_source.device.type == "cpu"
    for batches in found[1:]:
        for own, others in zip(found[0], batches, strict=True):
            assert torch.equal(own.left, others.left)
            assert torch.equal(own.disparity, others.disparity)
    validation = next(iter(data.val_dataloader()))
    assert data.on_after_batch_transfer(validation, 0) is validation


def test_files_of_any_size(tmp_path):
    rng = np.random.default_rng(0)
    for index in range(3):
        size = (50 + index, 70)
        for side in ("left", "right"):
            view = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
            write_png(tmp_path / f"data/{side}/{index}.png", view)
        truth = rng.uniform(1, 20, size).astype(np.float32)
        write_pfm(tmp_path / f"data/disparity/{index}.pfm", truth)
    options = {"disparity": "disparity/*.pfm"}
    recipe = replace(
        RECIPE, data="folder", data_options=options, val_options=options, steps=None, epochs=2,
        batch_size=2, val_every=1, root=str(tmp_path / "data"),
    )  # fmt: skip
    module = _train(tmp_path / "run", recipe)
    assert module.steps == 3  # two passes over three pairs, two at a time
    log = (tmp_path / "run/csv/version_0/metrics.csv").read_text().splitlines()
    column = log[0].split(",").index("val/epe")
    figures = [float(row.split(",")[column]) for row in log[1:] if row.split(",")[column]]
    assert len(figures) == 3 and all(0 < figure < 32 for figure in figures)
    # The advice on a teacher is for training pairs.
    with pytest.raises(InputError, match=r"no ground truth.* or set a teacher"):
        RunData(replace(recipe, data_options={}), 0)
    with pytest.raises(InputError, match="no ground truth") as refused:
        RunData(replace(recipe, val_options={}), 0)
    assert "teacher" not in str(refused.value) and "val_options.disparity" in str(refused.value)


def test_a_recipe_finds_its_files_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = replace(RECIPE, root="pairs", textures="/photographs", weights="a.safetensors")
    recipe = replace(recipe, teacher="msnet2d", cross_entropy=1.0).with_absolute_paths()
    here = str(tmp_path)
    paths = (recipe.root, recipe.textures, recipe.weights, recipe.teacher)
    assert paths == (f"{here}/pairs", "/photographs", f"{here}/a.safetensors", "msnet2d")


def test_logging_and_warnings_are_as_they_were(tmp_path):
    logger = logging.getLogger("lightning.pytorch.utilities.rank_zero")
    before = (list(logger.filters), logger.level, list(warnings.filters))
    _train(tmp_path, replace(RECIPE, steps=1))
    with pytest.raises(InputError, match="Precision 'fp99'"):
        _train(tmp_path / "other", precision="fp99")
    assert (list(logger.filters), logger.level, list(warnings.filters)) == before


class Malicious:
    """A pickle that touches a file when it is read."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (type(self.path).touch, (self.path,))


@pytest.mark.parametrize("kind", ["code", "damaged"])
def test_a_foreign_checkpoint_runs_no_code(kind, tmp_path):
    folder, touched = tmp_path / "run", tmp_path / "touched"
    _train(folder, replace(RECIPE, steps=1))
    checkpoint = torch.load(folder / "last.ckpt", weights_only=True)
    if kind == "code":
        checkpoint["callbacks"]["extra"] = Malicious(touched)
        torch.save(checkpoint, folder / "last.ckpt")
    else:
        (folder / "last.ckpt").write_bytes(b"PK" + bytes(100))
    with pytest.raises(InputError, match=r"last\.ckpt: not a checkpoint of `msnet train`"):
        _train(folder, resume=True)
    assert not touched.exists()
    if kind == "code":
        torch.load(folder / "last.ckpt", weights_only=False)
        assert touched.exists()  # it would have


def test_time_limit_starts_anew():
    limit = TimeLimit("00:00:01:00")
    limit.load_state_dict({"time_elapsed": {"train": 1e6}})
    assert limit.time_remaining() == 60


def test_time_is_up(tmp_path):
    _train(tmp_path, replace(RECIPE, steps=10_000, save_every=10_000), max_time="00:00:00:01")
    step = torch.load(tmp_path / "last.ckpt", weights_only=False)["global_step"]
    assert 0 < step < 1000 and (tmp_path / "weights.safetensors").is_file()


def _rates(folder):
    """Learning rates of all starts, in order."""
    lines = [path.read_text().splitlines() for path in sorted(folder.glob("csv/*/metrics.csv"))]
    rows = [row for log in lines for row in csv.DictReader(log)]
    return [float(row["train/lr"]) for row in rows if row.get("train/lr")]


def test_a_schedule_by_the_clock(tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr("mobilestereonet.training.run.rank_zero_info", said.append)
    # Every look at the clock takes a twentieth of a second.
    clock = SimpleNamespace(monotonic=(count / 20 for count in itertools.count()).__next__)
    monkeypatch.setattr("lightning.pytorch.callbacks.timer.time", clock)
    by_clock = replace(
        RECIPE, steps=None, duration="2.5s", schedule=((0.0, 1.0), (1.0, 0.0)), val_every=10_000
    )
    folder = tmp_path / "run"
    _train(folder, by_clock, max_time="00:00:00:01")
    half = torch.load(folder / "last.ckpt", weights_only=True)
    elapsed = half["callbacks"]["Clock"]["time_elapsed"]["train"]
    assert 0.9 < elapsed < 1.4 and said[-1].endswith("steps; --resume goes on")
    assert read_recipe(folder / "recipe.json").steps == half["global_step"] > 0
    assert not read_recipe(folder / "recipe.json").changes(by_clock)

    _train(folder, by_clock, resume=True)
    whole = torch.load(folder / "last.ckpt", weights_only=True)
    assert 2.5 <= whole["callbacks"]["Clock"]["time_elapsed"]["train"] < 3
    steps = whole["global_step"]
    assert steps > half["global_step"] and said[-1].endswith(f"after {steps} steps")
    rates = _rates(folder)
    full = RECIPE.lr / RECIPE.lr_batch
    assert rates == sorted(rates, reverse=True) and rates[0] > 0.6 * full > rates[-1]
    assert whole["lr_schedulers"][0]["_last_lr"][0] < 0.2 * full

    # Nothing is left to do.
    _train(folder, by_clock, resume=True)
    assert torch.load(folder / "last.ckpt", weights_only=True)["global_step"] == steps
    # Its recipe without the duration repeats it.
    again = override(get_recipe(str(folder / "recipe.json")), {"duration": None})
    assert again.steps == steps
    assert _train(tmp_path / "again", replace(again, steps=2)).steps == 2


def test_a_checkpoint_is_whole_or_absent(tmp_path, monkeypatch):
    path = tmp_path / "last.ckpt"
    AtomicCheckpoints().save_checkpoint({"step": 1}, path)

    def fail(checkpoint, file):
        file.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(KeyboardInterrupt):
        AtomicCheckpoints().save_checkpoint({"step": 2}, path)
    assert torch.load(path) == {"step": 1}
