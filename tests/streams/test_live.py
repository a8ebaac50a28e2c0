"""`msnet live`: the newest frame in a window, on a page, in a recording."""

import re
import sys
import urllib.request
from http.client import HTTPConnection
from threading import Event, Thread

import cv2
import numpy as np
import pytest
from noise_pairs import make_pair

from extras import need_extra
from mobilestereonet import Calibration, InputError, StereoResult
from mobilestereonet.inference.filter import MetricFilter
from mobilestereonet.streams import StereoFrame, browser
from mobilestereonet.streams.browser import BrowserPage
from mobilestereonet.streams.show import FrameRate, Screen, Window

QUICK = ("--fps", 100, "--model", "sgbm", "--max-disparity", 64)


class Client(Thread):
    """Reads the pictures of a page until its server ends."""

    def __init__(self, address):
        super().__init__(daemon=True)
        self.address, self.pictures, self.kind = address, [], None

    def run(self):
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(self.address + "pictures", timeout=20) as answer:
            self.kind = answer.headers["Content-Type"]
            while line := answer.readline():
                if line.lower().startswith(b"content-length"):
                    length = int(line.split(b":")[1])
                    answer.readline()
                    jpeg = np.frombuffer(answer.read(length), np.uint8)
                    self.pictures.append(cv2.imdecode(jpeg, cv2.IMREAD_COLOR)[..., ::-1])


def test_a_page_shows_what_the_camera_sees(msnet, sequence, monkeypatch):
    clients = []
    enter = BrowserPage.__enter__

    def visited(page):
        clients.append(Client(page.address))
        clients[0].start()
        return enter(page)

    monkeypatch.setattr(BrowserPage, "__enter__", visited)
    code, out, err = msnet(
        "live", sequence / "left", sequence / "right", "--show", "browser", *QUICK
    )
    assert (code, err) == (0, "")
    address, told, *_ = out.splitlines()
    assert re.fullmatch(r"http://127.0.0.1:\d+/ \(end with Ctrl-C\)", address)
    assert re.fullmatch(r"\d+ frames, \d+\.\d\d per second, sgbm on sgbm int16", told)
    (client,) = clients
    client.join(20)
    assert client.kind.startswith("multipart/x-mixed-replace; boundary=next")
    last = client.pictures[-1]
    assert last.shape == (48 + 24, 160 + 4 + 160, 3)  # a title above two views
    left = cv2.imread(str(sequence / "left/view_10.png"))[..., ::-1].astype(float)
    assert np.abs(last[24:, :160] - left).mean() < 20  # JPEG
    assert last[24:, 164 + 80 : -20].std() < 60  # one colour: the view is of one disparity


@pytest.fixture
def page():
    with BrowserPage() as page:
        yield page


def test_the_page_is_for_this_machine_alone(page):
    host, port = page.address.split("/")[2].split(":")
    assert host == "127.0.0.1"

    def ask(path, name):
        connection = HTTPConnection(host, int(port), timeout=10)
        connection.request("GET", path, headers={"Host": name})
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers

    status, content, headers = ask("/", f"localhost:{port}")
    assert status == 200
    assert b'<img src="pictures"' in content
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert ask("/", f"127.0.0.1:{port}")[0] == 200
    assert ask("/", "evil.example")[0] == ask("/pictures", "evil.example")[0] == 421
    assert ask("/../etc/passwd", "localhost")[0] == 404


def test_who_is_slow_gets_the_newest_picture():
    newest = browser._Newest()
    taken = iter(newest)
    newest.put(b"a")
    assert next(taken) == b"a"
    newest.put(b"b")
    newest.put(b"c")
    newest.end()
    assert list(taken) == [b"c"]


@pytest.fixture
def window(monkeypatch):
    """Stand-in for OpenCV's windows; gives the pictures, and what is pressed."""
    shown, pressed = [], {}
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(cv2, "namedWindow", lambda *_: None)
    monkeypatch.setattr(cv2, "resizeWindow", lambda *_: None)
    monkeypatch.setattr(cv2, "imshow", lambda _, picture: shown.append(picture))
    monkeypatch.setattr(cv2, "waitKey", lambda _: pressed.get(len(shown), -1))
    monkeypatch.setattr(cv2, "getWindowProperty", lambda *_: 1.0)
    monkeypatch.setattr(cv2, "destroyAllWindows", lambda: shown.append("closed"))
    return shown, pressed


@pytest.mark.parametrize("words", [("--show",), ("--show", "window")])
def test_q_ends_it(msnet, sequence, window, words):
    shown, pressed = window
    pressed[2] = ord("q")
    code, out, err = msnet("live", *words, sequence / "left", sequence / "right", *QUICK)
    assert (code, err) == (0, "")
    assert out.startswith("2 frames, ")
    assert len(shown) == 3 and shown[-1] == "closed"
    blue_first = cv2.imread(str(sequence / "left/view_0.png")).astype(float)
    assert np.abs(shown[0][24:, :160] - blue_first).max() == 0


def test_a_closed_window_ends_it(window, monkeypatch):
    stop = Event()
    with Window(stop) as opened:
        opened.show(np.zeros((4, 4, 3), np.uint8))
        assert not stop.is_set()
        monkeypatch.setattr(cv2, "getWindowProperty", lambda *_: -1.0)
        opened.show(np.zeros((4, 4, 3), np.uint8))
    assert stop.is_set()


def test_without_windows_the_page_is_the_way_out(monkeypatch):
    def refuse(*_):
        raise cv2.error("The function is not implemented")

    monkeypatch.setattr(cv2, "namedWindow", refuse)
    monkeypatch.setenv("DISPLAY", ":0")
    with pytest.raises(InputError, match=r"opencv-python-headless\); --show browser shows a page"):
        Window(Event())
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(InputError, match="no screen here; --show browser"):
        Window(Event())


def test_bad_calls_end_with_one_line(msnet, sequence):
    page = "--show", "browser"
    for words, message in (
        ((), "nothing to show: give --show, --show browser, --rerun spawn or --bag FILE"),
        (("--confidence", "--bag", "a.mcap"), "--confidence needs --show"),
        (("--show", "windows"), "--show windows: did you mean window"),
        (("--show", "firefox"), "--show firefox: there are window, browser"),
        ((*page, "--max-depth", 4), "--max-depth needs --rig FILE, or --focal"),
        ((*page, "--hz", 5), "--hz 5 chooses the network"),
        ((*page, "--known", "1,1=2"), "--known is for `msnet predict`"),
    ):
        code, _, err = msnet("live", sequence / "left", sequence / "right", *words, *QUICK)
        assert code == 2
        assert re.fullmatch(rf"msnet: {re.escape(message)}.*\n", err)


def test_without_a_source_it_says_so(msnet):
    code, _, err = msnet("live")
    assert code == 2 and "Missing argument" in err


def test_live_writes_what_video_writes(msnet, sequence):
    need_extra("rosbags")
    bag = sequence / "out.mcap"
    depth = "--focal", 100, "--baseline", 0.2
    code, out, _ = msnet(
        "live", sequence / "left", sequence / "right", "--bag", bag, *depth, *QUICK
    )
    assert code == 0
    assert bag.stat().st_size > 1000
    assert re.match(r"\d+ frames", out)


def result_of(**values):
    left, _ = make_pair(8)
    disparity = np.full((48, 160), 8, np.float32)
    return StereoResult(left, disparity, disparity > 0, **values)


def test_what_the_filter_leaves_out_is_black():
    confidence = np.full((48, 160), 0.9, np.float32)
    confidence[:, :80] = 0.2
    pictures = []
    screen = Screen(pictures.append)
    frame = StereoFrame(0, "0", 0.0, None)
    screen.write(frame, result_of(confidence=confidence), None)
    limited = result_of(confidence=confidence, filter=MetricFilter(min_confidence=0.5))
    screen.write(frame, limited, None)
    screen.write(frame, limited, Calibration(focal=100, baseline=1, doffs=-8))  # at infinity
    colours = [picture[24:, 164:324] for picture in pictures]
    assert colours[0].min(axis=(0, 1)).any()
    assert not colours[1][:, :80].any() and colours[1][:, 80:].any(axis=2).all()
    assert not colours[2].any()
    grey = pictures[0][24:, 328:]
    assert (grey[:, :80] == 51).all() and (grey[:, 80:] == 230).all()


def test_the_rate_is_that_of_the_last_seconds():
    rate = FrameRate()
    assert rate.update(5.0) == 0
    assert rate.update(5.5) == pytest.approx(2)
    for step in range(1, 101):
        last = rate.update(5.5 + step / 10)
    assert last == pytest.approx(10)
    assert rate.update(100.0) < 0.02  # after a pause
