"""Folders of pairs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from noise_pairs import centre

from mobilestereonet.data import Calibration, Rig
from mobilestereonet.data.rig import Camera, CameraPair
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier, load_pair
from mobilestereonet.streams import MAP_KINDS, MapFiles, find_pairs, match_pairs
from mobilestereonet.streams.pairs import PairFiles


@pytest.fixture
def pairs(sequence):
    return find_pairs(sequence / "left", sequence / "right")


def test_every_pair_gets_its_maps_and_a_broken_one_does_not_stop_them(pairs, matcher, tmp_path):
    pairs[4].right.write_bytes(b"broken")
    cv2.imwrite(str(pairs[5].left), np.zeros((4, 4, 3), np.uint8))
    files = MapFiles(tmp_path / "maps", ("disparity.npy", "picture.png"))
    outcomes = list(match_pairs(pairs, matcher, files))
    assert [outcome.name for outcome in outcomes] == [pair.name for pair in pairs]
    assert {outcome.name for outcome in outcomes if outcome.problem} == {"view_4", "view_5"}
    assert len(list(files.folder.iterdir())) == 2 * 9
    assert files.unfinished(pairs) == pairs[4:6]
    for index in (0, 10):
        disparity = np.load(files.path(f"view_{index}", "disparity.npy"))
        assert np.median(centre(disparity)) == pytest.approx(10 + index, abs=0.1)


def test_a_pair_is_finished_when_all_its_maps_are_there(pairs, matcher, tmp_path):
    files = MapFiles(tmp_path / "maps", ("disparity.png", "disparity.pfm"))
    list(match_pairs(pairs[:3], matcher, files))
    files.path("view_1", "disparity.pfm").unlink()
    assert [pair.name for pair in files.unfinished(pairs[:4])] == ["view_1", "view_3"]


def test_every_kind_of_map_is_written_and_read_back(pairs, matcher, tmp_path):
    files = MapFiles(tmp_path / "maps", MAP_KINDS)
    calibration = Calibration(focal=50, baseline=0.1)
    deep = PairFiles("deep/er/x", pairs[2].left, pairs[2].right, calibration)
    assert [outcome.problem for outcome in match_pairs([deep], matcher, files)] == [""]
    names = {path.name for path in (files.folder / "deep" / "er").iterdir()}
    assert names == {f"x_{kind}" for kind in MAP_KINDS}
    depth = np.load(files.path(deep.name, "depth.npy"))
    assert np.median(centre(depth)) == pytest.approx(5 / 12, rel=0.01)
    other = replace(pairs[0], calibration=replace(calibration, size=(8, 8)))
    first, second = match_pairs([other, replace(deep, name="again")], matcher, files)
    assert "the calibration is of views of 8x8" in first.problem
    assert not second.problem
    left, right = (cv2.imread(str(view)) for view in (deep.left, deep.right))
    with pytest.raises(InputError, match="the calibration is of views of 8x8"):
        files.save("view_0", matcher(left, right), other.calibration)
    assert not list(files.folder.glob("view_0*"))
    with pytest.raises(InputError, match="depth needs a calibration, and view_0 has none"):
        list(match_pairs(pairs[:1], matcher, files))
    with pytest.raises(InputError, match=r"got \['depth.exr'\]"):
        MapFiles(tmp_path, ("depth.exr",))


def test_raw_pairs_are_rectified_and_have_depth(pairs, matcher, tmp_path):
    camera = Camera(np.array([[300.0, 0, 60], [0, 300, 30], [0, 0, 1]]), np.zeros(0))
    turned = cv2.Rodrigues(np.array([0.0, 0.0, 0.01]))[0]
    rig = Rig((CameraPair(camera, camera, turned, np.array([-0.1, 0, 0])),))
    files = MapFiles(tmp_path / "maps", ("depth.npy",))
    rectifier = Rectifier(rig)
    statuses = match_pairs(pairs[:1], matcher, files, rectifier=rectifier)
    assert [status.problem for status in statuses] == [""]
    expected = matcher.match(rectifier.pair(load_pair(pairs[0].left, pairs[0].right)))
    np.testing.assert_array_equal(np.load(tmp_path / "maps/view_0_depth.npy"), expected.depth())
