"""Captures, tried on files that OpenCV opens as one."""

import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import numpy as np
import pytest
from noise_pairs import make_pair

from mobilestereonet.errors import InputError
from mobilestereonet.streams import MapFiles, captures, match_video, open_stream
from mobilestereonet.streams.stream import check_sizes, make_frame


def joined(count):
    return [np.concatenate(make_pair(10 + index, index), axis=1) for index in range(count)]


def test_a_side_by_side_capture_is_split(write_capture):
    colours = np.array([[[200, 40, 20 * index], [30, 90, 220]] for index in range(4)], np.uint8)
    pictures = [np.tile(pair.repeat(160, axis=0), (48, 1, 1)) for pair in colours]
    path = write_capture("camera.avi", pictures)
    stream = open_stream(f"file://{path}")
    assert (stream.total, stream.live) == (None, False)
    frames = list(stream.frames)
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    assert [frame.seconds for frame in frames] == pytest.approx([0, 0.1, 0.2, 0.3])
    for frame, colour in zip(frames, colours, strict=True):
        for view, expected in zip((frame.pair.left, frame.pair.right), colour, strict=True):
            assert view.shape == (3, 48, 160)
            middle = 255 * view[:, 10:-10, 10:-10].mean(dim=(1, 2)).numpy()
            assert middle == pytest.approx(expected, abs=5)


def test_two_captures_end_with_the_shorter_one(write_capture):
    left, right = zip(*(make_pair(12, seed) for seed in range(3)), strict=True)
    first, second = write_capture("l.avi", left), write_capture("r.avi", right[:2])
    frames = list(open_stream(f"file://{first}", f"file://{second}").frames)
    assert len(frames) == 2
    assert frames[0].pair.right.shape == (3, 48, 160)


def test_a_live_capture_does_not_wait(write_capture, monkeypatch, matcher, tmp_path):
    path = write_capture("camera.avi", joined(40))
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    handler = partial(SimpleHTTPRequestHandler, directory=path.parent)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        stream = open_stream(f"http://127.0.0.1:{server.server_port}/camera.avi")
        assert stream.live
        reported = []

        def slowly(frame):
            reported.append(frame.index)
            time.sleep(0.05)

        maps = MapFiles(tmp_path / "maps")
        with pytest.warns(UserWarning, match=r"camera.avi: gave no more pictures after 40 frames"):
            stats = match_video(stream, matcher, frames=maps, report=slowly)
        server.shutdown()
    assert reported == sorted(set(reported))
    assert reported[-1] == 39
    assert stats.matched == len(reported) < 40
    assert stats.matched + stats.dropped == 40
    assert len(list((tmp_path / "maps").iterdir())) == stats.matched


def test_a_picture_that_cannot_be_decoded_is_told(write_capture, monkeypatch):
    path = write_capture("camera.avi", joined(3))

    class Flawed:
        """OpenCV's capture, but its second picture is damaged."""

        def __init__(self, source):
            self.capture, self.taken = opened(source), 0

        def __getattr__(self, name):
            return getattr(self.capture, name)

        def retrieve(self):
            self.taken += 1
            return (False, None) if self.taken == 2 else self.capture.retrieve()

    opened = captures.cv2.VideoCapture
    monkeypatch.setattr(captures.cv2, "VideoCapture", Flawed)
    frames = list(open_stream(f"file://{path}").frames)
    assert [frame.pair is None for frame in frames] == [False, True, False]
    assert "damaged" in frames[1].problem


@pytest.mark.parametrize(
    ("shapes", "message"),
    [([(48, 321, 3)], "even width"), ([(48, 160, 3), (50, 160, 3)], "one size")],
)
def test_a_frame_of_another_geometry_is_told_not_raised(shapes, message):
    frame = make_frame(4, 0.4, [np.zeros(shape, np.uint8) for shape in shapes])
    assert (frame.index, frame.pair) == (4, None)
    assert message in frame.problem


def test_a_folder_is_no_camera_even_if_its_name_is_a_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "00").mkdir()
    sources = {"00": False, "01": True, "²": False, "left": False, "rtsp://x/" + 300 * "y": True}
    assert {source: captures.is_capture(source) for source in sources} == sources


def test_bad_captures_are_errors(tmp_path, write_capture):
    wide, narrow = (write_capture(f"{n}.avi", [np.zeros((48, n, 3), np.uint8)]) for n in (160, 96))
    with pytest.raises(InputError, match=r"160.avi has 160x48, .*96.avi has 96x48"):
        open_stream(f"file://{wide}", f"file://{narrow}")
    with pytest.raises(InputError, match="0 is 161 px wide"):
        check_sizes(["0"], [(161, 48)])  # OpenCV writes no such file
    (tmp_path / "text.avi").write_text("no video")
    with pytest.raises(InputError, match=r"text.avi: OpenCV cannot open"):
        open_stream(f"file://{tmp_path}/text.avi")
    with pytest.raises(InputError, match="only one of them"):
        open_stream("0", str(wide))
