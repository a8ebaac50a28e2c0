"""Runs that end early: killed and resumed, they end as others do, bit for bit; Ctrl-C."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from mobilestereonet.data import write_pfm, write_png
from short_run import save_teacher

pytestmark = pytest.mark.slow

STEPS = 14
VALUES = {
    "model": "table3a-v1-v1",
    "net.max_disparity": 32,
    "scenes.height": 80,
    "scenes.width": 128,
    "scenes.max_disparity": 24,
    "scenes.min_disparity": 4,
    "scenes.noise_textures": 16,
    "scenes.texture_size": 32,
    "augment.height": 64,
    "augment.width": 96,
    "augment.patch": "[5,10]",
    "batch_size": 1,
    "uses": 2,
    "pool": 6,
    "val_scenes": 1,
    "val_every": 5,
    "save_every": 2,
    "steps": STEPS,
    "ema": 0.9,
}


def _start(folder: Path, *arguments: str, cwd: Path | None = None) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "mobilestereonet", "train", str(folder)]
    command += ["--accelerator", "cpu", "--no-progress", *arguments]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with (folder.parent / f"{folder.name}.log").open("ab") as log:
        return subprocess.Popen(
            command,
            env=environment,
            stdout=log,
            stderr=log,
            cwd=cwd,
            start_new_session=True,
            # As a program in the foreground has Ctrl-C, whatever runs the tests.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )


def _wait_for(file: Path, process: subprocess.Popen[bytes]) -> None:
    while process.poll() is None and not file.exists():
        time.sleep(0.001)


def _kill_after(file: Path, delay: float, process: subprocess.Popen[bytes]) -> None:
    _wait_for(file, process)
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "the run was over before it could be killed"


def _assert_equal(ours, theirs, name: str) -> None:
    assert type(ours) is type(theirs), name
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys(), name
        for key in ours:
            _assert_equal(ours[key], theirs[key], f"{name}.{key}")
    elif isinstance(ours, list | tuple):
        assert len(ours) == len(theirs), name
        for index, pair in enumerate(zip(ours, theirs, strict=True)):
            _assert_equal(*pair, f"{name}.{index}")
    elif isinstance(ours, torch.Tensor):
        assert torch.equal(ours, theirs), name
    else:
        assert ours == theirs, name


def test_killed_and_resumed(tmp_path):
    save_teacher(tmp_path / "teacher.safetensors", VALUES["model"])
    save_teacher(tmp_path / "initial.safetensors", VALUES["model"])
    (tmp_path / "photographs").mkdir()
    write_png(tmp_path / "photographs" / "0.png", np.full((32, 32, 3), 200, np.uint8))
    # From the folder of the first start.
    values = VALUES | {"teacher": "teacher.safetensors", "textures": "photographs"}
    values |= {"weights": "initial.safetensors"}
    settings = [f"--set={name}={value}" for name, value in values.items()]
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    first, other = (_start(f, *settings, cwd=tmp_path) for f in (killed, whole))
    delay = random.uniform(0, 0.5)
    _kill_after(killed / "last.ckpt", delay, first)
    stopped_at = torch.load(killed / "last.ckpt", weights_only=False)["global_step"]
    print(f"killed {delay:.3f} s after the first checkpoint, resumed from step {stopped_at}")
    assert 2 <= stopped_at < STEPS
    _wait_for(whole / "last.ckpt", other)
    (tmp_path / "initial.safetensors").unlink()  # a resumed run goes on from its checkpoint
    for process in (_start(killed, "--resume"), other):
        assert process.wait() == 0, (tmp_path / "killed.log").read_text()

    ours, theirs = (torch.load(f / "last.ckpt", weights_only=False) for f in (killed, whole))
    assert ours["global_step"] == theirs["global_step"] == STEPS
    for key in ("current_model_state", "state_dict", "averaging_state", "optimizer_states",
                "lr_schedulers"):  # fmt: skip
        _assert_equal(ours[key], theirs[key], key)
    average, current = theirs["state_dict"], theirs["current_model_state"]
    weight = next(name for name in average if name.endswith("weight"))
    assert not torch.equal(average[weight], current[weight])

    saved = [load_file(folder / "weights.safetensors") for folder in (killed, whole)]
    _assert_equal(*saved, "weights")
    name = weight.removeprefix("net.")
    assert torch.equal(saved[0][name], average[weight])
    assert (killed / "recipe.json").read_text() == (whole / "recipe.json").read_text()


def test_ctrl_c_ends_a_run_after_its_step(tmp_path):
    for side in ("left", "right", "disparity"):
        view = np.full((70, 110, 3), 90, np.uint8) + np.arange(110, dtype=np.uint8)[:, None]
        write_png(tmp_path / "pairs" / side / "0.png", view)
        write_pfm(tmp_path / "pairs" / side / "0.pfm", np.full((70, 110), 5, np.float32))
    values = VALUES | {"steps": 10_000, "save_every": 10_000, "val_every": 10_000, "data": "folder"}
    values |= {"root": "pairs", "data_options.disparity": "disparity/*.pfm"}
    run = tmp_path / "run"
    settings = [f"--set={name}={value}" for name, value in values.items()]
    process = _start(run, "--workers=1", *settings, cwd=tmp_path)
    _wait_for(run / "csv" / "version_0" / "metrics.csv", process)  # after the tenth step
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to the reader of files as well
    assert process.wait() == 130, (tmp_path / "run.log").read_text()
    said = (tmp_path / "run.log").read_text()
    step = torch.load(run / "last.ckpt", weights_only=False)["global_step"]
    assert said.count("Stopping after this step") == 1
    assert f"after {step} of 10000 steps; --resume goes on" in said and step < 10_000
    assert (run / "weights.safetensors").is_file()
    assert "val/epe" not in (run / "csv/version_0/metrics.csv").read_text()

    process = _start(run, "--resume", f"--set=steps={step + 1}")
    assert process.wait() == 0, (tmp_path / "run.log").read_text()
    assert f"Going on after step {step} of {step + 1}" in (tmp_path / "run.log").read_text()
