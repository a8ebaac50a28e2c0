"""Recordings for Rerun, opened by its own library."""

import re

import cv2
import numpy as np
import pytest
from noise_pairs import centre, make_pair

from extras import need_extra
from mobilestereonet import Calibration, InputError, StereoResult
from mobilestereonet.inference import load_pair
from mobilestereonet.streams import RerunLog, StereoFrame


@pytest.fixture
def read_recording():
    """Gives the last value of each component of a recording, and the entities' times."""
    rerun = need_extra("rerun")
    from rerun.chunk import RrdReader

    assert rerun

    def read(path):
        values, times = {}, {}
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                column = [entry for entry in batch.column(name).to_pylist() if entry is not None]
                if name in ("time", "frame"):
                    times.setdefault(chunk.entity_path, {}).setdefault(name, []).extend(column)
                elif ":" in name and column:
                    values[chunk.entity_path, name.rpartition(":")[2]] = column[-1]
        return values, times

    return read


def grid(values, entity, dtype, shape=(48, 160)):
    """The pixels of an image that was logged."""
    return np.frombuffer(bytes(values[entity, "buffer"][0]), dtype).reshape(shape)


def test_a_sequence_is_recorded(msnet, sequence, read_recording):
    out = sequence / "new/out.rrd"
    views = sequence / "left", sequence / "right"
    depth = "--focal", 100, "--baseline", 0.2
    code, told, err = msnet("video", *views, "--rerun", out, *depth, "--model", "sgbm")
    assert (code, err) == (0, "")
    assert re.match(rf"{out}: 11 frames", told)
    assert list(out.parent.iterdir()) == [out]
    values, times = read_recording(out)
    entities = {entity for entity, _ in values}
    images = {"/camera/left/image", "/camera/right/image", "/disparity"}
    assert entities >= {"/camera/left", "/camera/left/depth", "/points", *images}
    for entity in (*images, "/camera/left", "/camera/left/depth", "/points"):
        assert sorted(times[entity]["frame"]) == list(range(11))
    disparity = grid(values, "/disparity", np.float32)
    assert np.median(centre(disparity)) == pytest.approx(20, abs=0.1)
    metres = grid(values, "/camera/left/depth", np.float32)
    assert np.median(centre(metres)) == pytest.approx(100 * 0.2 / 20, rel=0.02)
    matrix = np.ravel(values["/camera/left", "image_from_camera"]).reshape(3, 3).T
    np.testing.assert_allclose(matrix, [[100, 0, 79.5], [0, 100, 23.5], [0, 0, 1]])
    assert len(values["/points", "positions"]) == len(values["/points", "colors"]) > 1000


def test_stamps_confidence_and_pictures(tmp_path, read_recording):
    pair = load_pair(*make_pair(8))
    disparity = np.full((48, 160), 8, np.float32)
    confidence = np.full((48, 160), 0.5, np.float32)
    result = StereoResult(pair.left_image, disparity, disparity > 0, confidence)
    stamp = 1_700_000_000_123_456_789
    with RerunLog(tmp_path / "a.rrd", max_depth=1) as log:
        frame = StereoFrame(7, "7", 0.5, pair, stamp=stamp)
        log.write(frame, result, Calibration(focal=100, baseline=0.2))
    values, times = read_recording(tmp_path / "a.rrd")
    (time,) = times["/confidence"]["time"]
    assert time.value == stamp  # a timestamp of pandas
    assert times["/confidence"]["frame"] == [7]
    assert (grid(values, "/confidence", np.uint8) == 128).all()
    assert ("/points", "positions") not in values or not values["/points", "positions"]
    jpeg = np.frombuffer(bytes(values["/camera/left/image", "blob"][0]), np.uint8)
    shown = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)[..., ::-1].astype(int)
    assert np.abs(shown - pair.left_image).mean() < 12


def test_a_log_that_fails_leaves_nothing(tmp_path, read_recording):
    disparity = np.ones((4, 4), np.float32)
    result = StereoResult(np.zeros((4, 4, 3), np.uint8), disparity, disparity > 0)
    frame = StereoFrame(0, "0", 0.0, None)
    wrong = Calibration(focal=9, baseline=1, size=(8, 8))
    with pytest.raises(InputError, match="of 8x8"), RerunLog(tmp_path / "a.rrd") as log:
        log.write(frame, result, None)
        log.write(frame, result, wrong)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("target", ["a.rrs", "live", "http://localhost", "folder.rrd"])
def test_what_is_no_target_is_told(tmp_path, monkeypatch, target):
    need_extra("rerun")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.rrd").mkdir()
    with pytest.raises(InputError, match=r"a file that ends in .rrd|is a folder"):
        RerunLog(target)
