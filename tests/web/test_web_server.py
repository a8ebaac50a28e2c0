"""The page's server: what it gives, and above all what it does not."""

import asyncio
import json
import os
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from socket import gethostname
from threading import Event
from threading import enumerate as enumerate_threads
from types import SimpleNamespace
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import cv2
import numpy as np
import pytest
import torch

from extras import need_extra
from mobilestereonet import Calibration, InputError, StereoMatcher, StereoSample, create_model
from mobilestereonet.data.rig import Rig
from mobilestereonet.inference import Rectifier
from mobilestereonet.web.cameras import FILE, NUMBERS, UNKNOWN
from mobilestereonet.web.uploads import UploadLimits

gr = need_extra("gradio")

from gradio import route_utils  # noqa: E402

from mobilestereonet.web.handlers import (  # noqa: E402
    PARTS,
    FieldError,
    Handlers,
    PageConfig,
    failed,
)
from mobilestereonet.web.page import _values, build_page  # noqa: E402
from mobilestereonet.web.server import Guard, is_own_name, running  # noqa: E402

PICTURE, OTHER = (
    cv2.imencode(".png", view)[1]
    for view in np.random.default_rng(0).integers(0, 255, (2, 32, 48, 3), np.uint8)
)
VISITOR = SimpleNamespace(session_hash="someone")
EXAMPLES = (NUMBERS, 50, 0.2, 1)
"""What the example's choice fills in for the cameras."""
CAMERAS = ("metres", "source", "focal", "baseline", "doffs")
CLICK = [False, "msnet2d", "torch", True, NUMBERS, 50, 0.2, 0, 0, 0.5]


def make_matcher(model, engine):
    if engine == "missing":
        raise InputError("missing is not installed: <b>install it</b>")
    torch.manual_seed(0)
    return StereoMatcher(create_model(model, max_disparity=32), confidence=True)


@pytest.fixture(scope="module")
def config():
    views = torch.rand(2, 3, 32, 48, generator=torch.Generator().manual_seed(0))
    example = StereoSample(*views, calibration=Calibration(50, 0.2, 1), name="Noise")
    return PageConfig(
        ["msnet2d"], ["torch", "missing"], make_matcher, [example], UploadLimits(megabytes=1)
    )


@pytest.fixture(scope="module")
def address(config):
    with running(config) as address:
        yield address.rstrip("/")


def get(url, data=None, headers=None):
    """Status, headers and body, errors included."""
    try:
        with urlopen(Request(url, data, headers or {}), timeout=20) as answer:
            return answer.status, answer.headers, answer.read()
    except HTTPError as error:
        return error.code, error.headers, error.read()


def upload(address, content, name="picture.png"):
    body = (
        f'--X\r\nContent-Disposition: form-data; name="files"; filename="{name}"\r\n'
        "Content-Type: image/png\r\n\r\n"
    ).encode()
    headers = {"Content-Type": "multipart/form-data; boundary=X"}
    return get(f"{address}/gradio_api/upload", body + bytes(content) + b"\r\n--X--\r\n", headers)


def join(address, event, data):
    """Ask for the first event of that kind, as the browser does."""
    config = json.loads(get(f"{address}/config")[2])
    index = next(
        item["id"]
        for item in config["dependencies"]
        if item["targets"][0][1] == event and len(item["inputs"]) == len(data)
    )
    body = {"data": data, "fn_index": index, "session_hash": "intruder"}
    headers = {"Content-Type": "application/json"}
    assert get(f"{address}/gradio_api/queue/join", json.dumps(body).encode(), headers)[0] == 200


def events(address):
    """Wait for the end of what was asked for; gives the last message."""
    url = f"{address}/gradio_api/queue/data?session_hash=intruder"
    with urlopen(url, timeout=20) as stream:
        line = next(line for line in stream if b"process_completed" in line)
    return json.loads(line.removeprefix(b"data: "))


def files_below(folder):
    return [path for path in Path(folder).rglob("*") if path.is_file()]


def test_the_page_is_on_loopback_and_asks_nobody_else(address):
    assert address.startswith("http://127.0.0.1:")
    status, headers, page = get(address)
    assert status == 200
    assert b"Depth from two pictures" in page
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    config = json.loads(get(f"{address}/config")[2])
    assert config["analytics_enabled"] is False
    assert b"fonts.googleapis" not in get(f"{address}/theme.css")[2]


def test_no_file_of_the_server_can_be_read(address):
    here = Path(__file__).resolve()
    root = Path(os.environ["GRADIO_TEMP_DIR"])
    # The same request for a file that may be read: a thumbnail of the examples.
    assert get(f"{address}/gradio_api/file={files_below(root)[0]}")[0] == 200
    for path in (
        "/etc/passwd",
        here,
        here.parents[2] / "pyproject.toml",
        f"{root}/../../etc/passwd",
        f"{root}/%2e%2e/%2e%2e/etc/passwd",
        "../../../../etc/passwd",
        "file:///etc/passwd",
        Path.cwd() / "README.md",
        root,
    ):
        for route in ("gradio_api/file=", "file=", "gradio_api/file/", "static/", "assets/"):
            status, _, body = get(f"{address}/{route}{path}")
            assert status in (403, 404), (route, path)
            assert b"root:" not in body


@pytest.mark.parametrize(
    "path",
    [
        "file=http://127.0.0.1:1/x.png",
        "file=https://example.org/x.png",
        "file=HTTPS://example.org/x.png",
        "file%3Dhttp://127.0.0.1:1/x.png",
        "file=%68ttp://127.0.0.1:1/x.png",
        "file/http://127.0.0.1:1/x.png",
        "file/https://example.org/x.png",
        "file/https%3A%2F%2Fexample.org/x.png",
        "file%2Fhttps://example.org/x.png",
        "proxy=https://example.org/x.png",
        "deep_link?session_hash=x",
        "process_recording",
    ],
)
def test_unused_doors_are_shut(address, path):
    status, _, body = get(f"{address}/gradio_api/{path}")
    assert (status, body) == (404, b"not here")


def test_uploads_have_a_limit_and_a_place(address):
    root = Path(os.environ["GRADIO_TEMP_DIR"])
    before = set(files_below(root))
    assert upload(address, bytes(2**20 + 1000))[0] == 413
    assert set(files_below(root)) == before
    for name in ("../../evil.png", "/etc/evil.png", "..\\evil.png"):
        status, _, body = upload(address, PICTURE, name)
        assert status == 200
        assert Path(json.loads(body)[0]).resolve().parent.parent == root.resolve()
    assert not list(root.parent.glob("evil*"))


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/etc/passwd", None),
        (str(Path(__file__)), None),
        ("https://example.org/x.png", "upload the picture itself"),
    ],
)
def test_an_upload_event_takes_no_other_path(address, path, words):
    join(address, "upload", [[{"path": path, "meta": {"_type": "gradio.FileData"}}]])
    message = events(address)
    assert message["success"] is False
    assert message["output"]["error"] == words  # None: gradio's own refusal, not told


@pytest.mark.parametrize("place", range(10))
def test_no_component_fetches_an_address(address, place):
    file = {"path": "http://127.0.0.1:1/x.png", "meta": {"_type": "gradio.FileData"}}
    values = list(CLICK)
    values[place] = file if place % 2 else {"deep": [file]}
    join(address, "click", values)
    message = events(address)
    assert message["success"] is False
    assert message["output"]["error"] == "upload the picture itself"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example"}, 421),
        ({"Host": "evil.example:7860"}, 421),
        ({"Host": "127.0.0.1.evil.example"}, 421),
        ({"Host": "192.168.0.1"}, 421),
        ({"Host": ""}, 421),
        ({"Host": "["}, 421),
        ({"Host": "[evil]:7860"}, 421),
        ({"Host": "localhost:7860"}, 200),
        ({"Host": "[::1]:7860"}, 200),
        ({"Host": "localhost:7860", "Origin": "http://localhost:7860"}, 200),
        ({"Origin": "https://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "localhost:7860", "Origin": "http://localhost:80"}, 403),
    ],
)
def test_other_names_and_other_sites_are_refused(address, headers, status):
    for path in ("", "/config", "/gradio_api/info"):
        assert get(f"{address}{path}", headers=headers)[0] == status


def test_names_of_a_server_for_the_network():
    for name in ("localhost", "127.0.0.1", "192.168.0.7", "fe80::1", gethostname().lower()):
        assert is_own_name(name, "0.0.0.0")
    assert is_own_name("stereo.lan", "stereo.lan")
    for name in ("evil.example", "", "1.2.3.4.evil.example"):
        assert not is_own_name(name, "0.0.0.0")


@pytest.mark.parametrize(
    "forged",
    [
        {"X-Forwarded-Host": "evil.example", "X-Forwarded-Proto": "https"},
        {"Forwarded": "host=evil.example", "X-Forwarded-For": "evil.example"},
        {"X-Gradio-Server": "http://evil.example", "X-Forwarded-Prefix": "/evil.example"},
    ],
)
def test_headers_of_proxies_are_not_reflected(address, forged):
    for path in ("", "/config"):
        _, headers, body = get(f"{address}{path}", headers=forged)
        assert b"evil.example" not in body
        assert "evil.example" not in str(headers)


def test_web_sockets_are_closed():
    sent = []

    async def app(scope, receive, send):
        pytest.fail("it was passed on")

    async def send(message):
        sent.append(message["type"])

    asyncio.run(Guard(app)({"type": "websocket", "path": "/", "headers": []}, None, send))
    assert sent == ["websocket.close"]


def test_two_uploads_of_one_file_are_two_files(address):
    first, second = (json.loads(upload(address, PICTURE)[2])[0] for _ in range(2))
    assert first != second
    Path(first).unlink()
    assert Path(second).read_bytes() == PICTURE.tobytes()


@pytest.mark.parametrize("name", ["", ".", "..", "/", "a/..", "x" * 300 + ".png"])
def test_names_of_uploads_that_are_none(address, name):
    status, _, body = upload(address, PICTURE, name)
    assert status == 200
    assert Path(json.loads(body)[0]).read_bytes() == PICTURE.tobytes()


def test_the_folder_goes_with_the_server(config, monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setenv("GRADIO_TEMP_DIR", "before")
    with running(config) as address:
        assert upload(address.rstrip("/"), PICTURE)[0] == 200
        assert files_below(tmp_path)
        assert all(folder.stat().st_mode & 0o077 == 0 for folder in tmp_path.glob("msnet-web-*"))
    assert files_below(tmp_path) == []
    assert os.environ["GRADIO_TEMP_DIR"] == "before"


def test_a_match_that_still_writes_at_the_end_leaves_nothing(config, monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    writing, written = Event(), Event()

    def slow(session, *_):
        try:
            with session.replace("answer") as folder:
                writing.set()
                ended = time.monotonic() + 2
                while folder.exists() and time.monotonic() < ended:
                    time.sleep(0.02)
                folder.mkdir(parents=True, exist_ok=True)  # as an atomic write does
                (folder / "late.png").write_bytes(b"late")
                raise InputError("late")
        finally:
            written.set()

    with running(config) as address:
        monkeypatch.setattr("mobilestereonet.web.handlers.answer", slow)
        join(address.rstrip("/"), "click", CLICK)
        assert writing.wait(20)
    assert written.wait(20)
    assert list(tmp_path.iterdir()) == []


def test_all_ways_to_a_match_share_one_queue(act):
    found = [event for event in build_page(act).fns.values() if event.concurrency_id == "match"]
    assert len(found) == 4  # the button, and after a drop, a swap and an example
    assert {event.concurrency_limit for event in found} == {1}


@pytest.fixture
def act(config, tmp_path):
    return Handlers(replace(config, examples=[*config.examples]), tmp_path)


def put(folder, content, name="picture.png"):
    path = folder / Path(name).stem / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return {"path": str(path)}


@contextmanager
def refused(field, words):
    with pytest.raises(FieldError, match=words) as error:
        yield error
    assert error.value.field == field


def last(steps):
    """The parts that an event changes, in the end."""
    found = {}
    for updates in steps:
        found |= updates
    return found


def match(act, runtime="torch", metres=True, source=NUMBERS, focal=50.0, baseline=0.2, **options):
    chosen = options.get("chosen", False)
    numbers = (focal, baseline, 0, 0, 0.0)
    return last(act.match(VISITOR, chosen, "msnet2d", runtime, metres, source, *numbers))


def test_the_page_opens_with_a_result(act, monkeypatch):
    monkeypatch.setattr("mobilestereonet.web.handlers.MIN_CONFIDENCE", 0.0)
    opened = act.open()
    assert "msnet2d on torch fp32, 48x32" in opened["facts"]
    assert opened["view"]["geometry"]["depth"] == pytest.approx(10)
    assert Path(opened["everything"]["value"]).is_file()
    shown = act.shape(VISITOR, False, "Surface", opened["distance"])
    assert Path(shown["value"]).suffix == ".glb"
    assert shown["camera_position"] == (90, 90, opened["distance"])
    assert "matched in" in match(act)["facts"]


def test_handlers_from_the_upload_to_the_shape(act, tmp_path):
    files = [put(tmp_path, PICTURE, "a.png"), put(tmp_path, OTHER, "b.png")]
    taken = last(act.take_pair(VISITOR, files, *EXAMPLES))
    assert Path(taken["left"]).read_bytes() == PICTURE.tobytes()
    assert taken["view"].keys() == {"left"}  # at once
    found = match(act)
    assert "msnet2d on torch fp32, 48x32" in found["facts"]
    assert found["view"]["geometry"]["depth"] == pytest.approx(10)
    assert found["progress"] is None
    shown = (act.shape(VISITOR, True, kind, None)["value"] for kind in ("Surface", "Points"))
    assert {Path(path).name for path in shown} == {
        "stereo_mesh.glb",
        "stereo_points.glb",
    }
    swapped = last(act.swap(VISITOR, True))
    assert Path(swapped["left"]).read_bytes() == OTHER.tobytes()
    act.leave(VISITOR)
    assert files_below(act.sessions.root) == []


def shape(act, chosen=True):
    return act.shape(VISITOR, chosen, "Points", None)["value"]


def test_3d_is_of_the_pair_that_is_chosen(act, tmp_path, monkeypatch):
    pair = [put(tmp_path, PICTURE, "a.png"), put(tmp_path, OTHER, "b.png")]

    def matched():
        monkeypatch.undo()
        last(act.take_pair(VISITOR, pair, *EXAMPLES))
        match(act, chosen=True)
        assert shape(act)

    monkeypatch.setattr("mobilestereonet.web.handlers.MIN_CONFIDENCE", 0.0)
    act.open()
    assert shape(act, chosen=False)
    assert shape(act) is None  # as after an hour: his own pair is gone
    matched()
    taken = last(act.take_pair(VISITOR, pair, *EXAMPLES))
    assert shape(act, chosen=False) is None
    assert taken["everything"]["interactive"] is False  # nor are there files of the former one
    matched()
    last(act.swap(VISITOR, True))
    assert shape(act) is None
    matched()
    last(act.take_example(SimpleNamespace(index=0), VISITOR))
    assert shape(act) is None
    matched()
    with refused("match_error", "missing is not installed"):
        match(act, runtime="missing", chosen=True)
    assert shape(act) is None
    matched()
    with refused("pair_error", "no PNG"):  # which changes nothing
        last(act.take_pair(VISITOR, [put(tmp_path, b"text")], *EXAMPLES))
    assert shape(act)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (RuntimeError("CUDA out of memory in /srv"), "the server could not do this"),
        (InputError("this page was closed: <load it again>"), "closed: &lt;load it again"),
    ],
)
def test_after_any_failure_the_page_is_at_rest(error, words, caplog):
    def steps():
        yield {"progress": {"label": "Matching", "expected": None}}
        raise error

    shown = []
    with pytest.raises(gr.Error):
        for values in _values(steps()):
            shown.append(values)
    seen = dict(zip(PARTS, shown[-1], strict=True))
    assert seen["progress"] is None
    assert seen["cancel"]["visible"] is False
    assert words in seen["match_error"]
    assert "/srv" not in seen["match_error"]
    assert ("out of memory in /srv" in caplog.text) is isinstance(error, RuntimeError)


@pytest.mark.parametrize("error", [InputError("junk.onnx: no network"), KeyboardInterrupt()])
def test_an_error_at_the_start_is_told_and_leaves_nothing(config, monkeypatch, tmp_path, error):
    def no_matcher(model, engine):
        raise error

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delenv("GRADIO_TEMP_DIR", raising=False)
    upload, threads = route_utils.GradioUploadFile, set(enumerate_threads())
    with (
        pytest.raises(type(error)) as told,
        running(replace(config, matcher=no_matcher)),
    ):
        pass
    assert str(told.value) == str(error)
    assert list(tmp_path.iterdir()) == []
    assert "GRADIO_TEMP_DIR" not in os.environ
    assert route_utils.GradioUploadFile is upload
    assert set(enumerate_threads()) <= threads


def test_without_metres_nothing_is_asked(act):
    found = match(act, metres=False, focal=None, baseline=None)
    assert found["view"]["geometry"] is None
    assert found["depth"]["interactive"] is False
    assert found["blender"]["interactive"] is True


def test_progress_tells_seconds_that_were_measured(act):

    def told():
        steps = act.match(VISITOR, False, "msnet2d", "torch", True, NUMBERS, 50, 0.2, 0, 0, 0.0)
        return [step["progress"] for step in steps if step.get("progress")]

    first, second = told(), told()
    assert [step["label"] for step in first] == ["Loading msnet2d", "Matching", "Writing the files"]
    assert first[1]["expected"] is None
    assert 0 < second[1]["expected"] < 60


def test_a_cancelled_match_changes_nothing(act, monkeypatch):
    go = Event()
    matcher = act._matcher("msnet2d", "torch")
    whole = matcher.match
    monkeypatch.setattr(matcher, "match", lambda pair: go.wait(20) and whole(pair))
    steps = act.match(VISITOR, False, "msnet2d", "torch", True, NUMBERS, 50, 0.2, 0, 0, 0.0)
    assert "Matching" in str([next(steps), next(steps)])
    steps.close()  # as gradio does
    go.set()
    act._worker.submit(int).result(20)
    assert not act.sessions["someone"].holds("answer")
    assert last(act.cancel(VISITOR))["facts"] == "Cancelled."


def test_an_example_fills_everything_in(act):
    found = last(act.take_example(SimpleNamespace(index=0), VISITOR))
    assert Path(found["left"]).is_file()
    assert Path(found["right"]).is_file()
    assert [found[name] for name in CAMERAS] == [True, *EXAMPLES]
    assert found["view"].keys() == {"left"}


def test_an_example_of_unknown_cameras_leaves_no_numbers(act):
    act.config.examples.append(replace(act.config.examples[0], calibration=None))
    found = last(act.take_example(SimpleNamespace(index=1), VISITOR))
    assert [found[name] for name in CAMERAS] == [False, UNKNOWN, None, None, None]


def test_the_cameras_of_the_page_are_not_those_of_its_examples(act, tmp_path):
    rig = Rig((Calibration(50, 0.2, size=(64, 40)),), "the cameras of this page")
    act.config = replace(act.config, rectifier=Rectifier(rig))
    last(act.take_example(SimpleNamespace(index=0), VISITOR))
    assert match(act, metres=False)["view"]["geometry"] is None
    last(act.take_pair(VISITOR, [put(tmp_path, PICTURE), put(tmp_path, OTHER, "b.png")], *EXAMPLES))
    with refused("pair_error", r"the cameras of this page.*64x40"):
        match(act, metres=False, chosen=True)


@pytest.mark.parametrize(
    ("said", "stays"),
    [
        (EXAMPLES, False),
        ((NUMBERS, 50, 0.2, 0), True),
        ((FILE, *EXAMPLES[1:]), True),
        ((UNKNOWN, None, None, None), True),
    ],
)
def test_numbers_of_an_example_are_not_those_of_the_next_pair(act, tmp_path, said, stays):
    act.config.examples.append(replace(act.config.examples[0], calibration=None))
    found = last(
        act.take_pair(VISITOR, [put(tmp_path, PICTURE), put(tmp_path, OTHER, "b.png")], *said)
    )
    assert found.get("metres") is (None if stays else False)
    assert ("focal" in found) is not stays


@pytest.mark.parametrize(
    "payload", [None, [], [None], [{}], [{"path": None}], [{"path": "/etc/passwd"}]]
)
def test_bad_payloads_are_one_line_on_the_page(act, payload, tmp_path):
    with refused("pair_error", r"(upload is not there|no picture)"):
        last(act.take_pair(VISITOR, payload, *EXAMPLES))
    file = payload and payload[0]
    with refused("cameras_error", r"the upload is not there"):
        last(act.take_calibration(VISITOR, file))
    assert files_below(tmp_path) == []


def test_errors_are_one_line_at_their_field(act, tmp_path):
    with refused("pair_error", r"no PNG, JPEG"):
        last(act.take_pair(VISITOR, [put(tmp_path, b"text")], *EXAMPLES))
    with refused("pair_error", r"there is no left picture"):
        match(act, chosen=True)  # as after an hour
    with refused("cameras_error", r"the baseline is 0 or missing"):
        match(act, baseline=0.0)
    with refused("cameras_error", r"no calibration file"):
        match(act, source=FILE)
    with refused("cameras_error", r"calibration file"):
        last(act.take_calibration(VISITOR, put(tmp_path, b"no calibration", "calib.txt")))
    with refused("match_error", r"<b>install it") as error:
        match(act, runtime="missing")
    assert "&lt;b&gt;install it" in failed(error.value)["match_error"]
