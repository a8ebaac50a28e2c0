"""The site is built without a warning and needs nothing of the network; its figures are current."""

import importlib
import re
import subprocess
import sys

import pytest
from pages import DOCS, PAGES, ROOT, page_id


@pytest.mark.slow
def test_the_site_is_built_strictly(tmp_path):
    for package in ("mkdocs", "material", "mkdocstrings_handlers.python"):
        pytest.importorskip(package)
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    for page in tmp_path.rglob("*.html"):
        loaded = re.findall(r"<(?:script|img|link|iframe)\b[^>]*", page.read_text())
        assert not [tag for tag in loaded if re.search(r"(?:src|href)=.?(?:https?:)?//", tag)]
    for page in (page_id(page) for page in PAGES if DOCS in page.parents):
        assert (tmp_path / page).with_suffix(".html").is_file(), page
    reference = (tmp_path / "reference/python/matching.html").read_text()
    assert 'id="mobilestereonet.StereoMatcher.from_pretrained"' in reference
    options = (tmp_path / "reference/command-line/predict.html").read_text()
    assert "<code>--left-right</code>" in options
    recipes = (tmp_path / "reference/recipes.html").read_text()
    assert "Largest norm of the gradient" in recipes and "paper-sceneflow" in recipes


def test_words_that_people_search_for_are_in_headings():
    headings = "\n".join(re.findall(r"^#+ .*", "\n".join(map(_text, PAGES)), flags=re.M)).lower()
    for word in ("realsense", "oak", "zed", "phone", "webcams", "jetson", "raspberry", "blender"):
        assert word in headings, word
    text = "\n".join(map(_text, PAGES)).lower()
    for word in ("notebook", "c++", "tensorrt", "kalibr", "rviz", "open3d", "rerun", "bag", "mesh"):
        assert word in text, word


def test_the_model_cards_are_those_of_the_weights(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS / "generate"))
    cards = importlib.import_module("cards")
    made = cards.card_pages()
    assert set(made) == {path.name for path in cards.FOLDER.iterdir()}
    for name, content in made.items():
        assert (cards.FOLDER / name).read_text("utf-8") == content, "python docs/generate/cards.py"


def _text(page):
    return page.read_text("utf-8")


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
