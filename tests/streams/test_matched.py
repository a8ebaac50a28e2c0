"""`StereoMatcher.stream`: a loop over any source."""

import time

import cv2
import numpy as np
import pytest
from noise_pairs import centre, make_pair

from mobilestereonet import Calibration, InputError, StereoResult
from mobilestereonet.data.rig import Camera, CameraPair, Rig
from mobilestereonet.inference import Rectifier, load_pair
from mobilestereonet.inference.first_look import ViewOptions
from mobilestereonet.streams import (
    StereoFrame,
    Stream,
    look_at_pairs,
    look_at_stream,
    open_stream,
)
from mobilestereonet.streams.pairs import PairFiles


def test_a_loop_over_folders(matcher, sequence):
    (sequence / "left" / "view_5.png").write_bytes(b"")
    calibration = Calibration(focal=100, baseline=0.2)
    loop = matcher.stream(sequence / "left", right=str(sequence / "right"), rig=calibration)
    with pytest.warns(UserWarning, match="frame view_5 is left out: .*not an image"):
        results = list(loop)
    assert [result.frame.index for result in results] == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10]
    for result in results:
        index = result.frame.index
        assert np.median(centre(result.disparity)) == pytest.approx(10 + index, abs=0.1)
        known = result.calibration
        assert (known.focal, known.baseline, known.size) == (100, 0.2, (160, 48))
        assert np.median(centre(result.depth())) == pytest.approx(20 / (10 + index), rel=0.01)
    assert isinstance(result, StereoResult)
    with pytest.raises(TypeError, match="rihgt"):
        next(matcher.stream(str(sequence / "left"), rihgt=str(sequence / "right")))
    with pytest.raises(InputError, match="the source is the left view"):
        next(matcher.stream(str(sequence), left="left", right="right"))


def test_a_loop_that_ends_early_closes_its_source(matcher, sequence):
    stream = open_stream(str(sequence / "left"), str(sequence / "right"))
    loop = matcher.stream(stream)
    next(loop)
    loop.close()
    assert next(stream.frames, None) is None
    assert matcher.count <= 2


def test_options_of_an_opened_source_are_refused(matcher, sequence):
    stream = open_stream(str(sequence / "left"), str(sequence / "right"))
    with pytest.raises(InputError, match="fps, layout: give them to open_stream"):
        next(matcher.stream(stream, layout="top-bottom", fps=3))


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
    loop = matcher.stream(Stream(frames(), 20), drop=True)
    taken = [result.frame.index for result in loop]
    assert time.monotonic() - started > 0.38  # as long as it took to record
    assert taken == sorted(taken)
    assert taken[-1] == 19
    assert len(taken) < 15


def raw_rig():
    """Two cameras, of which the right one alone is turned."""
    camera = Camera(np.array([[200.0, 0, 80], [0, 200, 24], [0, 0, 1]]), np.zeros(5))
    turned = cv2.Rodrigues(np.array([0, 0, 0.1]))[0]
    return Rig((CameraPair(camera, camera, turned, np.array([-0.1, 0, 0]), (160, 48)),))


def stream_of(*pairs, **known):
    def frames():
        for index, pair in enumerate(pairs):
            yield StereoFrame(index, str(index), index / 10, load_pair(*pair))

    return Stream(frames(), len(pairs), **known)


def test_frames_of_a_rig_are_rectified_once(matcher, sequence):
    matcher.rectifier = Rectifier(raw_rig())
    left, right = sequence / "left", sequence / "right"
    expected = matcher.rectifier.pair(load_pair(left / "view_0.png", right / "view_0.png"))
    result = next(matcher.stream(str(left), right=str(right)))
    np.testing.assert_array_equal(result.left, expected.left_image)
    assert result.frame.calibration == result.calibration == expected.calibration
    rig, matcher.rectifier = matcher.rectifier.rig, None
    again = next(matcher.stream(str(left), right=str(right), rig=rig))
    np.testing.assert_array_equal(result.left, again.left)


def test_a_raw_rig_and_a_source_that_is_rectified_are_refused(matcher, tmp_path):
    matcher.rectifier = Rectifier(raw_rig())
    calibration = Calibration(focal=100, baseline=0.2)
    pair = make_pair(9)
    with pytest.raises(InputError, match="rectified already"):
        next(matcher.stream(stream_of(pair, calibration=calibration)))
    paths = tmp_path / "left.png", tmp_path / "right.png"
    for path, view in zip(paths, pair, strict=True):
        cv2.imwrite(str(path), view)
    files = [PairFiles("a", *paths, calibration=calibration)]
    with pytest.raises(InputError, match="rectified already"):
        look_at_pairs(files, rectifier=matcher.rectifier)


def test_what_the_source_knows_follows_its_views(matcher):
    calibration = Calibration(focal=100, baseline=0.2, doffs=3, cx=70, cy=20)
    left, right = make_pair(9)
    turned = [np.ascontiguousarray(view[::-1, ::-1]) for view in (right, left)]
    options = ViewOptions(order="right-left", rotate=180)
    _, stream = look_at_stream(stream_of(turned, calibration=calibration), options)
    assert (stream.calibration.cx, stream.calibration.cy) == (159 - 73, 47 - 20)
    assert stream.calibration.doffs == 3
    np.testing.assert_array_equal(next(stream.frames).pair.left_image, left)
    with pytest.raises(InputError, match="--rotate 0"):
        look_at_stream(stream_of((left, right), calibration=calibration), ViewOptions(rotate=90))


def test_a_stream_that_starts_in_the_dark(matcher):
    dark = np.zeros((48, 160, 3), np.uint8)
    left, right = make_pair(9)
    frames = [(dark, dark), (dark, dark + 1), (right, left), (right, left)]
    findings, stream = look_at_stream(stream_of(*frames))
    assert {f.check: f.level for f in findings}["order"] == "fixed"
    pairs = [frame.pair for frame in stream.frames]
    assert len(pairs) == 4
    np.testing.assert_array_equal(pairs[3].left_image, left)
    findings, stream = look_at_stream(stream_of(*frames[:2]))
    assert [f.check for f in findings if f.level == "problem"] == ["content"]
    assert len(list(stream.frames)) == 2


def test_a_source_of_one_view_is_refused(matcher):
    left, right = make_pair(9)
    single, both = make_pair(9, seed=1)[0], np.hstack([left, right])
    dark = np.zeros_like(both)
    words = "halves are not two views of one scene"
    with pytest.raises(InputError, match=f"{words}.*right view, too"):
        look_at_stream(stream_of((single,), (single,)))
    with pytest.raises(InputError, match=words):
        next(matcher.stream(stream_of((single,), (single,))))
    _, stream = look_at_stream(stream_of((single,)), ViewOptions(layout="side-by-side"))
    assert next(stream.frames).pair.width == 80
    findings, stream = look_at_stream(stream_of((dark,), (dark + 9,), (both,)))
    assert {f.level for f in findings} == {"good"}
    assert len(list(stream.frames)) == 3
    findings, _ = look_at_stream(stream_of((dark,), (dark,)))  # only its own problem
    assert [f.check for f in findings if f.level == "problem"] == ["content"]
