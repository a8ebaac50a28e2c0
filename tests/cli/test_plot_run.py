import cv2
import pytest

from mobilestereonet.cli.plot_run import plot_run
from mobilestereonet.errors import InputError


def _log(folder, version, rows):
    path = folder / "csv" / f"version_{version}" / "metrics.csv"
    path.parent.mkdir(parents=True)
    lines = ["epoch,step,train/loss,val/epe", *(f"0,{step},{loss}," for step, loss in rows)]
    path.write_text("\n".join(lines) + "\n")


def test_all_starts_of_a_run(tmp_path, capsys):
    _log(tmp_path, 0, [(9, 5.0), (19, 4.0)])
    plot_run([tmp_path])
    assert "curves of 1 start\n" in capsys.readouterr().out
    one = cv2.imread(str(tmp_path / "curves.png"))
    _log(tmp_path, 1, [(19, 4.1), (29, 3.0)])
    plot_run([tmp_path], tmp_path / "new" / "both.png")
    assert "curves of 2 starts" in capsys.readouterr().out
    both = cv2.imread(str(tmp_path / "new" / "both.png"))
    assert one.shape == both.shape and (one != both).any()


def test_no_run(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"metrics\.csv"):
        plot_run([tmp_path])
    assert not (tmp_path / "curves.png").exists()


@pytest.mark.parametrize(
    ("log", "words"),
    [
        (b"step,loss\n1,\xff\n", "not a text file"),
        (b"step,loss\nx,1\n", "step holds 'x', no number"),
        (b"step,loss\n1," + b"9" * 200_000, "not a CSV log"),
        (b"step" + b",c" * 2000 + b"\n1\n", "more than 1000 columns"),
    ],
)
def test_a_log_that_is_none(tmp_path, log, words):
    (tmp_path / "csv/version_0").mkdir(parents=True)
    (tmp_path / "csv/version_0/metrics.csv").write_bytes(log)
    with pytest.raises(InputError, match=words):
        plot_run([tmp_path])
    assert not (tmp_path / "curves.png").exists()


def test_several_runs(tmp_path, capsys, msnet):
    for name in ("a", "b"):
        _log(tmp_path / "runs" / name, 0, [(9, 5.0), (19, 4.0)])
    (tmp_path / "runs/ablation.json").touch()
    code, out, _ = msnet("plot-run", *sorted((tmp_path / "runs").iterdir()))
    assert code == 0 and "curves of 2 starts of 2 runs" in out
    assert cv2.imread(str(tmp_path / "runs/curves.png")) is not None
    code, _, told = msnet("plot-run", tmp_path / "runs/ablation.json")
    assert code == 2 and "no folder of a run" in told
