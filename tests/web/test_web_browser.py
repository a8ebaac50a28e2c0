"""The page end to end: `msnet web` in a process of its own, and Chromium with software WebGL.

Skipped where gradio, playwright or Chromium is missing; MSNET_REQUIRE_EXTRAS=1 forbids that. Every
step waits for what it needs: on a busy machine the software WebGL takes seconds for one frame.
"""

import base64
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from zipfile import ZipFile

import cv2
import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from extras import REQUIRED, need_extra
from mobilestereonet import Calibration, StereoMatcher
from mobilestereonet.plots import colour_disparity
from mobilestereonet.web.cameras import NUMBERS

need_extra("gradio")
playwright = need_extra("playwright.sync_api")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None and not REQUIRED:
    pytest.skip("Chromium is not installed", allow_module_level=True)

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PATIENCE = 180_000
"""Milliseconds that the slowest step may take on a busy machine."""

KNOWN = {"focal": 994.978 * 0.4, "baseline": 0.193001, "doffs": 31.086 * 0.4}
CALIBRATION = Calibration(**KNOWN)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Motorcycle at two fifths of scikit-image's size, as files, and the server's folder."""
    folder = tmp_path_factory.mktemp("browser")
    for name, view in zip(("left", "right"), stereo_motorcycle()[:2], strict=True):
        small = cv2.resize(view[..., ::-1], (296, 200), interpolation=cv2.INTER_AREA)
        assert cv2.imwrite(str(folder / f"{name}.png"), small)
    (folder / "right_broken.png").write_bytes((folder / "left.png").read_bytes()[:5000])
    (folder / "text.png").write_text("no picture")
    (folder / "server").mkdir()
    return folder


@pytest.fixture(scope="module")
def expected(folder):
    matcher = StereoMatcher.from_pretrained(quality="fast", threads=1, confidence=True)
    return matcher(folder / "left.png", folder / "right.png")


@pytest.fixture(scope="module")
def address(folder):
    command = [sys.executable, "-m", "mobilestereonet", "web"]
    options = ["--quality", "fast", "--precision", "fp32", "--threads", "1"]
    server = subprocess.Popen(
        [*command, *options],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(folder / "server")},
    )
    try:
        said = (re.match(r"http://127\.0\.0\.1:\d+/", line) for line in server.stdout)
        found = next(filter(None, said), None)
        assert found, "the server ended without an address"
        yield found[0]
        server.send_signal(signal.SIGTERM)
        assert server.wait(PATIENCE / 1000) == 0
        assert list((folder / "server").glob("msnet-web-*")) == []
    finally:
        server.kill()
        server.wait()


@pytest.fixture(scope="module")
def chromium():
    assert CHROMIUM, "Chromium is not installed"
    options = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    # The software GPU is for WebGL alone: with the whole page on it, a frame takes 20 times longer.
    options.append("--disable-gpu-compositing")
    with playwright.sync_playwright() as driver:  # which leaves out the sandbox and /dev/shm
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=options, timeout=PATIENCE)
        yield browser
        browser.close()


@pytest.fixture
def visit(chromium, address):
    """Opens the page; at the end, says whom the browser asked and what it complained of."""
    pages = []

    def open_page(width, height, **options):
        page = chromium.new_page(viewport={"width": width, "height": height}, **options)
        page.set_default_timeout(PATIENCE)
        page.asked, page.refused, page.errors = set(), set(), []
        page.on("request", lambda request: page.asked.add(request.url))
        page.on("response", lambda answer: answer.status < 400 or page.refused.add(answer.url))
        page.on("pageerror", lambda error: page.errors.append(error))
        page.goto(address)
        page.locator("#match").wait_for()
        pages.append(page)
        return page

    yield open_page
    for page in pages:
        page.close()
    for page in pages:
        assert not page.refused
        assert not page.errors


def until(condition, what):
    """Look again and again; gives what is true at last."""
    ended = time.monotonic() + PATIENCE / 1000
    while not (found := condition()):
        assert time.monotonic() < ended, what
        time.sleep(0.1)
    return found


def choose(page, *paths):
    page.locator("#drop input[type=file]").set_input_files(paths)


def choose_pair(page, folder):
    choose(page, folder / "left.png", folder / "right.png")
    matched(page, 296)


def matched(page, width):
    page.locator("#facts", has_text=re.compile(rf"{width}x\d+: matched in")).wait_for()


def fill_in(page, numbers):
    page.locator("#metres input").check()
    page.locator("#source input").click()
    page.get_by_role("option", name=NUMBERS).click()
    for name, number in numbers.items():
        page.locator(f"#{name} input").fill(str(number))


def match(page):
    page.locator("#match").click()
    page.locator("#cancel").wait_for()
    matched(page, 296)


def picture(content):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


def read(page, point, words):
    """Point at a place until the readout has the words: the layout may still move."""

    def told():
        point()
        return re.search(words, page.locator("#readout").inner_text())

    return until(told, f"the readout never tells {words}").string


def sessions(folder):
    return list((folder / "server").glob("msnet-web-*/sessions/*"))


def pixels(page, name):
    """RGBA of a canvas."""
    url = page.locator(name).evaluate("canvas => canvas.toDataURL()")
    image = picture(base64.b64decode(url.partition(",")[2]))
    return cv2.cvtColor(image, cv2.COLOR_BGRA2RGBA).astype(float)


def test_from_the_upload_to_the_download(visit, folder, expected, tmp_path):
    page = visit(1280, 900)
    # It opens with a result.
    assert "741x500: matched in" in page.locator("#facts").inner_text()
    page.locator("#ticks", has_text=" m").wait_for()
    choose_pair(page, folder)
    page.locator("#ticks", has_text=" px").wait_for()  # an example's metres are not this pair's
    fill_in(page, KNOWN)
    match(page)
    assert "fast (" in page.locator("#facts").inner_text()

    # What lies under the slider: the left view, and the disparity that `predict` gives.
    shown = pixels(page, "#disparity")
    assert (shown[..., 3] == 255).mean() > 0.99
    colours = colour_disparity(expected.disparity)
    assert np.quantile(np.abs(shown[..., :3] - colours).max(axis=2), 0.95) <= 12
    left = pixels(page, "#picture")[..., :3]
    assert np.abs(left - expected.left).mean() < 6  # a JPEG

    # Downloads, as a click saves them.
    saved = {}
    for kind in ("picture", "depth", "blender", "everything"):
        with page.expect_download() as waiting:
            page.locator(f"#download-{kind}").click()
        saved[kind] = tmp_path / waiting.value.suggested_filename
        waiting.value.save_as(saved[kind])
    depth = expected.depth(CALIBRATION)
    metres = cv2.imread(str(saved["depth"]), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(metres, depth, rtol=1e-4)
    assert saved["blender"].read_bytes().startswith(b"glTF")
    with ZipFile(saved["everything"]) as archive, archive.open("stereo_disparity.npy") as file:
        np.testing.assert_allclose(np.load(file), expected.disparity, atol=1e-3)

    # The depth under the mouse, and the distance between two places.
    box = page.locator("#picture").bounding_box()

    def move(column, row):
        page.mouse.move(box["x"], box["y"])  # to where it is already would be no movement
        x, y = (column + 0.5) / 296, (row + 0.5) / 200
        page.mouse.move(box["x"] + x * box["width"], box["y"] + y * box["height"])

    places = (40, 150), (250, 60)
    for column, row in places:
        text = read(page, lambda at=(column, row): move(*at), f"column {column}, row {row} ")
        assert float(re.search(r"disparity ([\d.]+) px", text)[1]) == pytest.approx(
            expected.disparity[row, column], abs=0.01
        )
        assert float(re.search(r"depth ([\d.]+) m", text)[1]) == pytest.approx(
            depth[row, column], rel=2e-3
        )
        page.mouse.down()
        page.mouse.up()
    points = [
        np.array([x - 147.5, y - 99.5, CALIBRATION.focal]) * depth[y, x] / CALIBRATION.focal
        for x, y in places
    ]
    told = re.search(r"between the marks ([\d.]+) m", page.locator("#readout").inner_text())
    assert float(told[1]) == pytest.approx(np.linalg.norm(points[0] - points[1]), rel=5e-3)

    # The sliders leave pixels out, without the server.
    asked = set(page.asked)
    page.locator("#sure input").fill("90")
    kept = pixels(page, "#disparity")[..., 3] == 255
    assert (kept == (np.rint(255 * expected.confidence) / 255 >= 0.9)).mean() > 0.99
    page.locator("#sure input").fill("0")
    page.locator("#far").fill("128")
    kept = pixels(page, "#disparity")[..., 3] == 255
    assert 0.05 < kept.mean() < 0.95
    assert expected.disparity[kept].min() > expected.disparity[~kept].max() - 0.1
    assert page.asked == asked

    turn_the_shape(page)
    hosts = {url.split("/")[2] for url in page.asked if url.startswith(("http", "ws"))}
    assert hosts == {page.url.split("/")[2]}


def turn_the_shape(page):
    page.set_viewport_size({"width": 390, "height": 844})  # few pixels for the software's WebGL
    canvas = page.locator("#shape canvas")

    def opened():
        page.get_by_role("tab", name="3D").click()  # once in many runs one click opens nothing
        return canvas.is_visible()

    until(opened, "the 3D tab shows no canvas")
    seen = []

    def at_rest():
        seen.append(picture(canvas.screenshot())[..., :3].astype(float))
        del seen[:-3]
        changes = [np.abs(seen[-1] - former).mean() for former in seen[-3:-1]]
        return len(changes) == 2 and max(changes) < 0.1 and seen[-1].std() > 5

    until(at_rest, "the cloud stays empty, or the camera never comes to its place")
    before = seen[-1]
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 120, y + 30, steps=4)
    page.mouse.up()
    until(lambda: at_rest() and np.abs(seen[-1] - before).mean() > 1, "it does not turn")


def test_bad_input_is_one_line_at_its_field(visit, folder):
    page = visit(1280, 900)
    choose(page, folder / "text.png")
    page.locator("#pair_error", has_text="this is no PNG, JPEG, WebP or BMP picture").wait_for()
    choose(page, folder / "left.png", folder / "right_broken.png")
    page.locator("#pair_error", has_text="right picture: not an image").wait_for()
    choose_pair(page, folder)
    assert not page.locator("#pair_error p").count()
    fill_in(page, {**KNOWN, "baseline": 0})
    page.locator("#match").click()
    page.locator("#cameras_error", has_text="the baseline is 0 or missing").wait_for()
    page.locator("#metres input").uncheck()
    match(page)
    assert not page.locator("#cameras_error p").count()
    page.locator("#ticks", has_text="px").wait_for()

    def cancelled():
        page.locator("#match").click()
        with suppress(playwright.TimeoutError):  # a quick match was done before
            page.locator("#cancel").click(timeout=3000)
        return page.locator("#facts", has_text="Cancelled").count()

    until(cancelled, "a match cannot be cancelled")
    assert not page.locator(".toast-body").count()


def test_a_phone_and_an_example(visit, folder):
    page = visit(390, 844, has_touch=True, is_mobile=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.locator("#examples img").last.tap()
    page.wait_for_function(
        "Math.abs(document.querySelector('#results').getBoundingClientRect().top) < innerHeight / 2"
    )
    matched(page, 512)
    shown = page.locator("#picture")
    read(page, lambda: shown.tap(position={"x": 30, "y": 60}, force=True), r"depth [\d.]+ m")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_files_go_when_the_visitor_does(visit, folder):
    page = visit(1280, 900)
    before = set(sessions(folder))
    choose_pair(page, folder)
    mine = set(sessions(folder)) - before
    assert len(mine) == 1
    page.close()
    until(lambda: not any(path.exists() for path in mine), "the session's folder stays")
