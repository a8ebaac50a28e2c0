"""Two processes take the step that one process takes with twice the batch."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from short_run import save_teacher

pytestmark = pytest.mark.slow

# The command itself, with batch norms in eval mode, since those of a CPU are not synchronised.
SCRIPT = """
import sys
from pathlib import Path

import torch

from mobilestereonet.cli.main import main
from mobilestereonet.training.module import StereoModule

clip = StereoModule.configure_gradient_clipping


def batch_norms_in_eval_mode(self, batch, batch_idx):
    for module in self.accelerated.modules():
        if isinstance(module, torch.nn.modules.batchnorm._BatchNorm):
            module.eval()


def keep_gradients(self, optimizer, *arguments, **options):
    gradients = {name: p.grad.clone() for name, p in self.net.named_parameters()}
    torch.save(gradients, Path(sys.argv[2]) / f"gradients_{self.global_rank}.pt")
    clip(self, optimizer, *arguments, **options)


StereoModule.on_train_batch_start = batch_norms_in_eval_mode
StereoModule.configure_gradient_clipping = keep_gradients
main()
"""
VALUES = {
    "model": "table3a-v1-v1",
    "net.max_disparity": 32,
    "scenes.height": 80,
    "scenes.width": 128,
    "scenes.max_disparity": 40,
    "scenes.min_disparity": 4,
    "scenes.noise_textures": 16,
    "scenes.texture_size": 32,
    "augment.height": 64,
    "augment.width": 96,
    "val_scenes": 3,
    "val_every": 1,
    "steps": 1,
    "lr_batch": 4,
}


def _run(
    folder: Path, launcher: list[str], processes: int, batch_size: int, teacher: Path | None
) -> str:
    script = folder.parent / "train.py"
    script.write_text(SCRIPT)
    command = [*launcher, str(script), "train", str(folder), "--no-progress"]
    command += ["--accelerator", "cpu", "--devices", str(processes)]
    values = VALUES | {"batch_size": batch_size} | ({"teacher": teacher} if teacher else {})
    command += [f"--set={name}={value}" for name, value in values.items()]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MASTER_ADDR": "127.0.0.1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stderr


def _validation(folder: Path) -> dict[str, float]:
    with (folder / "csv/version_0/metrics.csv").open(newline="") as file:
        row = next(row for row in csv.DictReader(file) if row["val/epe"])
    return {name: float(row[name]) for name in ("val/epe", "val/d1", "val/occ/epe")}


TORCHRUN = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]


# A batch of two is rounded differently than two of one: on some processors a value or two then lie
# on the other side of a ReLU's zero, which moves small gradients most. A teacher is in bfloat16.
@pytest.mark.parametrize(
    ("taught", "tolerance"),
    [pytest.param(False, 2e-3, marks=pytest.mark.exhaustive), (True, 5e-3)],
)
def test_two_processes_are_one_with_twice_the_batch(taught, tolerance, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    teacher = tmp_path / "teacher.safetensors" if taught else None
    if teacher is not None:
        save_teacher(teacher, VALUES["model"])
    log = _run(one, [sys.executable], 1, 2, teacher)
    assert "Learning rate scaled by the global batch: 0.001 x 2 / 4 = 0.0005" in log
    log = _run(two, TORCHRUN, 2, 1, teacher)
    assert log.count("0.001 x 2 / 4 = 0.0005") == 1

    expected = torch.load(one / "gradients_0.pt")
    for rank in (0, 1):
        gradients = torch.load(two / f"gradients_{rank}.pt")
        assert gradients.keys() == expected.keys()
        errors = {name: gradient - expected[name] for name, gradient in gradients.items()}
        for name, error in errors.items():
            assert error.norm() <= 10 * tolerance * expected[name].norm(), (rank, name)
        whole, of_whole = (
            torch.cat([tensor.flatten() for tensor in tensors.values()]).norm()
            for tensors in (errors, expected)
        )
        assert whole <= tolerance * of_whole, rank
    # The third scene is one process's alone: the figures are those of all three.
    assert _validation(two) == pytest.approx(_validation(one), rel=max(1e-4, tolerance))
