"""`msnet bench` and what it is made of."""

import math
import re

import cv2
import numpy as np
import pytest
import torch
from small_networks import Direct, Scoring, make, make_msnet

from mobilestereonet import Calibration, save_weights
from mobilestereonet.cli.early import QUALITIES
from mobilestereonet.data.calibration import write_calibration
from mobilestereonet.engines import benchmark, choose
from mobilestereonet.engines.benchmark import EngineTime, fastest
from mobilestereonet.engines.sgbm import StereoSGBM
from mobilestereonet.timing import time_interleaved


@pytest.mark.parametrize("kind", [Scoring, Direct])
def test_engines_are_timed_against_the_plain_network(kind):
    left, right = torch.rand(2, 1, 3, 32, 64)
    engines = [("torch", "fp32"), ("torch", "bf16")]
    told = []
    plain, *others = benchmark.benchmark_network(
        make(kind), left, right, engines, repeats=2, opening=lambda *engine: told.append(engine)
    )
    assert told == engines
    assert (plain.engine, plain.precision) == ("eager", "fp32")
    assert (plain.ratio, plain.difference) == (1, 0)
    assert [(row.engine, row.precision) for row in others] == engines
    for row in others:
        assert row.seconds > 0
        assert row.ratio == pytest.approx(plain.seconds / row.seconds)
    assert others[0].difference < 1e-4 < others[1].difference < 1


def test_engines_are_given_what_they_take():
    left, right = torch.rand(2, 1, 3, 30, 50)
    (row,) = benchmark.benchmark_engines([StereoSGBM(max_disparity=32)], left, right, repeats=1)
    assert (row.engine, row.precision, row.ratio) == ("sgbm", "int16", 1)


def test_the_fastest_of_each_precision():
    rows = [("eager", "fp32", 1, 0), ("torch", "fp32", 3, 0), ("openvino", "fp32", 2, 0.1)]
    rows += [("wrong", "fp32", 1, 7.0), ("broken", "fp32", 1, math.nan), ("a", "bf16", 4, 0)]
    times = [EngineTime(*row[:3], ratio=1.0, difference=row[3]) for row in rows]
    found = {precision: row.engine for precision, row in fastest(times).items()}
    assert found == {"fp32": "openvino", "bf16": "a"}


def test_functions_run_in_turns():
    order = []
    medians = time_interleaved(lambda: order.append("a"), lambda: order.append("b"), repeats=3)
    assert order == ["a", "b"] * 3
    assert len(medians) == 2 and all(seconds >= 0 for seconds in medians)


def test_command(msnet, tmp_path, monkeypatch):
    weights = tmp_path / "small.safetensors"
    save_weights(make_msnet(), weights)
    monkeypatch.setattr(choose, "installed_engines", lambda device: [("torch", "fp32")])
    arguments = ("bench", "--weights", weights, "--device", "cpu", "--repeats", 1)
    code, out, err = msnet(*arguments, "--size", 32, 64)
    assert code == 0
    assert err == "making ready: torch fp32\n"
    lines = out.splitlines()
    assert any("eager" in line and "1.00" in line for line in lines)
    assert any("torch" in line and "fp32" in line for line in lines)
    assert lines[-1] == "fastest in fp32: --runtime torch --precision fp32"
    code, _, err = msnet(*arguments, "--size", 30, 64)
    assert code == 2
    assert "height must be a multiple of 16, got 30" in err


def test_command_with_a_model_that_is_an_engine(msnet):
    code, out, _ = msnet("bench", "--model", "sgbm", "--size", 30, 50, "--repeats", 1)
    assert code == 0
    assert "sgbm, 30x50" in out
    assert "--runtime" not in out


def test_a_rig_tells_the_size_and_what_rectifying_takes(msnet, tmp_path, monkeypatch):
    weights, raw, plain = (tmp_path / name for name in ("w.safetensors", "raw.yml", "calib.txt"))
    save_weights(make_msnet(), weights)
    camera = np.array([[60.0, 0, 30], [0, 60, 20], [0, 0, 1]])
    storage = cv2.FileStorage(str(raw), cv2.FILE_STORAGE_WRITE)
    turned = cv2.Rodrigues(np.array([0.0, 0.02, 0.03]))[0]
    whole = {"M1": camera, "D1": np.zeros(5), "M2": camera, "D2": np.zeros(5), "R": turned}
    whole |= {"T": np.array([-0.1, 0, 0]), "image_width": 60, "image_height": 40}
    for name, value in whole.items():
        storage.write(name, value)
    storage.release()
    write_calibration(plain, Calibration(60, 0.1, cx=30, cy=20), (60, 40))
    monkeypatch.setattr(choose, "installed_engines", lambda device: [("torch", "fp32")])
    command = ("bench", "--device", "cpu", "--repeats", 1)
    code, out, _ = msnet(*command, "--weights", weights, "--rig", raw)
    assert code == 0
    assert "48x64, cpu" in out  # as predict pads it
    assert re.search(r"\nrectifying a pair of 60x40 to 60x40: \d+\.\d ms\n$", out)
    code, out, _ = msnet(*command, "--model", "sgbm", "--rig", plain)
    assert code == 0 and "sgbm, 40x60" in out and "of rectified pictures" in out
    code, out, err = msnet(*command, "--model", "sgbm", "--rig", plain, "--size", 80, 60)
    assert (code, out) == (2, "") and "of pictures of 60x40, these have 60x80" in err
    unsized = tmp_path / "unsized.txt"
    unsized.write_text(plain.read_text().partition("width")[0])
    code, out, err = msnet(*command, "--model", "sgbm", "--rig", unsized)
    assert (code, out) == (2, "") and "tells no one size of its pictures: give --size" in err


def test_the_quality_levels(msnet):
    code, out, _ = msnet("bench", "--levels", "--size", 64, 96, "--repeats", 1)
    assert code == 0
    assert [line for line in ("fast", "balanced", "best") if f"│ {line} " in out] == [*QUALITIES]
    code, _, error = msnet("bench", "--levels", "--model", "msnet2d")
    assert code == 2 and "leave out the network" in error
