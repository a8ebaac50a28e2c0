"""Photographs the web page as it opens, for its own page: python docs/figures/web.py.

Needs the extra ``browser`` and Chromium.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

FILE = Path(__file__).parents[1] / "images/web.webp"
SIZE = {"width": 1280, "height": 900}


@contextmanager
def served() -> Iterator[str]:
    """Run ``msnet web``; gives its address."""
    command = [sys.executable, "-m", "mobilestereonet", "web"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        yield next(re.finditer(r"http://\S+", server.stdout.readline()))[0]
    finally:
        server.terminate()
        server.wait()


def main() -> None:
    """Write the picture."""
    with served() as address, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        page = browser.new_page(viewport=SIZE)
        page.goto(address)
        page.locator("#ticks", has_text=" m").wait_for()
        page.wait_for_function("[...document.images].every(i => i.complete)")
        content = page.screenshot()
        browser.close()
    Image.open(BytesIO(content)).convert("RGB").save(FILE, quality=80, method=6)


if __name__ == "__main__":
    main()
