"""A training run: trainer, checkpoints, logs, weights."""

from __future__ import annotations

import json
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import torch

from mobilestereonet.atomic import (
    check_outputs,
    locked_folder,
    make_folder,
    note_inputs,
    write_text,
)
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.interruption import sigint_sets_event
from mobilestereonet.nets import is_model, model_config, model_name
from mobilestereonet.settings import differences
from mobilestereonet.training.callbacks import (
    AtomicCheckpoints,
    Clock,
    LastCheckpoint,
    ProgressBar,
    StopWhenAsked,
    TimeLimit,
    check_resumable,
    moving_average,
)
from mobilestereonet.training.data import RunData
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.named_recipes import read_recipe
from mobilestereonet.training.recipe import Recipe
from mobilestereonet.weights import load_model, save_weights

with needs_extra("train"):
    import lightning as L
    from lightning.fabric.utilities.exceptions import MisconfigurationException
    from lightning.pytorch.callbacks import Callback
    from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
    from lightning.pytorch.utilities import rank_zero_info, rank_zero_only

_MAX_BATCH_PIXELS = 1 << 29
"""Pixels of all views of one side in a batch: 6 GB as float32 RGB."""

_STOPPING = "Stopping after this step; Ctrl-C again stops at once"


def train(
    recipe: Recipe,
    folder: Path,
    *,
    resume: bool = False,
    max_time: str | None = None,
    precision: str = "32-true",
    accelerator: str = "auto",
    devices: int = 1,
    num_nodes: int = 1,
    workers: int = 0,
    progress: bool = True,
) -> StereoModule:
    """Train a network; write checkpoints, logs and the weights into ``folder``.

    ``folder`` gets ``recipe.json``, ``last.ckpt``, ``csv/version_*/metrics.csv`` and
    ``tensorboard`` (a version for each start) and, at the end, when time is up or after Ctrl-C,
    ``weights.safetensors`` (averaged where the recipe has an average); ``recipe.json`` then also
    holds the steps of a run by the clock.

    On GPUs the ranks' batch norms are synchronised; on CPUs, which torch's SyncBatchNorm refuses,
    each rank normalises its own batch, and the statistics of the first one are kept.

    Args:
        recipe: What to train, on what, how.
        folder: Folder of the run.
        resume: Go on from ``folder/last.ckpt``, exactly where it was written.
        max_time: Stop, with a checkpoint, after this time, written DD:HH:MM:SS; a resumed run
            has it again.
        precision: Lightning's precision, such as "bf16-mixed".
        accelerator: Lightning's accelerator.
        devices: Devices per node.
        num_nodes: Nodes.
        workers: Processes that read files or make procedural scenes, which are made on the
            training device if there are none.
        progress: Show a progress bar.

    Returns:
        The module, with the averaged weights; of an unfinished run where time was up.

    Raises:
        FileNotFoundError: If a run to resume has lost its recipe, or a file or folder that the
            recipe names is not there.
        InputError: If the folder holds another run or one that is going on, or none to resume, or
            one that started from other weights, or its checkpoint holds more than data or another
            network; if the data or the initial weights do not fit; if a value of the recipe does
            not fit the network; if Lightning refuses the precision, the devices or the time.
        KeyboardInterrupt: After Ctrl-C, when checkpoint and weights are written; after a second
            one at once.
    """
    last = folder / "last.ckpt"
    ranks = devices * num_nodes
    if (started := int(os.environ.get("WORLD_SIZE", ranks))) != ranks:
        raise InputError(f"{started} processes were started for {num_nodes} x {devices} devices")
    recipe = recipe.with_absolute_paths()
    before = _recipe_before(recipe, folder, last, resume)
    if recipe.batch_size * recipe.crop_pixels > _MAX_BATCH_PIXELS:
        raise InputError(
            f"recipe: a batch_size of {recipe.batch_size} with crops of {recipe.crop_pixels:,} "
            "pixels fills any memory: take smaller ones"
        )
    if not resume:  # which reads neither
        note_inputs(*filter(None, (recipe.weights, recipe.teacher)))
    check_outputs(last, folder / "recipe.json", folder / "weights.safetensors")
    data = RunData(recipe, workers)
    global_batch = recipe.batch_size * ranks
    steps = _steps(recipe, data, global_batch)
    clock = None if recipe.seconds is None else Clock(recipe.seconds)
    module = StereoModule(recipe, steps, global_batch, clock)
    if recipe.weights is not None and not resume:
        _load_initial(module, recipe.weights)
    cuda = accelerator != "cpu" and torch.cuda.is_available()
    average = moving_average(recipe.ema, "cuda" if cuda else "cpu") if recipe.ema else None
    stop = Event()
    if resume:
        check_resumable(last, module)
    make_folder(folder)
    with locked_folder(folder, getattr(rank_zero_only, "rank", 0) == 0), _quiet_lightning():
        callbacks: list[Callback] = [LastCheckpoint(last, recipe.save_every)]
        callbacks += [StopWhenAsked(stop)]
        callbacks += [clock] if clock else []
        callbacks += [average] if average else []
        callbacks += [ProgressBar()] if progress else []
        trainer = _trainer(
            recipe,
            folder,
            steps,
            callbacks,
            max_time=max_time,
            accelerator=accelerator,
            devices=devices,
            num_nodes=num_nodes,
            sync_batchnorm=cuda and ranks > 1,
            precision=precision,
            enable_progress_bar=progress,
        )
        if trainer.is_global_zero:
            if changed := before.changes(recipe):
                rank_zero_info(f"Not an exact continuation, the recipe has changed: {changed}")
            _write_recipe(recipe, folder)
        if global_batch != recipe.lr_batch:
            rank_zero_info(
                f"Learning rate scaled by the global batch: {recipe.lr:g} x {global_batch} / "
                f"{recipe.lr_batch} = {module.lr:g}"
            )
        with sigint_sets_event(stop, partial(rank_zero_info, _STOPPING)):
            trainer.fit(module, data, ckpt_path=last if resume else None, weights_only=True)
    if average is not None:
        # Lightning does it as well, but not where a resumed run had no step left.
        average.on_train_end(trainer, module)
    done = trainer.global_step
    is_over = clock.share() == 1 if clock else done >= steps
    if trainer.is_global_zero:
        save_weights(module.net, folder / "weights.safetensors")
        if clock:
            _write_recipe(replace(recipe, steps=done), folder)
    rank_zero_info(
        f"{folder / 'weights.safetensors'}: {recipe.model} after {done} "
        + ("steps" if clock else f"of {steps} steps")
        + ("" if is_over else "; --resume goes on")
    )
    if stop.is_set() and not is_over and trainer.is_global_zero:
        raise KeyboardInterrupt
    return module


def _write_recipe(recipe: Recipe, folder: Path) -> None:
    write_text(folder / "recipe.json", recipe.to_json() + "\n")


def _recipe_before(recipe: Recipe, folder: Path, last: Path, resume: bool) -> Recipe:
    """The recipe of the run so far, ``recipe`` at its start; refuses a folder that does not fit."""
    if not resume:
        if last.exists():
            raise InputError(f"{folder} holds a run already: --resume it, or choose another folder")
        return recipe
    if not last.is_file():
        raise InputError(f"nothing to resume: {last} is not there; start without --resume")
    before = read_recipe(
        folder / "recipe.json", trusted=(recipe.model, recipe.loss)
    ).with_absolute_paths()
    if recipe.weights != before.weights:
        option = f"give --weights {before.weights}" if before.weights else "leave --weights out"
        raise InputError(
            f"{folder} started from {before.weights or 'fresh weights'}, not from "
            f"{recipe.weights or 'fresh ones'}: {option}, or choose another folder"
        )
    return before


def _trainer(
    recipe: Recipe,
    folder: Path,
    steps: int,
    callbacks: list[Callback],
    *,
    max_time: str | None,
    **options: Any,
) -> L.Trainer:
    """Lightning's trainer of a run; its own options in words of Lightning."""
    try:
        return L.Trainer(
            max_steps=steps,
            max_epochs=-1,
            val_check_interval=recipe.val_every if steps < 0 else min(recipe.val_every, steps),
            check_val_every_n_epoch=None,
            num_sanity_val_steps=0,
            log_every_n_steps=10 if steps < 0 else min(10, steps),
            use_distributed_sampler=False,
            enable_model_summary=False,
            callbacks=[*callbacks[:1], TimeLimit(max_time), *callbacks[1:]],
            logger=[
                CSVLogger(folder, "csv", flush_logs_every_n_steps=10),
                TensorBoardLogger(folder, "tensorboard"),
            ],
            plugins=[AtomicCheckpoints()],
            default_root_dir=folder,
            **options,
        )
    except (MisconfigurationException, ValueError) as error:
        raise InputError(f"Lightning refuses these settings: {error}") from None


@contextmanager
def _quiet_lightning() -> Iterator[None]:
    """Within it, Lightning neither recommends products nor warns of what we know better."""
    rank_zero = logging.getLogger("lightning.pytorch.utilities.rank_zero")
    rank_zero.addFilter(_is_no_advertisement)
    try:
        with warnings.catch_warnings():
            # It cannot know that our batches go on where the checkpoint was written.
            warnings.filterwarnings("ignore", ".*your dataloader is not resumable")
            yield
    finally:
        rank_zero.removeFilter(_is_no_advertisement)


def _is_no_advertisement(record: logging.LogRecord) -> bool:
    return "litlogger" not in record.getMessage()


def _load_initial(module: StereoModule, weights: str) -> None:
    """Start from weights; they may lack what is zero in a fresh network: it changes nothing yet."""
    # A class of the user's own is not run on the word of a file.
    own = module.recipe.model if ".py:" in module.recipe.model else None
    found = load_model(weights, model=own)
    fresh = module.net.state_dict()
    zeros = {name: value for name, value in fresh.items() if not value.any()}
    state = module.net.state_of_config(module.net.config, found.state_dict())
    try:
        module.net.load_state_dict(zeros | state)
    except RuntimeError:  # keys or shapes
        raise InputError(
            f"{weights}: does not fit the recipe's {module.recipe.model}: "
            + _misfit(found.config, module)
        ) from None


def _misfit(config: Any, module: StereoModule) -> str:
    """What weights of a network with this config need in the recipe, in words."""
    recipe, name = module.recipe, model_name(config)
    if name == "custom":
        pairs = differences(config, module.net.config).items()
        return ", ".join(f"{key} {its}, not {own}" for key, (its, own) in pairs)
    options = []
    if not is_model(config, recipe.model):
        options.append(f"--set model={name}")
    known = asdict(config).keys()
    net = {key: value for key, value in recipe.net.items() if key in known}
    given = asdict(model_config(name)) | net
    for key, (_, its) in differences(given, asdict(config)).items():
        options.append(f"--set net.{key}={its if isinstance(its, str) else json.dumps(its)}")
    return f"it holds {name}; add {' '.join(options)}"


def _steps(recipe: Recipe, data: RunData, global_batch: int) -> int:
    """Steps of a run; -1, as Lightning has it, if it ends by the clock."""
    if recipe.duration is not None:
        return -1
    if recipe.steps is not None:
        return recipe.steps
    pairs = len(data.training("cpu"))  # type: ignore[arg-type]
    assert recipe.epochs is not None
    return max(1, recipe.epochs * pairs // global_batch)
