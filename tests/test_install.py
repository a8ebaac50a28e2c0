"""What the base install does, and what it says where an extra is missing."""

import subprocess
import sys

import cv2
import numpy as np
import pytest

EXTRAS = (
    *("lightning", "pytorch_lightning", "torchmetrics", "tensorboard", "kornia", "scipy"),
    *("skimage", "imageio", "matplotlib", "onnx", "onnxruntime", "openvino"),
    *("huggingface_hub", "av", "gradio", "ray", "rosbags", "rerun"),
    *("h5py", "OpenEXR"),
)
"""Modules that the base install does not bring."""

BASE_ONLY = f"""
import sys
from importlib.machinery import PathFinder

find = PathFinder.find_spec

def find_in_base(name, path=None, target=None):
    return None if name.partition(".")[0] in {EXTRAS!r} else find(name, path, target)

PathFinder.find_spec = find_in_base
from mobilestereonet.cli.main import main
main()
"""


def base_msnet(*arguments):
    """Run the command line as if no extra were installed."""
    command = [sys.executable, "-c", BASE_ONLY, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def pair_folder(tmp_path):
    """A pair with ground truth in the layout of the data set "folder"."""
    noise = np.random.default_rng(0).integers(0, 256, (64, 160, 3), dtype=np.uint8)
    views = {"left": noise[:, :128], "right": noise[:, 10:138]}
    for name, view in views.items():
        (tmp_path / name).mkdir()
        assert cv2.imwrite(str(tmp_path / name / "000.png"), view)
    (tmp_path / "disparity").mkdir()
    truth = np.full((64, 128), 10 * 256, np.uint16)
    assert cv2.imwrite(str(tmp_path / "disparity" / "000.png"), truth)
    return tmp_path


@pytest.mark.slow
def test_predict_and_evaluate_need_no_extra(pair_folder):
    views = (pair_folder / side / "000.png" for side in ("left", "right"))
    depth = ("--focal", 100, "--baseline", 0.1, "--points", pair_folder / "points.ply")
    done = base_msnet("predict", *views, "-o", pair_folder / "out", "--model", "msnet3d", *depth)
    assert done.returncode == 0, done.stderr
    assert any((pair_folder / "out").glob("000*.png"))
    assert (pair_folder / "points.ply").is_file()
    truth = ("--set", "disparity=disparity/*.png", "--set", "scale=256")
    done = base_msnet(
        "evaluate", "--data", "folder", "--root", pair_folder, *truth, "--model", "sgbm"
    )
    assert done.returncode == 0, done.stderr
    assert "EPE" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("demo", "-o", "out"), 'skimage is not installed: pip install "mobilestereonet[demo]"'),
        (("train", "run"), 'lightning is not installed: pip install "mobilestereonet[train]"'),
        (
            ("cost", "--paper", "--plot", "curve.png"),
            'matplotlib is not installed: pip install "mobilestereonet[plots]"',
        ),
        (
            ("video", "run.mcap", "--frames", "maps"),
            'rosbags is not installed: pip install "mobilestereonet[bags]"',
        ),
        (("web",), 'gradio is not installed: pip install "mobilestereonet[web]"'),
    ],
)
def test_a_missing_extra_is_named(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.mcap").touch()
    done = base_msnet(*arguments)
    assert done.returncode == 2
    assert message in done.stderr
