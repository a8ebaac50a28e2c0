import csv
import dataclasses
import io
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from rich.console import Console

from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.data import write_disparity_png, write_pfm, write_png
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation import (
    PAPER_COLUMNS,
    ResultTable,
    Spread,
    compare_evaluations,
    comparison_table,
    evaluate,
    leaderboard_columns,
)
from mobilestereonet.evaluation.result_table import ENDINGS, TableColumn
from mobilestereonet.nets import build_model
from mobilestereonet.paper.tables import printed_errors
from mobilestereonet.training.recipe import Recipe, override
from mobilestereonet.training.seeds import group_by_seed
from mobilestereonet.weights import save_weights

ROWS = {
    "a_b|c": [{"EPE": 1.0, "D1": 10.0, "px-3": None}, {"EPE": 2.0, "D1": 10.0, "px-3": 3.0}],
    "<d>": [{"EPE": 0.5, "D1": 4.0, "px-3": 3.0}],
}
TABLE = comparison_table(
    ROWS, PAPER_COLUMNS, title="some & more", printed={"<d>": {"epe": 0.4}, "x": {"d1": 1.0}}
)


def test_mean_and_deviation_over_seeds():
    assert Spread.of([1.0, 2.0, 3.0]) == (2.0, 1.0)
    assert Spread.of([5.0]) == (5.0, None)
    assert Spread.of([5.0, None]) is None and Spread.of([]) is None
    headings = [column.heading for column in TABLE.columns]
    assert headings == ["model", "seeds", "EPE (px)", "EPE, paper", "D1 (%)", "px-3 (%)"]
    first, second = TABLE.rows
    assert first == (
        "a_b|c",
        (2, None),
        (1.5, pytest.approx(0.70711, abs=1e-5)),
        None,
        (10, 0),
        None,
    )
    assert second == ("<d>", (1, None), (0.5, None), (0.4, None), (4, None), (3, None))


def test_formats():
    markdown = TABLE.render("markdown").splitlines()
    assert markdown[0] == "some & more"
    assert [cell.strip() for cell in markdown[4].split(" | ")] == [
        *(r"| a_b\|c", "2", "1.500 ± 0.707", "-", "10.00 ± 0.00", "- |"),
    ]
    latex = TABLE.render("latex")
    assert r"a\_b|c" in latex and r"1.500 $\pm$ 0.707" in latex and r"\bottomrule" in latex
    assert r"D1 (\%)" in latex
    html = TABLE.render("html")
    assert "&lt;d&gt;" in html and "some &amp; more" in html and 'charset="utf-8"' in html
    found = list(csv.DictReader(io.StringIO(TABLE.render("csv"))))
    assert [row["EPE (px)"] for row in found] == ["1.5", "0.5"]
    assert float(found[0]["EPE (px) std"]) == pytest.approx(0.5**0.5)
    assert found[1]["EPE (px) std"] == found[0]["px-3 (%)"] == ""
    with pytest.raises(InputError, match="format latx: did you mean latex"):
        TABLE.render("latx")


def test_files_and_the_terminal(tmp_path):
    for ending, format in ENDINGS.items():
        TABLE.write(tmp_path / f"t{ending}")
        text = (tmp_path / f"t{ending}").read_bytes().decode()
        assert text == TABLE.render(format)
    with pytest.raises(InputError, match=r"t\.xls: tables are written as \.md, \.tex"):
        TABLE.write(tmp_path / "t.xls")
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(TABLE)
    assert "1.500 ± 0.707" in console.export_text()


def test_a_table_without_rows():
    table = ResultTable("none", (TableColumn("model"),), ())
    assert all(table.render(format) for format in ENDINGS.values())


def _evaluation(error, occluded=None):
    left = torch.rand(3, 4, 6) / 2 + 0.2
    truth = left[0] * 100
    sample = StereoSample(left, left, truth, truth > 0, occluded=occluded, name="a")
    match = lambda left, right: left[:, 0] * 100 + error  # noqa: E731
    return evaluate(match, [sample], model="m", data_name="made up")


def test_columns_are_those_of_the_leaderboard():
    hidden = (torch.arange(6) < 3).expand(4, 6)
    groups = {"m": [_evaluation(2.5, hidden), _evaluation(1.5, hidden)]}
    table = compare_evaluations(groups, "eth3d")
    assert [column.heading for column in table.columns] == [
        *("model", "seeds", "bad 1.0 noc (%)", "avgerr noc (px)", "bad 1.0 all (%)"),
        *("avgerr all (px)", "time (s)"),
    ]
    assert table.rows[0][3].mean == pytest.approx(2.0, abs=1e-4)
    assert [column.title for column in leaderboard_columns("kitti2012")][:2] == [
        "Out-Noc",
        "Out-All",
    ]
    assert leaderboard_columns("sceneflow") == PAPER_COLUMNS
    # What a copy of the data does not know is empty, not 0.
    table = compare_evaluations({"m": [_evaluation(2.5)]}, "kitti2015")
    assert table.rows[0][1:3] == (None, None)
    with pytest.raises(InputError, match="statistic mode: there are mean, median"):
        compare_evaluations(groups, "eth3d", statistic="mode")


def test_the_papers_errors():
    sceneflow, kitti = printed_errors("sceneflow"), printed_errors("kitti2015")
    assert sceneflow["msnet2d"] == {"epe": 1.14}
    assert sceneflow["table2-correlation"] == {"epe": 1.71, "d1": 6.80, "bad3": 7.84}
    assert sceneflow["appendix3d-v2-conv"] == {"epe": 0.99}
    assert kitti["msnet3d"] == {"epe": 0.66, "d1": 1.59, "bad3": 1.69}
    with pytest.raises(InputError, match="no errors on eth3d, only on sceneflow, kitti2015"):
        printed_errors("eth3d")


def test_runs_that_differ_by_their_seed():
    recipe = Recipe(model="msnet2d", steps=5)
    recipes = {
        "a": recipe,
        "b": dataclasses.replace(recipe, seed=1),
        "c": override(recipe, {"lr": 5e-4, "net.max_disparity": 96}),
        "d": override(recipe, {"model": "msnet3d"}),
    }
    assert group_by_seed(recipes) == {
        "msnet2d, lr=0.001": ["a", "b"],
        "msnet2d, net.max_disparity=96, lr=0.0005": ["c"],
        "msnet3d": ["d"],
    }
    photos = [dataclasses.replace(recipe, textures=folder) for folder in ("/one", "/moved", None)]
    assert group_by_seed(dict(zip("abc", photos, strict=True))) == {
        "msnet2d, textures=/one": ["a", "b"],
        "msnet2d, textures=None": ["c"],
    }
    timed = [override(recipe, {"duration": "5m", "steps": steps}) for steps in (7, 8)]
    assert list(group_by_seed({"a": timed[0], "b": timed[1]}).values()) == [["a", "b"]]


def test_networks_of_one_name_are_two_rows():
    recipes = {name: Recipe(model=f"{name}/net.py:Net", steps=5) for name in "xy"}
    assert group_by_seed(recipes) == {"net.py:Net": ["x"], "net.py:Net (2)": ["y"]}


@pytest.fixture
def pairs(tmp_path):
    folder = tmp_path / "pairs"
    noise = np.random.default_rng(0).integers(0, 255, (64, 104, 3), dtype=np.uint8)
    write_png(folder / "left/0.png", np.ascontiguousarray(noise[:, :96]))
    write_png(folder / "right/0.png", np.ascontiguousarray(noise[:, 8:]))
    write_pfm(folder / "disparity/0.pfm", np.full((64, 96), 8, np.float32))
    return ("--data", "folder", "--root", folder, "--set", "disparity=disparity/*.pfm")


def _run(folder, seed, **values):
    torch.manual_seed(seed)
    folder.mkdir(parents=True)
    recipe = Recipe(model="msnet2d", net={"max_disparity": 32}, steps=1, seed=seed, **values)
    (folder / "recipe.json").write_text(recipe.to_json())
    save_weights(build_model("msnet2d", max_disparity=32), folder / "weights.safetensors")


def test_compare_command(tmp_path, pairs, msnet, monkeypatch):
    """The first model is wrong by 1 px, the next by 2, and so on."""
    opened = []

    class Wrong:
        def __init__(self, options):
            opened.append(options)
            self.model, self.error = options.model or "msnet2d", len(opened)

        def disparity(self, left, right):
            return torch.full_like(left[:, 0], 8.0 + self.error)

    monkeypatch.setattr(MatcherOptions, "open_matcher", lambda options, **_: Wrong(options))
    runs = tmp_path / "runs"
    _run(runs / "a", 0)
    _run(runs / "b", 1)
    _run(runs / "slow", 0, lr=1e-4)
    (runs / "ablation.json").write_text("{}")
    table = tmp_path / "table.csv"
    code, out, err = msnet(
        "compare", *sorted(runs.iterdir()), "sgbm", *pairs, "--no-refine", "-o", table
    )
    assert code == 0, err
    assert "ablation.json: neither a run nor weights, left out" in err
    rows = list(csv.DictReader(table.open(newline="")))
    labels = ["msnet2d, lr=0.001", "msnet2d, lr=0.0001", "sgbm"]
    assert [(row["model"], row["seeds"]) for row in rows] == list(zip(labels, "211", strict=True))
    assert "lr=0.0001" in out and "1.500 ±" in out
    assert [float(row["EPE (px)"]) for row in rows[:2]] == [1.5, 3]
    assert float(rows[0]["EPE (px) std"]) == pytest.approx(0.5**0.5)
    assert float(rows[2]["EPE (px)"]) == 4
    code, of_folder, err = msnet("compare", runs, "--format", "csv", *pairs)
    assert (code, [row["seeds"] for row in csv.DictReader(io.StringIO(of_folder))]) == (
        0,
        ["2", "1"],
    )
    weights = [options.weights for options in opened[:3]]
    assert weights == [runs / name / "weights.safetensors" for name in ("a", "b", "slow")]
    assert opened[3] == MatcherOptions(model="sgbm")


def test_a_run_beside_the_weights_of_its_network(tmp_path, pairs, msnet, monkeypatch):
    wrong = SimpleNamespace(model="msnet2d", disparity=lambda left, _: torch.ones_like(left[:, 0]))
    monkeypatch.setattr(MatcherOptions, "open_matcher", lambda *_, **__: wrong)
    _run(tmp_path / "mine", 0)
    code, out, _ = msnet("compare", tmp_path / "mine", "msnet2d", "--format", "csv", *pairs)
    assert code == 0
    assert [row["model"] for row in csv.DictReader(io.StringIO(out))] == [
        f"msnet2d ({tmp_path / 'mine'})",
        "msnet2d",
    ]


def test_compare_refuses_what_is_no_run(tmp_path, pairs, msnet):
    _run(tmp_path / "a", 0)
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    (tmp_path / "b/weights.safetensors").unlink()
    shutil.copytree(tmp_path / "a", tmp_path / "own")
    recipe = tmp_path / "own/recipe.json"
    recipe.write_text(recipe.read_text().replace("msnet2d", f"{tmp_path / 'own/net.py'}:Net"))
    (tmp_path / "notes.txt").touch()
    (tmp_path / "net.onnx").touch()
    for sources, words in (
        (("a", "a"), "given twice"),
        (("a", "b"), "the run has no weights.safetensors yet"),
        (("notes.txt",), "no run among them"),
        (("a", "net.onnx"), f"onnx:{tmp_path / 'net.onnx'}"),
        (("a", "msnet4d"), "did you mean msnet"),
        (("a", "absent.safetensors"), "RUN absent.safetensors: no such file"),
        (("own",), "name it by --model of `msnet train` or, with --weights, `msnet evaluate`"),
    ):
        known = [tmp_path / s if (tmp_path / s).exists() else s for s in sources]
        code, _, told = msnet("compare", *known, *pairs)
        assert code == 2 and words in told, told
    code, _, told = msnet("compare", tmp_path / "a", *pairs, "--paper")
    assert code == 2 and "the paper prints no errors on folder" in told


def test_evaluate_compares_several_models(tmp_path, pairs, msnet):
    table = tmp_path / "table.md"
    models = ("--model", "sgbm", "--model", "sgbm")
    code, out, _ = msnet("evaluate", *pairs, *models, "-o", table)
    assert code == 0 and "sgbm (2)" in out and "median" in out
    lines = table.read_text().splitlines()
    assert [line.split(" | ")[0] for line in lines[4:6]] == ["| sgbm    ", "| sgbm (2)"]
    code, out, _ = msnet("evaluate", *pairs, *models[:2], "--format", "html")
    assert code == 0 and out.startswith("<!DOCTYPE html>")


def test_the_papers_figures_beside(tmp_path, msnet):
    training = tmp_path / "training"
    view = np.random.default_rng(0).integers(0, 255, (32, 80, 3), dtype=np.uint8)
    for folder in ("image_2", "image_3"):
        write_png(training / folder / "000002_10.png", view)
    write_disparity_png(training / "disp_occ_0/000002_10.png", np.full((32, 80), 9, np.float32))
    options = ("--data", "kitti2015", "--root", tmp_path, "--split", "val", "--format", "csv")
    _run(tmp_path / "run", 0)
    code, out, err = msnet("compare", tmp_path / "run", "sgbm", *options, "--paper")
    assert code == 0, err
    ours, sgbm = csv.DictReader(io.StringIO(out))
    # The paper's Table 5, where there is a column for it.
    columns = [column for column in ours if column.endswith("paper")]
    assert columns == ["D1-all, paper", "EPE, paper", "px-3, paper"]
    assert [float(ours[column]) for column in columns] == [2.53, 0.79, 2.67]
    assert not any(sgbm[column] for column in columns)
