"""Pairs on a local Ray cluster, one of whose two workers is killed."""

import os
import signal
import sys
from functools import partial

import cv2
import noise_pairs
import numpy as np
import pytest
from noise_pairs import centre, make_pair

from extras import need_extra
from mobilestereonet import StereoMatcher
from mobilestereonet.errors import InputError
from mobilestereonet.inference.arrangement import AS_GIVEN
from mobilestereonet.streams import MapFiles, find_pairs, match_on_ray, match_pairs
from mobilestereonet.streams.cluster import _Worker

pytestmark = pytest.mark.slow

COUNT = 24


class DyingMatcher(StereoMatcher):
    """Notes each pair that it matches; the process that comes to ``deadly`` first is killed."""

    def match(self, pair):
        result = super().match(pair)
        disparity = round(float(np.median(centre(result.disparity))))
        with (self.folder / "matched.txt").open("a") as file:
            file.write(f"{disparity} {os.getpid()}\n")
        killed = self.folder / "killed"
        if disparity == self.deadly and not killed.exists():
            killed.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return result


def make_matcher(folder, deadly):
    matcher = DyingMatcher.from_pretrained("sgbm", max_disparity=64)
    matcher.folder, matcher.deadly = folder, deadly
    return matcher


def notes(folder):
    return [line.split() for line in (folder / "matched.txt").read_text().splitlines()]


def test_a_killed_worker_loses_nothing_and_what_is_finished_stays(tmp_path):
    need_extra("ray.data")
    from ray import cloudpickle

    # The workers cannot import what only tests have.
    for module in (sys.modules[__name__], noise_pairs):
        cloudpickle.register_pickle_by_value(module)
    for index in range(COUNT):
        for side, view in zip(("left", "right"), make_pair(index + 1, index), strict=True):
            (tmp_path / side).mkdir(exist_ok=True)
            assert cv2.imwrite(str(tmp_path / side / f"{index:02d}.png"), view)
    pairs = find_pairs(tmp_path / "left", tmp_path / "right")
    files = MapFiles(tmp_path / "maps", ("disparity.png", "picture.png"))
    make = partial(make_matcher, tmp_path, 14)

    # An earlier run had finished three pairs, and one of the two maps of a fourth.
    earlier = pairs[:3] + pairs[20:21]
    list(match_pairs(earlier, StereoMatcher.from_pretrained("sgbm", max_disparity=64), files))
    files.path("20", "picture.png").unlink()
    before = {path: path.stat().st_mtime_ns for path in files.folder.glob("0[0-2]_*")}

    outcomes = list(match_on_ray(pairs, files, make))
    assert sorted(outcome.name for outcome in outcomes) == [pair.name for pair in pairs[3:]]
    assert not any(outcome.problem for outcome in outcomes)
    assert (tmp_path / "killed").exists()
    # No file is missing, half-written or left over, and each is of its own pair.
    names = {f"{i:02d}_{kind}" for i in range(COUNT) for kind in files.kinds}
    assert {path.name for path in files.folder.iterdir()} == names
    for index in range(COUNT):
        stored = cv2.imread(str(files.path(f"{index:02d}", "disparity.png")), -1) / 256
        assert np.median(centre(stored)) == pytest.approx(index + 1, abs=0.1)
        assert cv2.imread(str(files.path(f"{index:02d}", "picture.png"))) is not None
    # What was finished was not matched again: neither the earlier run's, nor the dead worker's but
    # for the few that it had matched and not written yet.
    assert {path: path.stat().st_mtime_ns for path in before} == before
    matched = [int(disparity) for disparity, _ in notes(tmp_path)]
    assert set(matched) == set(range(4, COUNT + 1))
    assert len(matched) <= COUNT - 3 + 4
    assert len({process for _, process in notes(tmp_path)}) >= 2
    assert list(match_on_ray(pairs, files, make)) == []


def test_a_worker_keeps_opencv_to_its_cores(tmp_path):
    before = cv2.getNumThreads()
    try:
        _Worker([], MapFiles(tmp_path), lambda: None, before + 1, None, AS_GIVEN)
        assert cv2.getNumThreads() == before + 1
    finally:
        cv2.setNumThreads(before)


def test_a_cluster_that_is_not_there(tmp_path, sequence):
    need_extra("ray.data")
    pairs = find_pairs(sequence / "left", sequence / "right")
    with pytest.raises(InputError, match="no Ray cluster at 'auto'"):
        list(match_on_ray(pairs, MapFiles(tmp_path / "maps"), lambda: None, address="auto"))
