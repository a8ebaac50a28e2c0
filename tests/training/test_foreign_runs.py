"""Folders of runs that came from somebody else, are damaged, or are in use."""

import json
import pickle
from dataclasses import replace

import pytest
import torch
from test_run import RECIPE, _train

from mobilestereonet.atomic import locked_folder
from mobilestereonet.errors import InputError
from mobilestereonet.training.recipe import Recipe
from mobilestereonet.training.run import train

pytestmark = pytest.mark.filterwarnings("ignore")


class Evil:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "run"
    _train(folder, replace(RECIPE, steps=1, ema=0.0))
    return folder


@pytest.fixture
def checkpoint(run):
    """The run's checkpoint, put right again afterwards."""
    path = run / "last.ckpt"
    content = path.read_bytes()
    yield path
    path.write_bytes(content)


def _without(content, *names):
    return {key: value for key, value in content.items() if key not in names}


@pytest.mark.parametrize(
    "spoil",
    [
        lambda good, path: pickle.dumps(Evil(path)),
        lambda good, path: pickle.dumps({"state_dict": Evil(path)}),
        lambda good, path: {**good, "callbacks": Evil(path)},
        lambda good, path: b"",
        lambda good, path: b"some text",
        lambda good, path: [1, 2],
        lambda good, path: torch.zeros(3),
        lambda good, path: good["state_dict"],
        lambda good, path: _without(good, "optimizer_states"),
        lambda good, path: _without(good, "loops"),
        lambda good, path: {**good, "optimizer_states": []},
        lambda good, path: {**good, "state_dict": {}},
        lambda good, path: {**good, "state_dict": {"net.a": torch.zeros(2)}},
        lambda good, path: {**good, "state_dict": good["state_dict"] | {"a": torch.zeros(2)}},
    ],
)
def test_a_checkpoint_that_is_none_changes_nothing(run, checkpoint, spoil, tmp_path):
    bad = spoil(torch.load(checkpoint, weights_only=True), tmp_path / "evil")
    checkpoint.write_bytes(bad) if isinstance(bad, bytes) else torch.save(bad, checkpoint)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=r"last\.ckpt: .*start anew in another folder"):
        _train(run, replace(RECIPE, steps=2, ema=0.0), resume=True)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    assert not (tmp_path / "evil").exists()


def test_a_checkpoint_that_is_cut_off(run, checkpoint):
    checkpoint.write_bytes(checkpoint.read_bytes()[:-1000])
    with pytest.raises(InputError, match="start anew in another folder"):
        _train(run, replace(RECIPE, steps=2, ema=0.0), resume=True)


@pytest.mark.parametrize("part", ["model", "loss"])
def test_code_beside_a_recipe_is_not_run_unasked(msnet, tmp_path, part):
    folder = tmp_path / "foreign"
    folder.mkdir()
    (folder / "evil.py").write_text(f"open({str(tmp_path / 'evil')!r}, 'w')\n")
    (folder / "last.ckpt").write_bytes(b"")
    record = json.loads(replace(RECIPE, **{part: f"{folder}/evil.py:Net"}).to_json())
    (folder / "recipe.json").write_text(json.dumps(record))
    for command in ([folder, "--resume"], [tmp_path / "new", "--recipe", folder / "recipe.json"]):
        code, _, err = msnet("train", *command, "--accelerator", "cpu")
        assert code == 2
        assert f"its {part} is code that lies beside it" in err
    with pytest.raises(InputError, match="is not run unasked"):
        train(Recipe(steps=1), folder, resume=True)
    assert not (tmp_path / "evil").exists()


def test_one_training_at_a_time(tmp_path):
    with locked_folder(tmp_path), pytest.raises(InputError, match="another training is going on"):
        _train(tmp_path)
    assert list(tmp_path.iterdir()) == []
    with locked_folder(tmp_path), locked_folder(tmp_path, wanted=False):
        pass
    with locked_folder(tmp_path):  # free again
        pass
