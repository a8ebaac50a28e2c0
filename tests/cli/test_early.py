"""Mistakes on the command line are told before PyTorch is imported."""

import json
import subprocess
import sys
from dataclasses import fields
from typing import get_args

import pytest

from mobilestereonet.cli import early, sources
from mobilestereonet.cli.early import check_registered, check_trained
from mobilestereonet.data import scanners
from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.data.depth_files import DEPTH_FORMATS
from mobilestereonet.data.rig import told as rig_told
from mobilestereonet.engines import choose
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation import BENCHMARKS, comparison, result_table
from mobilestereonet.export import FORMATS
from mobilestereonet.inference.geometry import POINT_FORMATS
from mobilestereonet.nets import list_models, model_config
from mobilestereonet.paper import ablate
from mobilestereonet.scenes import SceneConfig
from mobilestereonet.streams import maps, video_files
from mobilestereonet.training import named_recipes
from mobilestereonet.training.recipe import Recipe

PROGRAM = """
import contextlib, io, json, sys
from mobilestereonet.cli.main import main

class Refuser:
    def find_spec(self, name, *_):
        if name in ("torch", "numpy", "cv2"):
            sys.exit(f"imports {name}")

sys.meta_path.insert(0, Refuser())
for line in sys.stdin.read().splitlines():
    sys.argv = ["msnet", *line.split()]
    with contextlib.redirect_stderr(io.StringIO()) as told:
        try:
            main()
        except SystemExit as ended:
            code = ended.code
    print(json.dumps([code, told.getvalue()]))
"""
"""Commands one after the other; what takes long to import ends a command."""

NETWORK = ("--model msnet4d", "--model absent.ckpt", "--model onnx:absent.onnx")
NETWORK += ("--model baseline2d", "--model my_net.py:MyNet", "--weights absent.ckpt", "--set mean")
NETWORK += ("--model sgbm --weights absent.ckpt", "--model my_net.py:", "--set net.colour=red")
ENGINE = ("--threads 0", "--device cuda:x")
MATCHER = (*NETWORK, *ENGINE, "--runtime openvin", "--precision fp64")
CALIBRATION = ("--calib absent.txt", "--focal 900", "--baseline 0.2", "--doffs 3", "--unit inch")
CALIBRATION += ("--fov 60", "--focal 900 --calib left.png")
TRAINING = ("--precision fp16", "--accelerator gpus", "--recipe procedurel", "--set lr")
TRAINING += ("--recipe absent/recipe.json", "--set colour=red", "--set augment.colour=red")
TRAINING += ("--root absent", "--textures absent", "--workers -1")
PAIR = "left.png right.png"

MISTAKES = {
    "demo": MATCHER,
    f"predict {PAIR} -o out": (
        "--set estimator=mean",
        *(
            *MATCHER,
            *CALIBRATION,
            "--depth depth.jpg",
            "--points points.stl",
            "--mesh a.ply",
            "--max-depth 3",
        ),
        *("--focal 900 --baseline 0.2", "--depth depth.npy", "--min-confidence 2", "--tile 3"),
    ),
    "predict absent.png right.png -o out": ("",),
    "predict left.png absent.png -o out": ("",),
    f"doctor {PAIR}": ("--max-disparity 0", "--layout over", "--rotate 45", "--rig absent.txt"),
    "doctor absent.png absent.png": ("",),
    f"rectify {PAIR} -o out": ("--calib absent.yml", "--calib left.png --unit inch"),
    "rectify absent.png absent.png --calib left.png -o out": ("",),
    "video left.mp4": ("--output out.avi", "--output out.mp4 --resume", "--frames out --beside"),
    "video left.mp4 --frames out": (*MATCHER, *CALIBRATION, "--fps 0"),
    "batch left right": ("--skip-existing",),
    "batch left right -o out": (*MATCHER, *CALIBRATION, "--write depth.jpg", "--workers 0"),
    "models": ("msnet4d", "my_net.py:MyNet"),
    "cost": ("--model msnet4d", "--set planes=3", "--plot out.png", "--paper --height 3"),
    "evaluate --data folder --root .": (
        *(*MATCHER[:-1], "--set left", "--batch-size 0", "--root absent"),
        *("-o table.xls", "--format latx", "--statistic mode"),
        *("--model msnet2d --model msnet3d --weights left.png", "--rig absent.txt"),
    ),
    "evaluate --data kitty2015 --root .": ("",),
    "compare left.png msnet4d --data folder --root .": ("",),
    "compare msnet2d --data folder --root .": ("--root absent", "--device cuda:x", "-o t.xls"),
    "submit kitti2015 --root . -o out.zip": (*MATCHER, "--size T", "--root absent"),
    "submit kitty2015 --root . -o out.zip": ("",),
    "train run": (
        *(*TRAINING, "--model msnet4d", "--model my_net.py:MyNet", "--weights absent.ckpt"),
        *("--max-time 3h", "--devices 0", "--num-nodes 0", "--set net.colour=red"),
    ),
    "ablate runs": (
        *(*TRAINING, "--table 4", "--models msnet2d,msnet4d", "--steps 0", "--seeds 0"),
        *("--vary lr", "--vary colour=1,2", "--vary net.colour=1,2"),
    ),
    "average left.ckpt -o out.safetensors": ("",),
    "average msnet2d": ("-o out.ckpt", "-o out.safetensors --model msnet4d"),
    "fit-confidence left.ckpt -o out.safetensors": ("",),
    "fit-confidence msnet2d": ("-o out.ckpt", "-o out.safetensors --scenes 0"),
    "plot-run absent": ("",),
    "export": ("", "onx"),
    "export onnx": (*NETWORK, "--precision fp8", "--calibration absent", "--height 0"),
    "bench": (*NETWORK, *ENGINE, "--size 0 32", "--repeats 0"),
    "web": ("--precision fp64", *ENGINE, "--set mean", "--port 0x", "--rig absent.txt"),
    "data preview kitty2015 -o out.png": ("",),
    "data preview folder -o out.png": ("", "--root absent", "--set left"),
    "data preview procedural -o out.png": ("--textures absent", "--count 0", "--seed -1"),
}
"""Values that are wrong by themselves, by command; in a folder that has a left and a right view."""


MESSAGES = {
    f"predict {PAIR} -o out --runtime openvin": "--runtime openvin: did you mean openvino?",
    f"predict {PAIR} -o out --precision fp64": "did you mean fp16? There are auto, fp32",
    f"predict {PAIR} -o out --device cuda:x": "write it as auto, cpu, cuda or cuda:1",
    f"predict {PAIR} -o out --model msnet4d": "did you mean msnet",
    f"predict {PAIR} -o out --model baseline2d": "need --weights FILE",
    f"predict {PAIR} -o out --model absent.ckpt": "absent.ckpt: no such file",
    f"predict {PAIR} -o out --model my_net.py:MyNet": "there is no file my_net.py",
    f"predict {PAIR} -o out --model onnx:absent.onnx": "there is no file absent.onnx",
    f"predict {PAIR} -o out --calib absent.txt": "absent.txt: no such file",
    f"predict {PAIR} -o out --depth depth.jpg": "depth is written as .png, .npy, .tif, .tiff",
    f"predict {PAIR} -o out --set mean": "'mean': write it as key=value",
    "predict absent.png right.png -o out": "absent.png: no such file",
    f"predict {PAIR} -o out --set net.estimater=mean": "did you mean estimator?",
    "train run --set crop_height=64": "(did you mean scenes.height or augment.height?)",
    "train run --set scenes.heigth=64": "scenes has no value 'heigth' (did you mean height?), only",
    "train run --recipe procedurel": "--recipe procedurel: did you mean procedural? There",
    "train run --precision fp16": "--precision fp16: did you mean bf16? There are 32-true",
    "train run --max-time 3h": "--max-time 3h: write it as DD:HH:MM:SS",
    "cost --model msnet4d": "unknown model 'msnet4d': did you mean msnet",
    "export onx": "format onx: did you mean onnx? There are onnx, openvino",
    "evaluate --data kitty2015 --root .": "did you mean kitti2015? There are argoverse",
    "video in.mp4 --resume": "--resume needs --frames FOLDER, where the frames' maps are kept",
    "batch left right --skip-existing": "--skip-existing needs --output FOLDER, which has the maps",
    "predict left.png right.png --model msnet2d.x": "no version 'msnet2d.x' comes with the package",
}


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What the commands say in a folder with two views: exit code and text of each."""
    folder = tmp_path_factory.mktemp("folder")
    for name in ("left.png", "right.png"):
        (folder / name).touch()
    commands = [f"{command} {bad}" for command, values in MISTAKES.items() for bad in values]
    commands += MESSAGES
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input="\n".join(commands),
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(zip(commands, map(json.loads, done.stdout.splitlines()), strict=True))


def test_mistakes_are_told_before_heavy_imports(told):
    assert not {command: answer for command, answer in told.items() if answer[0] != 2}


@pytest.mark.parametrize("command", MESSAGES)
def test_what_is_said_of_a_mistake(told, command):
    _, text = told[command]
    assert MESSAGES[command] in text
    assert text.startswith("msnet: ")
    assert text.count("\n") == 1


def test_the_names_are_those_of_the_rooms():
    assert set(early.ENGINES) == set(choose.ENGINES)
    assert set(sources.RECIPES) == set(named_recipes.RECIPES)
    assert set(early.FORMATS) == set(FORMATS)
    assert set(early.EXPORT_PRECISIONS) == {p for f in FORMATS.values() for p in f.precisions}
    assert set(early.BENCHMARKS) == set(BENCHMARKS)
    assert {size for benchmark in BENCHMARKS.values() for size in benchmark.sizes} == {
        *early.BENCHMARK_SIZES
    }
    assert set(early.TABLES) == set(ablate.TABLES)
    assert dict(zip(early.TABLE_ENDINGS, early.TABLE_FORMATS, strict=True)) == result_table.ENDINGS
    assert set(early.STATISTICS) == set(comparison.STATISTICS)
    assert set(early.MAP_KINDS) == set(maps.MAP_KINDS)
    assert tuple(rig_told.UNITS) == early.UNITS
    assert early.DEPTH_ENDINGS == DEPTH_FORMATS
    assert early.POINTS_ENDINGS == POINT_FORMATS
    assert early.VIDEO_ENDINGS == video_files.VIDEO_FORMATS
    assert set(sources.data_sets()) == set(scanners.data_sets())
    for name in list_models():
        check_registered(name)
    configs = {"recipe": Recipe, "augment": AugmentConfig, "scenes": SceneConfig}
    assert sources.recipe_fields() == {
        part: [field.name for field in fields(config)] for part, config in configs.items()
    }
    of_networks = {field.name for name in list_models() for field in fields(model_config(name))}
    assert set(sources.network_fields()) == of_networks


def test_the_precisions_of_training_are_lightnings():
    connector = pytest.importorskip("lightning.fabric.connector")
    known = get_args(connector._PRECISION_INPUT_STR)
    aliases = get_args(connector._PRECISION_INPUT_STR_ALIAS)
    assert set(early.TRAINING_PRECISIONS) == {*known, *aliases}


def test_weights_tell_a_networks_name(tmp_path):
    check_trained("baseline2d", tmp_path)
    with pytest.raises(InputError, match="need --weights FILE"):
        check_trained("baseline2d", None)
    with pytest.raises(InputError, match="unknown model 'msnet4d'"):
        check_trained("msnet4d", tmp_path)
