import json

import cv2
import numpy as np
import pytest

from mobilestereonet.cli.data import preview
from mobilestereonet.data import data_sets, write_pfm, write_png
from mobilestereonet.errors import InputError

SCENES = ["height=48", "width=80", "noise_textures=16", "texture_size=32", "max_disparity=20",
          "min_disparity=4"]  # fmt: skip


def _preview(name, output, **options):
    preview(
        name,
        output,
        **{"root": None, "textures": None, "count": 2, "seed": 0, "split": None} | options,
    )
    picture = cv2.imread(str(output))
    assert picture is not None
    return picture


def test_procedural_scenes(tmp_path, capsys):
    one = _preview("procedural", tmp_path / "one.png", count=1, assignments=SCENES)
    two = _preview("procedural", tmp_path / "two.png", count=2, assignments=SCENES)
    assert "two.png: 2 pairs of procedural" in capsys.readouterr().out
    assert two.shape[0] == 2 * one.shape[0] and two.shape[1] == one.shape[1] > 4 * 300
    assert (two[: len(one)] == one).all()
    other = _preview("procedural", tmp_path / "other.png", count=1, seed=5, assignments=SCENES)
    assert np.abs(other.astype(int) - one).mean() > 5


def test_frames_of_a_data_set(tmp_path, capsys):
    for index in range(5):
        level = np.full((30, 60, 3), 40 * index + 20, np.uint8)
        write_png(tmp_path / f"set/left/{index}.png", level)
        write_png(tmp_path / f"set/right/{index}.png", level)
        write_pfm(tmp_path / f"set/disparity/{index}.pfm", np.full((30, 60), 5.0, np.float32))
    options = {"root": tmp_path / "set", "assignments": ["disparity=disparity/*.pfm"]}
    sheet = _preview("folder", tmp_path / "a.png", count=9, **options)
    assert "5 pairs of folder" in capsys.readouterr().out
    rows = sheet.reshape(5, -1, *sheet.shape[1:])
    middles = [row[len(row) // 2, 160].tolist() for row in rows]
    assert middles == [[40 * index + 20] * 3 for index in range(5)]
    few = [_preview("folder", tmp_path / f"{s}.png", seed=s, **options) for s in (0, 0, 1, 2, 3)]
    assert (few[0] == few[1]).all() and any((few[0] != other).any() for other in few[2:])


def test_bad_input(tmp_path):
    with pytest.raises(InputError, match="kitti2015 needs its folder: --root"):
        _preview("kitti2015", tmp_path / "x.png")
    with pytest.raises(InputError, match="unknown data set 'kitty'"):
        _preview("kitty", tmp_path / "x.png", root=tmp_path)
    with pytest.raises(InputError, match="no value 'colour'"):
        _preview("procedural", tmp_path / "x.png", assignments=["colour=red"])
    assert not list(tmp_path.iterdir())


def test_a_split(tmp_path):
    for split, level in (("train", 40), ("test", 200)):
        for side in ("left", "right"):
            write_png(
                tmp_path / f"{split}/part1/000000/{side}.png",
                np.full((30, 60, 3), level, np.uint8),
            )
        write_png(
            tmp_path / f"{split}/part1/000000/left_disp.png", np.full((30, 60), 500, np.uint16)
        )
    with pytest.warns(UserWarning, match=r"instereo2k \(test\): expected 50 frames, found 1"):
        sheet = _preview("instereo2k", tmp_path / "a.png", root=tmp_path, split="test")
    assert sheet[100, 160].tolist() == [200] * 3
    with pytest.raises(InputError, match="unknown split, did you mean test"):
        _preview("instereo2k", tmp_path / "a.png", root=tmp_path, split="tets")
    with pytest.raises(InputError, match="procedural scenes have no split test"):
        _preview("procedural", tmp_path / "a.png", split="test")


def test_list(msnet):
    code, out, _ = msnet("data", "list")
    assert code == 0
    for words in ("kitti2015", "training (200)", "testing*", "spring", "fsd", "rectification"):
        assert words in " ".join(out.split())
    code, out, _ = msnet("data", "list", "--json")
    records = {record["name"]: record for record in json.loads(out)}
    assert set(records) == set(data_sets())
    assert records["middeval3"] == {
        "name": "middeval3",
        "summary": "Middlebury's third evaluation: 15 training scenes, 15 test scenes, in three "
        "sizes.",
        "splits": {"training": 15, "test": 15},
        "withheld": ["test"],
        "options": {"size": "Q"},
    }
    code, _, told = msnet("data", "preview", "kitty", "-o", "x.png")
    assert code == 2 and "did you mean vkitti2?" in told
