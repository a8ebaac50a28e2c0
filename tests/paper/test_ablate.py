import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from mobilestereonet.cli.main import main
from mobilestereonet.data import write_png
from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from mobilestereonet.paper import ablate as module
from mobilestereonet.paper.ablate import ablate, ablation_table, table_models, variants
from mobilestereonet.scenes import SceneConfig
from mobilestereonet.training.data import RunData
from mobilestereonet.training.named_recipes import get_recipe
from mobilestereonet.training.recipe import Recipe, override
from mobilestereonet.weights import load_model, save_weights

pytestmark = pytest.mark.filterwarnings("ignore")
MODELS = ["table3a-v1-v1", "table3a-v1-v2"]
RECIPE = Recipe(
    net={"max_disparity": 32},
    scenes=SceneConfig(
        height=48, width=64, max_disparity=20, min_disparity=4, noise_textures=16, texture_size=32
    ),
    augment=AugmentConfig(height=32, width=48),
    val_scenes=2,
    batch_size=1,
    steps=2,
)


def test_the_papers_tables():
    volumes = ["concatenation", "correlation", *(f"interlaced-{i}" for i in (1, 2, 4, 8, 16))]
    assert table_models("2") == [f"table2-{volume}" for volume in volumes]
    sizes = {name: len(table_models(name)) for name in ("3a", "3b", "appendix2d", "appendix3d")}
    assert sizes == {"3a": 9, "3b": 9, "appendix2d": 4, "appendix3d": 4}
    assert table_models("appendix2d")[0] == "appendix2d-conv-conv"
    with pytest.raises(InputError, match="unknown table '4'"):
        table_models("4")


def test_two_networks(tmp_path, monkeypatch):
    trained = []

    def counted(recipe, folder, **options):
        trained.append((recipe.model, options["resume"]))
        return train(recipe, folder, **options)

    train = module.train
    monkeypatch.setattr(module, "train", counted)
    options = {"accelerator": "cpu", "progress": False}
    write_png(tmp_path / "photographs" / "0.png", np.full((32, 32, 3), 200, np.uint8))
    monkeypatch.chdir(tmp_path)
    relative = replace(RECIPE, textures="photographs")
    first = next(ablate(variants(relative, MODELS), tmp_path, **options))
    (tmp_path / "photographs").rename(tmp_path / "moved")
    recipe = replace(RECIPE, textures="moved")
    rows = list(ablate(variants(recipe, MODELS), tmp_path, **options))
    assert trained == [(MODELS[0], False), (MODELS[1], False)]
    assert [row.model for row in rows] == MODELS and rows[0] == first

    # The figures are those of the exported weights on the validation scenes.
    scenes = RunData(recipe, 0).validation("cpu")
    for row in rows:
        run = tmp_path / row.model
        net = load_model(run / "weights.safetensors")
        errors = []
        for index in range(2):
            scene = scenes[index]
            mean = torch.tensor([0.485, 0.456, 0.406])[:, None, None]
            std = torch.tensor([0.229, 0.224, 0.225])[:, None, None]
            views = [((view - mean) / std)[None] for view in (scene.left, scene.right)]
            with torch.no_grad():
                disparity = net(*views).disparity[0]
            mask = scene.valid & (scene.disparity > 0) & (scene.disparity < 32)
            errors.append((disparity - scene.disparity).abs()[mask].mean().item())
        assert row.figures["EPE"] == pytest.approx(sum(errors) / 2, rel=1e-4)
        assert row.pairs == 2 and 0 <= row.figures["px-3"] <= 100
    record = json.loads((tmp_path / "ablation.json").read_text())
    assert [row["model"] for row in record["rows"]] == MODELS
    assert record["recipe"]["steps"] == 2

    # What was scored is not trained again, what was started is resumed.
    (tmp_path / MODELS[1] / "score.json").unlink()
    assert list(ablate(variants(recipe, MODELS), tmp_path, **options)) == rows
    assert trained[2:] == [(MODELS[1], True)]
    with pytest.raises(InputError, match=r"under another recipe \(lr 0.001 -> 1.0\)"):
        next(ablate(variants(replace(recipe, lr=1.0), MODELS), tmp_path, **options))
    with pytest.raises(InputError, match=r"\(textures .*photographs -> None\)"):
        next(ablate(variants(RECIPE, MODELS), tmp_path, **options))


def test_scenes_rendered_on_a_gpu_are_scored_on_the_cpu(tmp_path):
    scenes = RunData(RECIPE, 0).validation("cpu")

    class OnGpu:
        """A sample that only a copy to the CPU makes one."""

        def __init__(self, index):
            self.index = index

        def map(self, function):
            assert function is torch.Tensor.cpu
            return scenes[self.index]

    save_weights(build_model(MODELS[0], max_disparity=32), tmp_path / "weights.safetensors")
    row = module._score(replace(RECIPE, model=MODELS[0]), tmp_path, [OnGpu(0), OnGpu(1)], "cpu")
    assert row.pairs == 2 and row.figures["EPE"] > 0


def test_the_command(tmp_path, monkeypatch, capsys):
    values = {
        "net.max_disparity": 32,
        "val_scenes": 1,
        "batch_size": 1,
        "augment.height": 32,
        "augment.width": 48,
        "scenes.height": 48,
        "scenes.width": 64,
        "scenes.max_disparity": 20,
        "scenes.min_disparity": 4,
        "scenes.noise_textures": 16,
        "scenes.texture_size": 32,
    }
    arguments = ["msnet", "ablate", str(tmp_path), "--models", "table2-correlation", "--steps", "1"]
    arguments += ["--accelerator", "cpu", "--no-progress"]
    arguments += [f"--set={key}={value}" for key, value in values.items()]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    out = capsys.readouterr().out
    record = json.loads((tmp_path / "ablation.json").read_text())
    figures = record["rows"][0]["figures"]
    assert f"table2-correlation: EPE {figures['EPE']:.3f} px (1 of 1 done)" in out
    line = next(line for line in out.splitlines() if line.startswith(" table2-correlation"))
    cells = line.split()
    # The paper's Table 2: EPE 1.71, D1 6.80, px-3 7.84.
    assert cells[2::2] == ["1.71", "6.80", "7.84"]
    assert cells[1] == f"{figures['EPE']:.3f}"
    assert cells[3::2] == [f"{figures[name]:.2f}" for name in ("D1", "px-3")]
    expected = override(
        get_recipe("procedural"), {**values, "steps": 1, "model": "table2-correlation"}
    )
    assert record["recipe"] == json.loads(expected.to_json())


def test_a_network_that_is_in_no_table():
    rows = [module.AblationRow("msnet9d", 3, {"EPE": 1.0, "D1": 2.0, "px-3": 3.0})]
    table = ablation_table(rows, RECIPE)
    assert [column.heading for column in table.columns] == [
        "model",
        "EPE (px)",
        "D1 (%)",
        "px-3 (%)",
    ]
    assert "one seed" in table.notes


def test_variants_are_all_combinations():
    found = variants(
        RECIPE,
        ["msnet2d"],
        {"lr": [1e-3, 5e-4], "net.cost_volume": ["correlation", "concatenation"]},
        seeds=2,
    )
    assert len(found) == 8
    assert found[3].label == "msnet2d, lr=0.001, net.cost_volume=concatenation"
    assert found[3].folder == "msnet2d,lr=0.001,net.cost_volume=concatenation.seed1"
    assert found[3].recipe.net == {"max_disparity": 32, "cost_volume": "concatenation"}
    assert [variant.recipe.seed for variant in found] == [0, 1] * 4
    assert [v.label for v in variants(RECIPE, ["msnet2d"], {"model": ["msnet3d"]})] == ["msnet3d"]
    for vary, words in (
        ({"lr": ["fast"]}, "lr must be a number, got 'fast'"),
        ({"net.cost_volume": ["correlated"]}, "cost_volume"),
        ({"colour": [1]}, "no value 'colour'"),
        ({"lr": [1, 1.0]}, "comes twice"),
    ):
        with pytest.raises(InputError, match=words):
            variants(RECIPE, ["msnet2d"], vary)


def test_seeds_are_one_row_and_scores_of_older_versions_load(tmp_path):
    runs = variants(RECIPE, ["msnet2d"], seeds=2)
    for variant, epe in zip(runs, (1.0, 2.0), strict=True):
        folder = tmp_path / variant.folder
        folder.mkdir()
        figures = {"EPE": epe, "D1": 2.0, "px-3": 3.0}
        score = {"model": "msnet2d", "pairs": 2, "figures": figures}
        (folder / "score.json").write_text(json.dumps(score))
    rows = list(ablate(runs, tmp_path))
    assert [(row.label, row.seed) for row in rows] == [("msnet2d", 0), ("msnet2d", 1)]
    text = ablation_table(rows, RECIPE).render("markdown")
    assert "1.500 ± 0.707" in text and "one seed" not in text
    assert "1.14" in text  # of the paper's Table 4a


def test_values_from_the_command_line(tmp_path, msnet):
    score = {"model": "msnet2d", "pairs": 2, "figures": {"EPE": 1, "D1": 2, "px-3": 3}}
    for folder in ("msnet2d,lr=0.001", "msnet2d,lr=0.0005"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "score.json").write_text(json.dumps(score))
    arguments = ("ablate", tmp_path, "--vary", "lr=1e-3,5e-4", "--format", "csv")
    code, out, err = msnet(*arguments, "-o", tmp_path / "table.tex")
    assert code == 0
    assert out.splitlines()[1:] == ['"msnet2d, lr=0.001",1,2,3', '"msnet2d, lr=0.0005",1,2,3']
    assert "2 of 2 done" in err and "figures: " in err
    assert r"\toprule" in (tmp_path / "table.tex").read_text()
