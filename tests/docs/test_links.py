"""Links between pages and to files, and the paths and names that pages tell."""

import importlib
import re

import pytest
import yaml
from pages import DOCS, GENERATED, PAGES, ROOT, inline_code, page_id, prose

import mobilestereonet

pages = pytest.mark.parametrize("page", PAGES, ids=page_id)


def anchors(page):
    """Ids of a page's headings."""
    found = set()
    for heading in re.findall(r"^#+ (.+)$", prose(page), flags=re.M):
        given = re.search(r"\{ #([\w-]+) \}$", heading)
        slug = re.sub(r"[^\w\s-]", "", heading).strip().lower()
        found.add(given[1] if given else re.sub(r"[-\s]+", "-", slug))
    return found | set(re.findall(r"^::: ([\w.]+)$", prose(page), flags=re.M))


@pages
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(page))
    for target in targets:
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        there = (page.parent / name).resolve() if name else page
        where = f"{page_id(page)}: {target}"
        if DOCS in page.parents:
            assert DOCS in there.parents, f"{where} is not in the site"
            if str(there.relative_to(DOCS)).startswith(GENERATED):
                continue
        assert there.exists(), where
        assert not anchor or anchor in anchors(there), where


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
    by_hook = (*GENERATED, "models/")
    written = {page_id(page) for page in PAGES if DOCS in page.parents}
    assert sorted(menu) == sorted(set(menu))
    assert {page for page in menu if not page.startswith(by_hook)} == {
        page for page in written if not page.startswith(by_hook)
    }


def test_the_reference_has_the_public_names():
    pages = (DOCS / "reference/python").glob("*.md")
    told = [n for p in pages for n in re.findall(r"^::: ([\w.]+)$", p.read_text(), flags=re.M)]
    assert len(told) == len(set(told))
    assert {f"mobilestereonet.{name}" for name in mobilestereonet.__all__} <= set(told)
    for place in told:
        room, _, name = place.rpartition(".")
        assert getattr(importlib.import_module(room), name).__doc__, place


def test_the_readmes_figures_are_those_of_the_pages():
    def rows(page):
        return {line for line in page.read_text().splitlines() if re.search(r"\| [\d.]+ px", line)}

    here = rows(ROOT / "README.md")
    assert here and here <= rows(ROOT / "docs/accuracy.md")
