"""A stream in, a video and maps out."""

import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from noise_pairs import centre

from extras import need_extra
from mobilestereonet import StereoResult
from mobilestereonet.data import Calibration, Rig
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier
from mobilestereonet.streams import MapFiles, Stream, match_video, open_stream
from mobilestereonet.streams.colours import SmoothedRange
from mobilestereonet.streams.stream import rectify_frames


def flat(disparity):
    shape = (4, 5)
    return StereoResult(
        left=np.zeros((*shape, 3), np.uint8),
        disparity=np.full(shape, disparity, np.float32),
        valid=np.ones(shape, bool),
    )


def opened(sequence):
    return open_stream(str(sequence / "left"), str(sequence / "right"))


def test_the_range_of_colours_follows_slowly():
    colours = SmoothedRange(memory=2.0)
    assert colours.update(0, flat(40)) == 40
    # After two seconds (one memory) of 80, a share of 1 - 1/e of the way is gone.
    values = [colours.update(0.1 * step, flat(80)) for step in range(1, 21)]
    assert values[0] < 43
    assert values[-1] == pytest.approx(40 + 40 * (1 - np.exp(-1)), rel=1e-4)
    unknown = StereoResult(flat(0).left, flat(9).disparity, np.zeros((4, 5), bool))
    assert colours.update(3, unknown) == values[-1]


def rectified(stream, **values):
    """The stream with a calibration."""
    rectifier = Rectifier(Rig((Calibration(**values),)))
    return replace(stream, frames=rectify_frames(stream.frames, rectifier))


def test_each_frame_gets_its_own_map(sequence, matcher, tmp_path):
    maps = MapFiles(tmp_path / "maps", ("disparity.png", "depth.png"))
    reported = []
    stream = rectified(opened(sequence), focal=100, baseline=0.2)
    stats = match_video(stream, matcher, frames=maps, report=reported.append)
    assert (stats.matched, stats.broken, stats.dropped) == (11, 0, 0)
    assert [frame.name for frame in reported] == [f"view_{index}" for index in range(11)]
    for index in range(11):
        stored = cv2.imread(str(maps.path(f"view_{index}", "disparity.png")), -1) / 256
        assert np.median(centre(stored)) == pytest.approx(10 + index, abs=0.1)
        depth = cv2.imread(str(maps.path(f"view_{index}", "depth.png")), -1)
        assert np.median(centre(depth)) == pytest.approx(20_000 / (10 + index), rel=0.02)


def test_frames_that_do_not_fit_the_rig_are_told(sequence, matcher, tmp_path):
    stream = rectified(opened(sequence), focal=100, baseline=0.2, size=(8, 8))
    with pytest.raises(InputError, match=r"no frame could be matched: .*of pictures of 8x8"):
        match_video(stream, matcher, frames=MapFiles(tmp_path / "maps"))


def test_a_broken_frame_is_reported_and_skipped(sequence, matcher, tmp_path):
    (sequence / "right" / "view_4.png").write_bytes(b"broken")
    maps, reported = MapFiles(tmp_path / "maps"), []
    stats = match_video(opened(sequence), matcher, frames=maps, report=reported.append)
    assert (stats.matched, stats.broken, stats.dropped) == (10, 1, 0)
    assert [frame.name for frame in reported if frame.problem] == ["view_4"]
    assert len(list(maps.folder.iterdir())) == 10
    assert not maps.finished("view_4")


def test_a_stopped_sequence_goes_on_where_it_was(sequence, matcher, tmp_path):
    maps, stop = MapFiles(tmp_path / "maps"), threading.Event()

    def stop_after_four(frame):
        if frame.index == 3:
            stop.set()

    stats = match_video(opened(sequence), matcher, frames=maps, stop=stop, report=stop_after_four)
    assert stats.matched == 4
    before = {path.name: path.stat().st_mtime_ns for path in maps.folder.iterdir()}
    matcher.count = 0
    assert match_video(opened(sequence), matcher, frames=maps, resume=True).matched == 11
    assert matcher.count == 7
    after = {path.name: path.stat().st_mtime_ns for path in maps.folder.iterdir()}
    assert (len(before), len(after)) == (4, 11)
    assert before.items() <= after.items()

    deeper = MapFiles(maps.folder, ("disparity.png", "depth.png"))
    matcher.count = 0
    camera = {"focal": 100.0, "baseline": 0.2}
    match_video(rectified(opened(sequence), **camera), matcher, frames=deeper, resume=True)
    assert matcher.count == 0
    depths = {path.name for path in maps.folder.glob("*_depth.png")}
    assert len(depths) == 11
    kept = {path.name: path.stat().st_mtime_ns for path in maps.folder.iterdir()}
    assert after.items() <= kept.items()
    maps.path("view_3", "disparity.png").unlink()  # to be matched again, its depth too
    match_video(rectified(opened(sequence), **camera), matcher, frames=deeper, resume=True)
    assert matcher.count == 1
    again = {path.name: path.stat().st_mtime_ns for path in maps.folder.iterdir()}
    changed = {name for name in kept if again[name] != kept[name]}
    assert changed == {"view_3_disparity.png", "view_3_depth.png"}
    with pytest.raises(InputError, match="to resume"):
        match_video(opened(sequence), matcher, resume=True)


def test_maps_of_another_stream_are_not_taken_for_this_ones(sequence, matcher, tmp_path):
    maps = MapFiles(tmp_path / "maps")
    maps.save("view_0", flat(3), None)
    with pytest.raises(InputError, match=r"view_0_disparity.png: shape is \(4, 5\)"):
        match_video(opened(sequence), matcher, frames=maps, resume=True)


def test_a_live_frame_is_matched_at_once_and_its_source_closed(sequence, matcher, monkeypatch):
    asked, seen, closed = [], [], []

    def camera():
        try:
            for frame in opened(sequence).frames:
                asked.append(frame.index)
                yield frame
        finally:
            closed.append(True)

    match = type(matcher).match

    def slowly(self, pair):
        time.sleep(0.02)
        seen.append(asked[-1])
        return match(self, pair)

    monkeypatch.setattr(type(matcher), "match", slowly)
    stream, stop = Stream(camera(), None, live=True), threading.Event()

    def stop_after_six(frame):
        if frame.index == 5:
            stop.set()

    match_video(stream, matcher, stop=stop, report=stop_after_six)
    assert seen == list(range(len(seen)))
    assert closed == [True]


def test_no_picture_is_made_if_none_is_written(sequence, matcher, tmp_path, monkeypatch):
    monkeypatch.setattr("mobilestereonet.streams.video.SmoothedRange", None)
    maps = MapFiles(tmp_path / "maps")
    assert match_video(opened(sequence), matcher, frames=maps).matched == 11


def test_nothing_is_made_of_a_stream_that_gives_nothing(sequence, matcher, tmp_path):
    for path in (sequence / "left").iterdir():
        path.write_bytes(b"broken")
    with pytest.raises(InputError, match=r"no frame could be matched: .*view_10.png: not an image"):
        match_video(
            opened(sequence),
            matcher,
            video=tmp_path / "new" / "v.mp4",
            frames=MapFiles(tmp_path / "maps"),
        )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["left", "right"]


def test_the_video_shows_the_frames_in_steady_colours(sequence, matcher, tmp_path):
    need_extra("av")
    from mobilestereonet.streams.video_files import VideoFile

    for side in ("left", "right"):
        (sequence / side / "view_2.png").unlink()
        for path in (sequence / side).iterdir():
            path.rename(path.with_name(f"view_{99 - int(path.stem[5:])}.png"))
    assert cv2.imwrite(str(sequence / "left" / "view_92.png"), np.zeros((50, 99, 3), np.uint8))
    assert cv2.imwrite(str(sequence / "right" / "view_92.png"), np.ones((50, 99, 3), np.uint8))
    video = tmp_path / "colours.mp4"
    stats = match_video(opened(sequence), matcher, video=video, beside=True)
    assert (stats.matched, stats.broken) == (9, 1)
    moments = list(VideoFile(video))
    # The fourth of the ten that are left has another size; its place in time stays empty.
    expected = [0, 0.1, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]
    assert [seconds for seconds, _ in moments] == pytest.approx(expected, abs=1e-3)
    assert moments[0][1].shape == (48, 324, 3)
    shown = moments[0][1][:, :160].astype(int)
    left = cv2.imread(str(sequence / "left" / "view_89.png"))[..., ::-1]
    assert np.abs(shown - left).mean() < 20
    # The range follows slowly: as the disparity sinks from 20 to 10 px, dark red turns yellow. A
    # range of each frame's own would keep it red.
    first, last = (np.median(centre(moments[i][1][:, 164:]), axis=(0, 1)) for i in (0, -1))
    assert first[1] < 40
    assert last[1] > 100
