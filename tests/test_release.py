"""What a release must tell: versions, what it runs on, and what belongs in a report."""

import json
import re
from pathlib import Path

import pytest
import yaml

from mobilestereonet import __version__
from mobilestereonet.cli import info

ROOT = Path(__file__).parents[1]


def test_the_changelog_begins_with_this_version():
    text = (ROOT / "CHANGELOG.md").read_text()
    versions = re.findall(r"^## (.*)$", text, flags=re.M)
    assert versions[0].startswith(f"[{__version__}] - ")
    assert all(re.fullmatch(r"\[[\d.]+\] - \d{4}-\d\d-\d\d", version) for version in versions)
    kinds = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert set(re.findall(r"^### (.*)$", text, flags=re.M)) <= kinds


def test_the_workflow_has_the_pythons_and_the_oldest_pytorch_of_the_metadata():
    text = (ROOT / "pyproject.toml").read_text()
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    matrix = workflow["jobs"]["tests"]["strategy"]["matrix"]
    assert matrix["python"] == re.findall(r"Python :: (3\.\d+)", text)
    assert f">={matrix['python'][0]}" in text
    assert matrix["torch"][0].removesuffix(".*") == re.search(r'"torch>=([\d.]+),', text)[1]
    assert f"torch=={matrix['torch'][-1]}" in (ROOT / "README.md").read_text()


def test_the_workflow_names_what_holds_tests():
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    command = workflow["jobs"]["tests"]["steps"][-1]["run"]
    named = re.findall(r"tests/\S+", command)
    assert named
    for path in map(ROOT.joinpath, named):
        assert path.is_file() or any(path.rglob("test_*.py")), path


def test_constraints_are_names_and_versions_of_what_ci_installs():
    lines = (ROOT / ".ci/constraints.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if not line.startswith("#"))
    assert all(re.fullmatch(r"[a-z\d]+(-[a-z\d]+)*", name) for name in pinned)
    assert all(re.fullmatch(r"[\d.]+(post\d+)?", version) for version in pinned.values())
    needed = (ROOT / "pyproject.toml").read_text().partition("\ndependencies = [")[2]
    names = re.findall(r'^  "([\w-]+)', needed.partition("\n]")[0], flags=re.M)
    assert {name.lower().replace("_", "-") for name in names} <= pinned.keys()


def test_info_tells_what_a_report_needs(msnet):
    code, out, err = msnet("info", "--json")
    facts = json.loads(out)
    assert (code, err) == (0, "")
    assert facts["mobilestereonet"] == __version__
    assert facts["weights"].startswith("msnet2d.procedural-")
    assert re.search(r"\btorch \d+\.\d+", facts["packages"])
    assert re.search(r"^\d+\.\d+\S*, of opencv-python-headless \d", facts["OpenCV"])


@pytest.mark.parametrize("owners", [["opencv-python"], ["opencv-python", "opencv-python-headless"]])
def test_info_warns_of_two_opencvs(msnet, monkeypatch, owners):
    monkeypatch.setattr(info.metadata, "packages_distributions", lambda: {"cv2": owners})
    monkeypatch.setattr(info.metadata, "version", lambda name: "9.9")
    code, out, err = msnet("info")
    assert code == 0
    assert ", ".join(f"{name} 9.9" for name in owners) in out
    assert ("share one folder, cv2" in err) == (len(owners) > 1)
