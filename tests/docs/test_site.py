"""The site is built without a warning and needs nothing of the network; its figures are current."""

import importlib
import re
import subprocess
import sys

import pytest
from pages import PAGES, ROOT


@pytest.mark.slow
def test_the_site_is_built_strictly(tmp_path):
    for package in ("mkdocs", "material", "mkdocstrings_handlers.python"):
        pytest.importorskip(package)
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    for page in (tmp_path / page.with_suffix(".html").name for page in PAGES[2:]):
        loaded = re.findall(r"<(?:script|img|link|iframe)\b[^>]*", page.read_text())
        assert not [tag for tag in loaded if re.search(r"(?:src|href)=.?(?:https?:)?//", tag)]
    reference = (tmp_path / "reference.html").read_text()
    assert 'id="mobilestereonet.StereoMatcher.from_pretrained"' in reference


def test_the_figures_are_what_the_code_draws(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs/figures"))
    draw = importlib.import_module("draw")
    draw.draw(tmp_path)
    drawn = sorted(tmp_path.iterdir())
    assert {path.name for path in drawn} == {path.name for path in draw.IMAGES.glob("*.svg")}
    for figure in drawn:
        new, old = (
            re.findall(r"<text[^>]*>([^<]+)<", path.read_text())
            for path in (figure, draw.IMAGES / figure.name)
        )
        assert len(new) > 10 and new == old, f"{figure.name}: python docs/figures/draw.py"
