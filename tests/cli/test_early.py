"""Mistakes on the command line are told before PyTorch is imported."""

import subprocess
import sys

import pytest

from mobilestereonet.cli import early
from mobilestereonet.cli.early import ENGINES, UNITS, check_values
from mobilestereonet.data import camera_files
from mobilestereonet.data.depth_files import DEPTH_FORMATS
from mobilestereonet.engines import choose
from mobilestereonet.errors import InputError
from mobilestereonet.export import FORMATS
from mobilestereonet.inference.geometry import POINT_FORMATS
from mobilestereonet.training import recipe

PROGRAM = """
import sys
from mobilestereonet.cli.main import main
try:
    main()
finally:
    heavy = {"torch", "numpy", "cv2"} & set(sys.modules)
    assert not heavy, heavy
"""


@pytest.fixture
def views(tmp_path):
    for name in ("left.png", "right.png"):
        (tmp_path / name).touch()
    return tmp_path / "left.png", tmp_path / "right.png", "-o", tmp_path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--runtime", "openvin"), "--runtime openvin: did you mean openvino?"),
        (("--precision", "fp64"), "--precision fp64: did you mean fp16? There are auto, fp32"),
        (("--device", "cuda:x"), "--device cuda:x: write it as auto, cpu, cuda or cuda:1"),
        (("--model", "msnet4d"), "did you mean msnet"),
        (("--model", "baseline2d"), "need --weights FILE"),
        (("--model", "absent.ckpt"), "absent.ckpt: no such file"),
        (("--model", "my_net.py:MyNet"), "there is no file my_net.py"),
        (("--model", "onnx:absent.onnx"), "there is no file absent.onnx"),
        (("--calib", "absent.txt"), "absent.txt: no such file"),
        (("--depth", "depth.jpg"), "depth.jpg: depth is written as .png, .npy, .tif, .tiff"),
        (("--weights", "nope.ckpt"), "msnet: nope.ckpt: no such file"),
        (("--unit", "cm"), "--unit cm: "),
    ],
)
def test_mistakes_are_told_before_heavy_imports(views, arguments, message):
    command = [sys.executable, "-c", PROGRAM, "predict", *map(str, views), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("command", ["predict", "doctor", "rectify"])
def test_an_absent_view(command, tmp_path):
    arguments = [command, str(tmp_path / "absent.png"), str(tmp_path / "absent.png")]
    arguments += ["-o", str(tmp_path)] if command == "predict" else []
    arguments += ["-o", str(tmp_path), "--calib", "absent.yml"] if command == "rectify" else []
    command = [sys.executable, "-c", PROGRAM, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert "absent.png: no such file" in done.stderr


def test_the_engines_are_those_that_there_are():
    assert set(ENGINES) == set(choose.ENGINES)
    assert set(early.RECIPES) == set(recipe.RECIPES)
    assert set(early.FORMATS) == set(FORMATS)
    endings = {"depth": DEPTH_FORMATS, "points": POINT_FORMATS}
    assert endings == early.OUTPUT_ENDINGS


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--recipe", "procedurel"), "--recipe procedurel: did you mean procedural? There are"),
        (("--set", "lr"), "'lr': write it as key=value"),
    ],
)
def test_mistakes_of_train(tmp_path, arguments, message):
    command = [sys.executable, "-c", PROGRAM, "train", str(tmp_path), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr


def test_the_units_are_those_that_there_are():
    assert set(UNITS) == set(camera_files._METRES)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("export", "onx"), "format onx: did you mean onnx? There are onnx, openvino"),
        (("video", "in.mp4"), "nothing to write: give --output VIDEO, --frames FOLDER or both"),
    ],
)
def test_mistakes_of_other_commands(arguments, message):
    command = [sys.executable, "-c", PROGRAM, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr


def test_training_takes_networks_without_weights():
    check_values({"model": "baseline2d", "weights": None, "recipe": "procedural"})
    with pytest.raises(InputError, match="need --weights FILE"):
        check_values({"model": "baseline2d", "weights": None})


def test_the_recipe_of_a_run_is_no_name():
    check_values({"recipe": "runs/first/recipe.json"})
    with pytest.raises(InputError, match="--recipe runs/first: there are"):
        check_values({"recipe": "runs/first"})
