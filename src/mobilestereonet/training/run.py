"""A training run: data, trainer, checkpoints, logs."""

from __future__ import annotations

import logging
import os
import signal
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any, cast

import lightning as L
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_info
from torch.utils.data import DataLoader, Dataset, Subset

from mobilestereonet.atomic import make_folder, write_atomically
from mobilestereonet.data import open_data_set
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.data.scanners.base import StereoDataSet
from mobilestereonet.errors import InputError
from mobilestereonet.interruption import sigint_sets_event
from mobilestereonet.nets import is_model, model_name
from mobilestereonet.nets.msnet import StereoNet
from mobilestereonet.scenes import ProceduralScenes
from mobilestereonet.scenes.textures import find_photographs
from mobilestereonet.training.batches import PositionBatches, TrainingBatch, TrainingPairs
from mobilestereonet.training.callbacks import (
    AtomicCheckpoints,
    LastCheckpoint,
    ProgressBar,
    StopWhenAsked,
    TimeLimit,
    moving_average,
)
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.recipe import Recipe, read_recipe
from mobilestereonet.weights import load_model, save_weights

_VALIDATION_SEED = 1_000_003
"""Added to the scenes' seed: validation scenes are never trained on."""

_STOPPING = "Stopping after this step; Ctrl-C again stops at once"


class RunData(L.LightningDataModule):
    """Training and validation batches of a run.

    Args:
        recipe: The recipe.
        workers: Processes that read files or make procedural scenes; with none, scenes are made
            on the training device.

    Raises:
        FileNotFoundError: If a folder that the recipe names is not there.
        InputError: If the recipe has no root for a data set or one without need, if the data set
            or an option of it is unknown, or if ground truth or photographs are missing.
    """

    def __init__(self, recipe: Recipe, workers: int) -> None:
        super().__init__()
        self.recipe = recipe
        self.workers = workers
        self._train_files: StereoDataSet | None = None
        self._val_files: StereoDataSet | None = None
        makes_scenes = recipe.data == "procedural" or recipe.val_options is None
        if makes_scenes and recipe.textures is not None:
            find_photographs(Path(recipe.textures))
        if recipe.data == "procedural":
            if recipe.root is not None:
                raise InputError(
                    f"procedural scenes read no files, but root is {recipe.root}: choose a data "
                    "set, such as --set data=folder, or leave the root out (--set root=null)"
                )
            return
        if recipe.root is None:
            raise InputError(
                f"data set {recipe.data} needs its folder: --root DIR (in a recipe, root)"
            )
        self._train_files = self._open(recipe.root, recipe.data_options)
        if recipe.teacher is None:
            self._train_files.require_truth(otherwise="or set a teacher, which needs none")
        if recipe.val_options is not None:
            self._val_files = self._open(recipe.root, recipe.val_options)
            self._val_files.require_truth()

    def _open(self, root: str, options: dict[str, Any]) -> StereoDataSet:
        try:
            return open_data_set(self.recipe.data, Path(root), **options)
        except FileNotFoundError as error:
            if Path(root).is_dir():
                raise
            raise FileNotFoundError(f"{error}; tell where it is with --root DIR") from None

    def training(self, device: torch.device | str) -> Dataset[StereoSample]:
        """Training pairs; procedural scenes are rendered on ``device``."""
        if self._train_files is not None:
            return self._train_files
        return self._scenes(0, self.recipe.scenes.length, device)

    def validation(self, device: torch.device | str) -> Dataset[StereoSample]:
        """Validation pairs; procedural scenes are rendered on ``device``."""
        if self._val_files is not None:
            return self._val_files
        return self._scenes(_VALIDATION_SEED, self.recipe.val_scenes, device)

    def _scenes(self, offset: int, length: int, device: torch.device | str) -> ProceduralScenes:
        scenes, textures = self.recipe.scenes, self.recipe.textures
        config = replace(scenes, seed=scenes.seed + offset, length=length)
        photographs = None if textures is None else Path(textures)
        return ProceduralScenes(config, textures=photographs, device=device)

    def setup(self, stage: str) -> None:
        """Open the data; procedural scenes on the training device, or the CPU for workers."""
        assert self.trainer is not None
        # Worker processes must leave a GPU alone.
        device = torch.device("cpu") if self.workers else self.trainer.strategy.root_device
        self.train_source, self.val_source = self.training(device), self.validation(device)

    @property
    def _pins(self) -> bool:
        """Whether batches come through memory from which a GPU copies beside its work."""
        assert self.trainer is not None
        return self.workers > 0 and self.trainer.strategy.root_device.type == "cuda"

    def train_dataloader(self) -> DataLoader[TrainingBatch]:
        """Batches from the current step on."""
        trainer = self.trainer
        assert trainer is not None
        return DataLoader(
            TrainingPairs(
                self.train_source,
                self.recipe.augment,
                self.recipe.seed,
                clean=self.recipe.teacher is not None,
            ),
            batch_sampler=PositionBatches(
                lambda: trainer.global_step,
                trainer.max_steps,
                self.recipe.batch_size,
                trainer.global_rank,
                trainer.world_size,
            ),
            num_workers=self.workers,
            pin_memory=self._pins,
            worker_init_fn=_leave_ctrl_c_to_the_run,
            collate_fn=_as_it_is,
        )

    def val_dataloader(self) -> DataLoader[StereoSample]:
        """Validation pairs one by one, shared out over the ranks."""
        assert self.trainer is not None
        ranks, rank = self.trainer.world_size, self.trainer.global_rank
        pairs = len(self.val_source)  # type: ignore[arg-type]
        if pairs < ranks:
            raise InputError(f"{pairs} validation pairs are too few for {ranks} processes")
        indices = range(rank, pairs, ranks)
        return DataLoader(
            Subset(self.val_source, indices),
            num_workers=self.workers,
            pin_memory=self._pins,
            worker_init_fn=_leave_ctrl_c_to_the_run,
            collate_fn=collate,
        )


def _leave_ctrl_c_to_the_run(worker: int) -> None:
    # A terminal sends it to all processes, and a run needs its readers to end its step.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _as_it_is(batch: Any) -> Any:
    return batch


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
    ``weights.safetensors`` (averaged where the recipe has an average).

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
        InputError: If the folder holds another run, or none to resume, or one that started from
            other weights; if the data or the initial weights do not fit; if the teacher searches
            other disparities; if Lightning refuses the precision, the devices or the time.
        KeyboardInterrupt: After Ctrl-C, when checkpoint and weights are written; after a second
            one at once.
    """
    last = folder / "last.ckpt"
    if resume and not last.is_file():
        raise InputError(f"nothing to resume: {last} is not there; start without --resume")
    if not resume and last.exists():
        raise InputError(f"{folder} holds a run already: --resume it, or choose another folder")
    ranks = devices * num_nodes
    if (started := int(os.environ.get("WORLD_SIZE", ranks))) != ranks:
        raise InputError(f"{started} processes were started for {num_nodes} x {devices} devices")
    recipe = recipe.with_absolute_paths()
    before = recipe
    if resume:
        before = read_recipe(folder / "recipe.json").with_absolute_paths()
    if recipe.weights != before.weights:
        option = f"give --weights {before.weights}" if before.weights else "leave --weights out"
        raise InputError(
            f"{folder} started from {before.weights or 'fresh weights'}, not from "
            f"{recipe.weights or 'fresh ones'}: {option}, or choose another folder"
        )
    data = RunData(recipe, workers)
    global_batch = recipe.batch_size * ranks
    steps = recipe.steps or _steps(recipe, data, global_batch)
    module = StereoModule(recipe, steps, global_batch)
    if recipe.weights is not None and not resume:
        _load_initial(module, recipe.weights)
    cuda = accelerator != "cpu" and torch.cuda.is_available()
    average = moving_average(recipe.ema, "cuda" if cuda else "cpu") if recipe.ema else None
    stop = Event()
    make_folder(folder)
    # Lightning recommends a product with every run.
    rank_zero = logging.getLogger("lightning.pytorch.utilities.rank_zero")
    rank_zero.addFilter(_is_no_advertisement)
    try:
        callbacks: list[Callback] = [LastCheckpoint(last, recipe.save_every)]
        callbacks += [TimeLimit(max_time), StopWhenAsked(stop)]
        callbacks += [average] if average else []
        callbacks += [ProgressBar()] if progress else []
        trainer = L.Trainer(
            accelerator=accelerator,
            devices=devices,
            num_nodes=num_nodes,
            sync_batchnorm=cuda and ranks > 1,
            precision=precision,  # type: ignore[arg-type]
            max_steps=steps,
            max_epochs=-1,
            val_check_interval=min(recipe.val_every, steps),
            check_val_every_n_epoch=None,
            num_sanity_val_steps=0,
            log_every_n_steps=min(10, steps),
            use_distributed_sampler=False,
            enable_progress_bar=progress,
            enable_model_summary=False,
            callbacks=callbacks,
            logger=[
                CSVLogger(folder, "csv", flush_logs_every_n_steps=10),
                TensorBoardLogger(folder, "tensorboard"),
            ],
            plugins=[AtomicCheckpoints()],
            default_root_dir=folder,
        )
    except (MisconfigurationException, ValueError) as error:
        raise InputError(f"Lightning refuses these settings: {error}") from None
    if trainer.is_global_zero:
        if changed := before.changes(recipe):
            rank_zero_info(f"Not an exact continuation, the recipe has changed: {changed}")
        text = recipe.to_json() + "\n"
        write_atomically(folder / "recipe.json", lambda path: path.write_text(text, "utf-8"))
    if global_batch != recipe.lr_batch:
        rank_zero_info(
            f"Learning rate scaled by the global batch: {recipe.lr:g} x {global_batch} / "
            f"{recipe.lr_batch} = {module.lr:g}"
        )
    # Lightning cannot know that our batches go on where the checkpoint was written.
    warnings.filterwarnings("ignore", ".*your dataloader is not resumable")
    with sigint_sets_event(stop, partial(rank_zero_info, _STOPPING)):
        trainer.fit(module, data, ckpt_path=last if resume else None, weights_only=False)
    if average is not None:
        # Lightning does it as well, but not where a resumed run had no step left.
        average.on_train_end(trainer, module)
    if trainer.is_global_zero:
        save_weights(module.net, folder / "weights.safetensors", dtype=torch.float16)
    done = trainer.global_step
    rank_zero_info(
        f"{folder / 'weights.safetensors'}: {recipe.model} after {done} of {steps} steps"
        + ("" if done >= steps else "; --resume goes on")
    )
    if stop.is_set() and done < steps and trainer.is_global_zero:
        raise KeyboardInterrupt
    return module


def _is_no_advertisement(record: logging.LogRecord) -> bool:
    return "litlogger" not in record.getMessage()


def _load_initial(module: StereoModule, weights: str) -> None:
    net, model = load_model(weights), module.recipe.model
    state = net.state_dict()
    if module.recipe.coarse_pass and not net.config.coarse_pass:
        state["guide.weight"] = cast(StereoNet, module.net).guide.weight.detach()
    try:
        module.net.load_state_dict(state)
    except RuntimeError:  # keys or shapes
        found = model_name(net.config)
        coarse = net.config.coarse_pass and not module.recipe.coarse_pass
        if found != "custom" and (coarse or not is_model(net.config, model)):
            option = " --set coarse_pass=true" if coarse else ""
            reason = f"it holds {found}; add --set model={found}{option}"
        else:
            config = replace(net.config, estimator=module.net.config.estimator)
            reason = config.differences(module.net.config)
        raise InputError(f"{weights}: does not fit the recipe's {model}: {reason}") from None


def _steps(recipe: Recipe, data: RunData, global_batch: int) -> int:
    """Steps of a recipe that counts in passes over its data."""
    pairs = len(data.training("cpu"))  # type: ignore[arg-type]
    assert recipe.epochs is not None
    return max(1, recipe.epochs * pairs // global_batch)
