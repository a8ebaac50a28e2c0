"""A training step of the final networks, ours and in the authors' formulation, in one table.

    python benchmarks/training_step.py [--models msnet2d msnet3d] [--repeats 5] [--threads 2]
        [--device cuda] [--batch 8]

Ours is the step of `msnet train` under the recipe ``procedural``: all disparities in one batch, the
head in closed form, bfloat16 autocast, channels last; once with the paper's loss on four heads and
the paper's optimizer.
The authors' is the network of ``nets/``: a loop over 48 cropped pairs, one view after the other,
four heads upsampled to 192 x H x W, float32, the default memory layout. Each is measured in a
process of its own, whose largest resident size is the peak memory; on a GPU it is what PyTorch
allocates there, and its settings are PyTorch's own: float32 convolutions in TF32.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import lightning as L
import torch
from rich.console import Console
from rich.table import Table
from torch.utils.data import DataLoader

from mobilestereonet.accelerate import accelerate
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.memory import keep_freed_memory
from mobilestereonet.nets import build_model, trained_pixels
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.named_recipes import get_recipe
from mobilestereonet.training.pool import TrainingBatch

VARIANTS = {
    "authors": "authors' formulation, float32",
    "paper loss": "ours, the paper's loss and Adam, bfloat16",
    "ours": "ours, recipe procedural, bfloat16",
}


def random_pairs(batch: int, height: int, width: int) -> StereoSample:
    """Noise: the time of a step does not depend on what is in the pairs."""
    generator = torch.Generator().manual_seed(0)
    left, right = torch.rand(2, batch, 3, height, width, generator=generator)
    disparity = torch.rand(batch, height, width, generator=generator) * 190 + 1
    return StereoSample(left, right, disparity, disparity > 0, name="noise")


def now(device: str) -> float:
    """Seconds on a clock, once all that was asked of the device is done."""
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


def authors_steps(model: str, pairs: StereoSample, device: str) -> Iterator[float]:
    """Seconds of step after step in the authors' formulation."""
    check(model)
    pairs = pairs.to(device)
    plain = build_model(model).train().to(device)
    optimizer = torch.optim.Adam(plain.parameters(), lr=1e-3, betas=(0.9, 0.999))
    views = [plain.preprocessing(view) for view in (pairs.left, pairs.right)]
    mask = trained_pixels(pairs.disparity, pairs.valid, plain.max_disparity)
    while True:
        started = now(device)
        loss = plain.training_loss(plain(*views), pairs.disparity, mask)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        yield now(device) - started


def check(model: str) -> None:
    """Both formulations are the same function in eval mode."""
    net = build_model(model, max_disparity=32).double().eval()
    generator = torch.Generator().manual_seed(0)
    views = torch.randn(2, 1, 3, 32, 64, dtype=torch.float64, generator=generator).unbind()
    with torch.no_grad():
        torch.testing.assert_close(accelerate(net, "training").eval()(*views), net(*views))


class Clock(L.Callback):
    """Seconds of each step of a run."""

    def __init__(self, device: str) -> None:
        self.device = device
        self.seconds: list[float] = []

    def on_train_batch_start(self, *_: object) -> None:
        """Note the time."""
        self.started = now(self.device)

    def on_train_batch_end(self, *_: object) -> None:
        """Note how long it took."""
        self.seconds.append(now(self.device) - self.started)


def our_steps(
    model: str, pairs: StereoSample, device: str, paper_loss: bool, steps: int
) -> list[float]:
    """Seconds of each of ``steps`` steps of `msnet train`, guard and logging included."""
    recipe = replace(get_recipe("procedural"), model=model, batch_size=len(pairs.left))
    if paper_loss:
        recipe = replace(get_recipe("procedural-plain"), model=model, optimizer="adam")
        recipe = replace(recipe, batch_size=len(pairs.left))
    keep_freed_memory()
    clock = Clock(device)
    trainer = L.Trainer(
        accelerator="gpu" if device == "cuda" else "cpu",
        devices=1,
        precision="bf16-mixed",
        max_steps=steps,
        callbacks=[clock],
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    batches = [TrainingBatch(pairs)] * steps
    module = StereoModule(recipe, steps, recipe.batch_size)
    trainer.fit(module, DataLoader(batches, batch_size=None))
    return clock.seconds


def measure(
    model: str, variant: str, device: str, batch: int, height: int, width: int, repeats: int
) -> dict[str, float]:
    """Median time after one step of warming up, and peak memory of this process."""
    pairs = random_pairs(batch, height, width)
    if variant == "authors":
        seconds = list(islice(authors_steps(model, pairs, device), repeats + 1))
    else:
        seconds = our_steps(model, pairs, device, variant == "paper loss", repeats + 1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    if device == "cuda":
        peak = torch.cuda.max_memory_allocated()
    return {"seconds": statistics.median(seconds[1:]), "peak": peak / 1024**3}


def measure_apart(
    arguments: argparse.Namespace, model: str, variant: str
) -> dict[str, float] | str:
    """`measure` in a process of its own, or why it failed, such as for lack of memory."""
    names = ("device", "batch", "height", "width", "repeats")
    options = [str(getattr(arguments, name)) for name in names]
    done = subprocess.run(
        [sys.executable, __file__, "--one", model, variant, *options],
        env={**os.environ, "OMP_NUM_THREADS": str(arguments.threads)},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        reason = (done.stderr.splitlines() or [f"exit status {done.returncode}"])[-1]
        return reason.split(". ")[0]
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--models", nargs="+", default=["msnet2d", "msnet3d"])
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--batch", type=int, default=1, help="pairs per step")
    parser.add_argument("--height", type=int, default=256)
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=5, help="timed steps, the median counts")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--one", nargs=7, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    if arguments.one:
        model, variant, device, *numbers = arguments.one
        print(json.dumps(measure(model, variant, device, *map(int, numbers))))
        return
    machine = f"{arguments.threads} threads"
    if arguments.device == "cuda":
        machine = torch.cuda.get_device_name()
    table = Table(
        title=f"Training step, batch {arguments.batch}, {arguments.height} x {arguments.width}, "
        f"{machine}, median of {arguments.repeats}"
    )
    table.add_column("network")
    table.add_column("formulation")
    for column in ("seconds", "times faster", "peak GiB"):
        table.add_column(column, justify="right")
    for model in arguments.models:
        results = {name: measure_apart(arguments, model, name) for name in VARIANTS}
        authors = results["authors"]
        for name, result in results.items():
            if isinstance(result, str):
                table.add_row(model, f"{VARIANTS[name]}: {result}")
                continue
            faster = ""
            if not isinstance(authors, str):
                faster = f"{authors['seconds'] / result['seconds']:.1f}"
            cells = (f"{result['seconds']:.3f}", faster, f"{result['peak']:.2f}")
            table.add_row(model, VARIANTS[name], *cells)
        table.add_section()
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
