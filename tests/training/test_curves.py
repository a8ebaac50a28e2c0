"""Curves of runs, and the command that draws them."""

import cv2
import pytest
from matplotlib.figure import Figure

from mobilestereonet.errors import InputError
from mobilestereonet.training.curves import plot_curves

LOG = """epoch,lr-Adam,step,train/loss_step,val/epe,val/loss
0,0.001,0,10.0,,
0,0.001,50,1.0,,
0,,99,,2.5,0.9
1,0.0005,150,0.1,,
"""


@pytest.fixture
def figures(monkeypatch) -> list[Figure]:
    """Every figure that is made during the test."""
    made: list[Figure] = []
    original = Figure.__init__

    def watched(self, *args, **kwargs):
        made.append(self)
        original(self, *args, **kwargs)

    monkeypatch.setattr(Figure, "__init__", watched)
    return made


def test_curves(tmp_path, figures):
    log = tmp_path / "run" / "metrics.csv"
    log.parent.mkdir()
    log.write_text(LOG)
    plot_curves({"run": [log]}, tmp_path / "curves.png")
    picture = cv2.imread(str(tmp_path / "curves.png"))
    assert picture is not None and (picture != 255).any()
    panels = {axes.get_ylabel(): axes for axes in figures[0].axes}
    assert list(panels) == ["loss", "epe", "lr"]
    assert [panels[name].get_yscale() for name in panels] == ["log", "linear", "linear"]
    lines = {line.get_label(): line.get_xydata().tolist() for line in panels["loss"].lines}
    assert lines == {
        "train/loss_step": [[0, 10.0], [50, 1.0], [150, 0.1]],
        "val/loss": [[99, 0.9]],
    }


def test_starts_of_a_run_share_colour_and_label(tmp_path, figures):
    logs = [tmp_path / start / "metrics.csv" for start in ("version_0", "version_1")]
    for log in logs:
        log.parent.mkdir()
        log.write_text(LOG)
    plot_curves({"run": logs}, tmp_path / "curves.png")
    panels = {axes.get_ylabel(): axes for axes in figures[0].axes}
    assert len(panels) == len(figures[0].axes) == 3
    colours = [line.get_color() for line in panels["loss"].lines]
    assert len(colours) == 4 and len(set(colours)) == 2
    labels = [text.get_text() for text in panels["loss"].get_legend().get_texts()]
    assert labels == ["train/loss_step", "val/loss"]


def test_curves_of_bad_logs(tmp_path):
    log = tmp_path / "metrics.csv"
    with pytest.raises(InputError, match=r"metrics\.csv: not a file"):
        plot_curves({"run": [log]}, tmp_path / "curves.png")
    log.write_text("step,epoch\n1,0\n")
    with pytest.raises(InputError, match="no curve"):
        plot_curves({"run": [log]}, tmp_path / "curves.png")
    log.write_text("step,loss\n1,much\n")
    with pytest.raises(InputError, match="much"):
        plot_curves({"run": [log]}, tmp_path / "curves.png")
    assert list(tmp_path.iterdir()) == [log]


def test_several_runs_have_a_colour_each(tmp_path, figures):
    runs = {name: [tmp_path / name / "metrics.csv"] for name in ("first", "second")}
    for (log,) in runs.values():
        log.parent.mkdir()
        log.write_text(LOG)
    plot_curves(runs, tmp_path / "curves.png")
    panels = {axes.get_ylabel(): axes for axes in figures[0].axes}
    assert list(panels) == ["loss", "epe", "lr"]
    lines = panels["loss"].lines
    looks = {line.get_label(): (line.get_color(), line.get_linestyle()) for line in lines}
    assert looks == {
        "first: train/loss_step": ("C0", "-"),
        "second: train/loss_step": ("C1", "-"),
        "first: val/loss": ("C0", "--"),
        "second: val/loss": ("C1", "--"),
    }
    assert [line.get_label() for line in panels["epe"].lines] == ["first", "second"]
