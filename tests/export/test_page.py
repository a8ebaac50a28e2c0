"""The page of `msnet export web` in Chromium, with ONNX Runtime in WebAssembly."""

import re
import shutil
import time
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import cv2
import numpy as np
import pytest
import torch

from extras import REQUIRED, need_extra
from mobilestereonet.engines.onnx_file import OnnxFileEngine
from mobilestereonet.export.web import export_page
from mobilestereonet.weights import load_model

sync_playwright = need_extra("playwright.sync_api").sync_playwright
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
RUNTIME = Path(__file__).parent / "page" / "node_modules"
if (CHROMIUM is None or not RUNTIME.is_dir()) and not REQUIRED:
    pytest.skip("needs Chromium, and npm ci in tests/export/page", allow_module_level=True)

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PATIENCE = 240_000
"""Milliseconds that the slowest step may take on a busy machine."""

SIZE = (160, 240)


class Handler(SimpleHTTPRequestHandler):
    def log_message(self, *words):
        pass


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site") / "page"
    net = load_model("msnet2d", config={"hourglasses": 1})  # quickly converted
    export_page(net, folder, runtime=RUNTIME, model="msnet2d", embedded=True, size=SIZE)
    return folder


@contextmanager
def served(folder):
    """Serve a folder to this machine; gives the address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=folder))
    Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()


@pytest.fixture(scope="module")
def address(folder):
    with served(folder) as address:
        yield address


@pytest.fixture(scope="module")
def chromium():
    options = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--disable-gpu-compositing", "--use-fake-device-for-media-stream"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=[*options, "--use-fake-ui-for-media-stream"]
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def context(chromium, address):
    """A browser that has been on the page, and what it asked and complained of."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(PATIENCE)
    asked, errors = set(), []
    context.on("request", lambda request: asked.add(request.url))
    context.on("weberror", lambda error: errors.append(error.error))
    yield context
    context.close()
    assert {url.split("/")[2] for url in asked if url.startswith("http")} == {address.split("/")[2]}
    assert not errors


def open_page(context, address):
    page = context.new_page()
    page.goto(address)
    page.locator("#status", has_text="Ready").wait_for()
    return page


def status(page, words):
    page.locator("#status", has_text=words).wait_for()


def test_the_demo_pair(context, address, folder):
    page = open_page(context, address)
    assert page.evaluate("crossOriginIsolated")
    page.evaluate("""addEventListener("matched", ({ detail }) => (globalThis.found = detail))""")
    page.locator("#example").click()
    status(page, re.compile(r"Matched in [\d.]+ s"))
    found = {
        name: np.array(page.evaluate(f"Array.from(found.{name})"), np.float32)
        for name in ("disparity", "confidence")
    }

    engine = OnnxFileEngine(f"onnx:{folder / 'model.onnx'}", threads=1)
    pictures = [cv2.imread(str(folder / f"example-{side}.png")) for side in ("left", "right")]
    views = [
        torch.from_numpy(picture[..., ::-1].transpose(2, 0, 1)[None] / np.float32(255))
        for picture in pictures
    ]
    for name, expected in zip(found, engine(*views, True), strict=True):
        difference = np.abs(found[name].reshape(pictures[0].shape[:2]) - expected[0].numpy())
        # Where two disparities are as likely as one another, rounding chooses.
        assert np.quantile(difference, 0.999) < 0.05
        assert difference.mean() < 0.01

    # Depth under the pointer.
    picture = page.locator("#picture")
    picture.scroll_into_view_if_needed()
    box = picture.bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.3, box["y"] + box["height"] * 0.7)
    told = page.locator("#readout").inner_text()
    numbers = re.fullmatch(
        r"column (\d+), row (\d+) · disparity ([\d.]+) px · depth ([\d.]+) m · \d+ % sure", told
    )
    assert numbers, told
    column, row = int(numbers[1]), int(numbers[2])
    width = pictures[0].shape[1]
    assert float(numbers[3]) == pytest.approx(found["disparity"][row * width + column], abs=0.006)

    # The slider, and the points.
    page.locator("#slider").fill("0")
    assert page.evaluate("getComputedStyle(document.querySelector('#disparity')).clipPath") in (
        "inset(0px 0px 0px 0%)",
        "inset(0px 0px 0px)",
    )
    page.locator("#show-cloud").click()
    canvas = page.locator("#cloud")
    canvas.wait_for()
    before = picture_when(canvas, lambda picture: picture.std() > 10)
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 130, steps=5)
    page.mouse.up()
    picture_when(canvas, lambda picture: np.abs(picture - before).mean() > 1)

    # Without a network.
    context.set_offline(True)
    try:
        page.reload()
        status(page, "Ready")
    finally:
        context.set_offline(False)
    page.close()


def picture_when(locator, condition):
    """What an element looks like as soon as a condition holds."""
    ended = time.monotonic() + PATIENCE / 1000
    while True:
        content = np.frombuffer(locator.screenshot(), np.uint8)
        picture = cv2.imdecode(content, cv2.IMREAD_COLOR).astype(float)
        if condition(picture):
            return picture
        assert time.monotonic() < ended, "it never looks so"
        time.sleep(0.1)


def test_what_a_visitor_may_do_wrong(context, address, folder, tmp_path):
    page = open_page(context, address)
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    (tmp_path / "text.png").write_text("no picture")
    page.locator("#left input").set_input_files(tmp_path / "text.png")
    status(page, "The left file is no picture that this browser reads")
    assert page.locator("#match").is_disabled()
    small = tmp_path / "small.png"
    assert cv2.imwrite(str(small), np.zeros((30, 40, 3), np.uint8))
    page.locator("#left input").set_input_files(folder / "example-left.png")
    page.locator("#right input").set_input_files(small)
    page.locator("#match").click()
    status(page, "The photos must have one size")
    page.close()


GPU = """
const adapter = { requestDevice: async () => REQUESTED };
Object.defineProperty(navigator, "gpu", { value: { requestAdapter: async () => adapter } });
"""
"""A browser's WebGPU, as far as the page looks at it."""

NO_SESSION = """
export const env = { wasm: {} };
export const InferenceSession = { create: async () => { throw new Error("no kernel"); } };
"""
"""A runtime for WebGPU that does not take the network."""


@pytest.mark.parametrize(
    ("device", "tried"), [("null", False), ("({ destroy() {} })", True)], ids=["device", "session"]
)
def test_a_gpu_that_fails_leaves_it_to_webassembly(chromium, folder, tmp_path, device, tried):
    shutil.copytree(folder, tmp_path / "page")
    worker = tmp_path / "page/worker.js"
    worker.write_text(GPU.replace("REQUESTED", device) + worker.read_text())
    (tmp_path / "page/runtime/ort.webgpu.min.mjs").write_text(NO_SESSION)
    context = chromium.new_context()
    context.set_default_timeout(PATIENCE)
    asked = set()
    context.on("request", lambda request: asked.add(request.url.rpartition("/")[2]))
    with served(tmp_path / "page") as address:
        page = open_page(context, address)
        assert "thread" in page.locator("#status").inner_text()  # of WebAssembly
        assert ("ort.webgpu.min.mjs" in asked) == tried
        page.locator("#example").click()
        status(page, re.compile(r"Matched in [\d.]+ s"))
        context.close()


def test_a_side_by_side_webcam(context, address):
    page = open_page(context, address)
    page.locator("#camera").click()
    status(page, "Matched in")
    assert page.locator("#result").is_visible()
    page.locator("#camera", has_text="Stop").click()
    assert page.locator("#video").is_hidden()
    page.close()
