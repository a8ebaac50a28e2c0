"""The page end to end: `msnet web` in a process of its own, and Chromium with software WebGL.

Skipped where gradio, playwright or Chromium is missing; MSNET_REQUIRE_EXTRAS=1 forbids that. Every
step waits for what it needs: on a busy machine the software WebGL takes seconds for one frame.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from extras import REQUIRED, need_extra
from mobilestereonet import Calibration, StereoMatcher
from mobilestereonet.data.disparity_files import read_disparity_png
from mobilestereonet.plots import colour_disparity

need_extra("gradio")
sync_playwright = need_extra("playwright.sync_api").sync_playwright

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None and not REQUIRED:
    pytest.skip("Chromium is not installed", allow_module_level=True)

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PATIENCE = 180_000
"""Milliseconds that the slowest step may take on a busy machine."""

CALIBRATION = Calibration(focal=994.978 * 0.4, baseline=0.193001, doffs=31.086 * 0.4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Motorcycle at two fifths of scikit-image's size, as files, and the server's folder."""
    folder = tmp_path_factory.mktemp("browser")
    for name, view in zip(("left", "right"), stereo_motorcycle()[:2], strict=True):
        small = cv2.resize(view[..., ::-1], (296, 200), interpolation=cv2.INTER_AREA)
        assert cv2.imwrite(str(folder / f"{name}.png"), small)
    (folder / "broken.png").write_bytes((folder / "left.png").read_bytes()[:5000])
    (folder / "text.png").write_text("no picture")
    (folder / "server").mkdir()
    return folder


@pytest.fixture(scope="module")
def expected(folder):
    matcher = StereoMatcher.from_pretrained(threads=1, confidence=True)
    return matcher(folder / "left.png", folder / "right.png")


@pytest.fixture(scope="module")
def address(folder):
    command = [sys.executable, "-m", "mobilestereonet", "web"]
    options = ["--precision", "fp32", "--threads", "1"]
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
    with sync_playwright() as playwright:  # which leaves out the sandbox and /dev/shm
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=options, timeout=PATIENCE
        )
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


def choose(page, side, path):
    page.locator(f"#{side} input[type=file]").set_input_files(path)
    # The upload is shown at once; what can be matched is the session's copy.
    page.locator(f"#{side} img[src*='/sessions/']").wait_for()


def choose_pair(page, folder):
    for side in ("left", "right"):
        choose(page, side, folder / f"{side}.png")


def fill_in(page, calibration):
    for name in ("focal", "baseline", "doffs"):
        page.locator(f"#{name} input").fill(str(getattr(calibration, name)))


def match(page):
    page.locator("#match").click()
    page.locator("#facts", has_text="matched in").wait_for()


def fetch(page, locator, attribute):
    """The file that an element shows or links to, as the browser gets it."""
    url = locator.evaluate(f"element => element.{attribute}")
    answer = page.request.get(url, timeout=PATIENCE)
    assert answer.ok
    return answer.body()


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


def test_from_the_upload_to_the_download(visit, folder, expected, tmp_path):
    page = visit(1280, 900)
    choose_pair(page, folder)
    fill_in(page, CALIBRATION)
    match(page)
    assert "balanced (msnet3d) on torch fp32, 296x200" in page.locator("#facts").inner_text()

    # The pictures under the slider: the left view, and the disparity that `predict` gives.
    shown = page.locator("#disparity img")
    views = [picture(fetch(page, shown.nth(i), "src"))[..., ::-1] for i in range(2)]
    colours = colour_disparity(expected.disparity)
    by_match = sorted(views, key=lambda view: np.abs(view - colours.astype(float)).mean())
    np.testing.assert_allclose(by_match[0].astype(float), colours, atol=2)
    np.testing.assert_array_equal(by_match[1], expected.left)

    # Downloads, as a click on the link saves them.
    saved = {}
    for kind in ("disparity.png", "disparity.pfm", "disparity.npy", "depth.npy", "points.ply"):
        with page.expect_download() as waiting:
            page.locator(f"#downloads a[download='stereo_{kind}']").click()
        saved[kind] = tmp_path / kind
        waiting.value.save_as(saved[kind])
    np.testing.assert_allclose(np.load(saved["disparity.npy"]), expected.disparity, atol=1e-3)
    levels, _ = read_disparity_png(saved["disparity.png"])
    np.testing.assert_allclose(levels, expected.disparity, atol=1 / 512 + 1e-3)
    depth = expected.depth(CALIBRATION)
    np.testing.assert_allclose(np.load(saved["depth.npy"]), depth, rtol=1e-4)
    assert saved["points.ply"].read_bytes().startswith(b"ply")

    # The depth under the mouse.
    for column, row in ((40, 150), (250, 60)):

        def point(x=(column + 0.5) / 296, y=(row + 0.5) / 200):
            box = shown.first.bounding_box()
            page.mouse.move(box["x"], box["y"])  # to where it is already would be no movement
            page.mouse.move(box["x"] + x * box["width"], box["y"] + y * box["height"])

        shown.first.scroll_into_view_if_needed()
        text = read(page, point, f"column {column}, row {row} ")
        assert float(re.search(r"disparity ([\d.]+) px", text)[1]) == pytest.approx(
            expected.disparity[row, column], abs=0.01
        )
        assert float(re.search(r"depth ([\d.]+) m", text)[1]) == pytest.approx(
            depth[row, column], rel=2e-3
        )

    # The confidence.
    page.get_by_role("tab", name="Confidence").click()
    sure = picture(fetch(page, page.locator("#confidence img"), "src"))
    np.testing.assert_allclose(sure / 255, expected.confidence, atol=0.01)

    turn_the_cloud(page)
    hosts = {url.split("/")[2] for url in page.asked if url.startswith(("http", "ws"))}
    assert hosts == {page.url.split("/")[2]}


def turn_the_cloud(page):
    canvas = page.locator("#cloud canvas")

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
    page.mouse.move(x + 120, y + 30, steps=10)
    page.mouse.up()
    until(lambda: at_rest() and np.abs(seen[-1] - before).mean() > 1, "it does not turn")


def test_bad_input_is_one_line_on_the_page(visit, folder):
    page = visit(1280, 900)

    def expect_error(words):
        toast = page.locator(".toast-body", has_text=words)
        toast.wait_for()
        # It may go by itself meanwhile, so that a click could find nothing.
        toast.locator(".toast-close").evaluate_all("all => all.forEach(button => button.click())")
        toast.wait_for(state="detached")

    page.locator("#match").click()
    expect_error("there is no left picture")
    page.locator("#left input[type=file]").set_input_files(folder / "text.png")
    expect_error("this is no PNG, JPEG, WebP or BMP picture")
    page.locator("#left input[type=file]").wait_for(state="attached")  # it is empty again
    choose(page, "left", folder / "left.png")
    choose(page, "right", folder / "broken.png")
    page.locator("#match").click()
    expect_error("right picture: not an image")
    page.locator("#right button[aria-label='Remove Image']").click()
    choose(page, "right", folder / "right.png")
    page.locator("#focal input").fill("400")
    page.locator("#match").click()
    expect_error("the baseline is 0 or missing")
    page.locator("#baseline input").fill("0.2")
    match(page)


def test_a_phone_and_an_example(visit, folder):
    page = visit(390, 844, has_touch=True, is_mobile=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.locator("#examples img").nth(1).tap()
    page.wait_for_function(
        "Math.abs(document.querySelector('#facts').getBoundingClientRect().top) < innerHeight / 2"
    )
    page.locator("#facts", has_text="matched in").wait_for()
    shown = page.locator("#disparity img").first
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
