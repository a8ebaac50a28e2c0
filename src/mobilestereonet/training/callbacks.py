"""Lightning callbacks of a training run: checkpoints, moving average, time limit, progress."""

from __future__ import annotations

import os
from datetime import timedelta
from pathlib import Path
from threading import Event
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.errors import InputError, needs_extra

with needs_extra("train"):
    import lightning as L
    from lightning.pytorch.callbacks import (
        Callback,
        Checkpoint,
        Timer,
        TQDMProgressBar,
        WeightAveraging,
    )
    from lightning.pytorch.plugins.io import TorchCheckpointIO
    from lightning.pytorch.utilities import rank_zero_info


class AtomicCheckpoints(TorchCheckpointIO):
    """Reads and writes checkpoints: whole or absent, and data only.

    They are written beside their place, then renamed. (Lightning's own writer moves a file from the
    system's folder of temporary files, which may lie on another disk.)
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | os.PathLike[str], storage_options: Any = None
    ) -> None:
        """Write ``checkpoint`` to ``path``."""
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(f".{target.name}.part")
        torch.save(checkpoint, temporary)
        temporary.replace(target)

    def load_checkpoint(
        self,
        path: str | os.PathLike[str],
        map_location: Any = lambda storage, _: storage,
        weights_only: bool | None = None,
    ) -> dict[str, Any]:
        """Read a checkpoint of `save_checkpoint`, to the CPU; no code in it is run.

        Raises:
            FileNotFoundError: If there is no such file.
            InputError: If it is damaged, or holds objects other than tensors and plain data.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(f"{path}: no such checkpoint")
        try:
            found: dict[str, Any] = torch.load(path, map_location, weights_only=True)
        except Exception as error:  # whatever a damaged file makes of the reader
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise InputError(
                f"{path}: not a checkpoint of `msnet train` that is data only, nothing of it was "
                f"run ({reason}): start anew in another folder"
            ) from None
        return found


_OF_A_RUN = ("state_dict", "optimizer_states", "lr_schedulers", "loops", "callbacks")
"""What Lightning needs of a checkpoint to go on."""


def check_resumable(path: Path, module: L.LightningModule) -> None:
    """Check that a run can go on from a checkpoint, before anything of the run is changed.

    Raises:
        InputError: If it is damaged, no checkpoint of a training run, or one of another network.
    """
    found = AtomicCheckpoints().load_checkpoint(path)
    lacks = [name for name in _OF_A_RUN if not isinstance(found, dict) or name not in found]
    lacks = lacks or [name for name in _OF_A_RUN[:2] if not found[name]]
    if lacks:
        raise InputError(
            f"{path}: no checkpoint that a run can go on from, it lacks {', '.join(lacks)}: start "
            "anew in another folder"
        )
    its, own = (
        {name: tuple(getattr(value, "shape", ())) for name, value in dict(state).items()}
        for state in (found["state_dict"], module.state_dict())
    )
    if wrong := its.items() ^ own.items():
        name, _ = min(wrong)
        raise InputError(
            f"{path}: of another network than the recipe's: {name} is of shape "
            f"{its.get(name, 'none')}, not {own.get(name, 'none')}: start anew in another folder"
        )


class LastCheckpoint(Checkpoint):
    """Write a checkpoint every so many steps, at the last one, and when the run is stopped.

    Lightning calls checkpoints after all other callbacks: the moving average is up to date.
    """

    def __init__(self, path: Path, every: int) -> None:
        self.path = path
        self.every = every

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Say where a resumed run goes on."""
        if trainer.global_step:
            length = f" of {trainer.max_steps}" if trainer.max_steps > 0 else ""
            rank_zero_info(f"Going on after step {trainer.global_step}{length}")

    def on_train_batch_end(self, trainer: L.Trainer, *_: Any) -> None:
        """Write it, if it is time."""
        step = trainer.global_step
        if step % self.every == 0 or step == trainer.max_steps or trainer.should_stop:
            trainer.save_checkpoint(self.path, weights_only=False)


class TimeLimit(Timer):
    """Stop after some time; what a resumed run took before does not count."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Start from zero."""


class Clock(Timer):
    """Time in training, over all starts of a run, which ends when its duration is over.

    Args:
        seconds: The duration.
    """

    def __init__(self, seconds: float) -> None:
        super().__init__(timedelta(seconds=seconds), verbose=False)
        self.seconds = seconds

    def share(self) -> float:
        """Share of the duration that is over, 0..1."""
        return min(1.0, self.time_elapsed() / self.seconds)


class StopWhenAsked(Callback):
    """Stop the run after the step in which it was asked for, in all processes together.

    Args:
        stop: Asks for it; set in every process once one of them was asked.
    """

    def __init__(self, stop: Event) -> None:
        self.stop = stop

    def on_train_batch_end(self, trainer: L.Trainer, *_: Any) -> None:
        """Stop, without a validation."""
        if trainer.strategy.reduce_boolean_decision(self.stop.is_set(), all=False):
            self.stop.set()
            trainer.should_stop = True
            trainer.limit_val_batches = 0


class ProgressBar(TQDMProgressBar):
    """Lightning's bar, which would not know the length of a resumed run."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Begin at the current step."""
        super().on_train_start(trainer, pl_module)
        self.train_progress_bar.reset(trainer.max_steps if trainer.max_steps > 0 else None)
        self.train_progress_bar.initial = trainer.global_step


def moving_average(decay: float, device: str) -> WeightAveraging:
    """Exponential moving average of the weights and of the batch norms' statistics.

    The decay grows with the number of steps n as (1 + n) / (10 + n) up to ``decay``, so that the
    first, random weights are forgotten soon. Integers are copied.
    """

    def update(averages: list[Tensor], values: list[Tensor], count: Tensor | int) -> None:
        n = float(count)
        rest = 1 - min(decay, (1 + n) / (10 + n))
        if averages[0].is_floating_point():
            torch._foreach_lerp_(averages, values, rest)
        else:
            torch._foreach_copy_(averages, values)

    return WeightAveraging(device, multi_avg_fn=update)
