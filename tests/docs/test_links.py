"""Links between pages and to files, and the paths and names that pages tell."""

import importlib
import re

import pytest
import yaml
from pages import PAGES, ROOT, inline_code, prose

import mobilestereonet

pages = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def anchors(page):
    """Ids of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", prose(page), flags=re.M)
    slugs = [re.sub(r"[^\w\s-]", "", heading).strip().lower() for heading in headings]
    return {re.sub(r"[-\s]+", "-", slug) for slug in slugs}


@pages
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(page))
    for target in targets:
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        there = (page.parent / name) if name else page
        assert there.exists(), f"{page.name}: {target}"
        if page.parent.name == "docs":
            assert ".." not in name, f"{page.name}: {target} is not in the site"
        assert not anchor or anchor in anchors(there), f"{page.name}: {target}"


@pages
def test_paths_in_the_text_exist(page):
    places = (ROOT, ROOT / "src/mobilestereonet")
    for code in inline_code(page):
        for path in re.findall(r"\b(?:src|docs|benchmarks|tests|nets|cli)/[\w./-]+\w", code):
            assert any((place / path).exists() for place in places), f"{page.name}: {path}"


def test_every_page_is_in_the_sites_menu():
    def leaves(entry):
        if isinstance(entry, str):
            return [entry]
        parts = entry.values() if isinstance(entry, dict) else entry
        return [leaf for part in parts for leaf in leaves(part)]

    menu = leaves(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"])
    assert sorted(menu) == sorted(page.name for page in PAGES if page.parent.name == "docs")


def test_the_reference_has_the_public_names():
    told = re.findall(r"^::: ([\w.]+)$", (ROOT / "docs/reference.md").read_text(), flags=re.M)
    assert {f"mobilestereonet.{name}" for name in mobilestereonet.__all__} <= set(told)
    for place in told:
        room, _, name = place.rpartition(".")
        assert getattr(importlib.import_module(room), name).__doc__, place


def test_the_readmes_figures_are_those_of_the_pages():
    def rows(page):
        return {line for line in page.read_text().splitlines() if re.search(r"\| [\d.]+ px", line)}

    here = rows(ROOT / "README.md")
    assert here and here <= rows(ROOT / "docs/accuracy.md")
