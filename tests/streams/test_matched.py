"""`match_stream`: a loop over any source."""

import time

import numpy as np
import pytest
from noise_pairs import centre, make_pair

from mobilestereonet import Calibration, InputError
from mobilestereonet.inference import load_pair
from mobilestereonet.streams import StereoFrame, Stream, match_stream, open_stream


def test_a_loop_over_folders(matcher, sequence):
    (sequence / "left" / "view_5.png").write_bytes(b"")
    folders = str(sequence / "left"), str(sequence / "right")
    calibration = Calibration(focal=100, baseline=0.2)
    loop = match_stream(folders[0], matcher, right=folders[1], calibration=calibration)
    with pytest.warns(UserWarning, match="frame view_5 is left out: .*not an image"):
        results = list(loop)
    assert [frame.index for frame, _ in results] == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10]
    for frame, result in results:
        assert np.median(centre(result.disparity)) == pytest.approx(10 + frame.index, abs=0.1)
        assert frame.calibration is calibration
    with pytest.raises(InputError, match="two folders"):
        next(match_stream(folders[0], matcher))


def test_a_loop_that_ends_early_closes_its_source(matcher, sequence):
    stream = open_stream(str(sequence / "left"), str(sequence / "right"))
    loop = match_stream(stream, matcher)
    next(loop)
    loop.close()
    assert next(stream.frames, None) is None
    assert matcher.count <= 2


def test_real_time_drops_what_comes_while_matching(matcher, monkeypatch):
    pair = load_pair(*make_pair(9))

    def frames():
        for index in range(20):
            yield StereoFrame(index, str(index), 0.02 * index, pair)

    match = type(matcher).match

    def slow(self, pair):
        time.sleep(0.07)
        return match(self, pair)

    monkeypatch.setattr(type(matcher), "match", slow)
    started = time.monotonic()
    taken = [
        frame.index for frame, _ in match_stream(Stream(frames(), 20), matcher, real_time=True)
    ]
    assert time.monotonic() - started > 0.38  # as long as it took to record
    assert taken == sorted(taken)
    assert taken[-1] == 19
    assert len(taken) < 15
