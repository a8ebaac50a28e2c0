"""A training run: data, trainer, checkpoints, logs."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint, WeightAveraging
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from lightning.pytorch.plugins.io import TorchCheckpointIO
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Subset

from mobilestereonet.data import open_data_set
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.data.synthetic import ProceduralScenes
from mobilestereonet.errors import InputError
from mobilestereonet.training.batches import PositionBatches, TrainingPairs
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.recipe import Recipe
from mobilestereonet.weights import load_weights, save_weights

_VALIDATION_SEED = 1_000_003
"""Added to the scenes' seed: validation scenes are never trained on."""


class AtomicCheckpoints(TorchCheckpointIO):
    """Checkpoints that are whole or absent: written beside their place, then renamed."""

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | os.PathLike[str], storage_options: Any = None
    ) -> None:
        """Write ``checkpoint`` to ``path``."""
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(f".{target.name}.part")
        torch.save(checkpoint, temporary)
        temporary.replace(target)


class CheckpointAtEnd(L.Callback):
    """Write a checkpoint when the run ends for whatever reason, before weights are averaged."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write it."""
        trainer.save_checkpoint(self.path)


class RunData(L.LightningDataModule):
    """Training and validation batches of a run.

    Args:
        recipe: The recipe.
        root: Folder of the data set; None for procedural scenes.
        textures: Folder of photographs for procedural scenes.
        workers: Processes that read files; procedural scenes are made on the training device.
    """

    def __init__(
        self, recipe: Recipe, root: Path | None, textures: Path | None, workers: int
    ) -> None:
        super().__init__()
        self.recipe = recipe
        self.root = root
        self.textures = textures
        self.workers = 0 if recipe.data == "procedural" else workers

    def sources(
        self, device: torch.device | str
    ) -> tuple[Dataset[StereoSample], Dataset[StereoSample]]:
        """Training and validation pairs; procedural scenes are rendered on ``device``."""
        recipe = self.recipe

        def scenes(offset: int, length: int) -> ProceduralScenes:
            config = replace(recipe.scenes, seed=recipe.scenes.seed + offset, length=length)
            return ProceduralScenes(config, textures=self.textures, device=device)

        def files(options: dict[str, Any]) -> Dataset[StereoSample]:
            if self.root is None:
                raise InputError(f"data set {recipe.data} needs its folder: --root DIR")
            return open_data_set(recipe.data, self.root, **options)

        procedural = recipe.data == "procedural"
        train = scenes(0, recipe.scenes.length) if procedural else files(recipe.data_options)
        if recipe.val_options is not None and not procedural:
            return train, files(recipe.val_options)
        return train, scenes(_VALIDATION_SEED, recipe.val_scenes)

    def setup(self, stage: str) -> None:
        """Open the data for the training device."""
        assert self.trainer is not None
        self.train_source, self.val_source = self.sources(self.trainer.strategy.root_device)

    def train_dataloader(self) -> DataLoader[StereoSample]:
        """Batches from the current step on."""
        trainer = self.trainer
        assert trainer is not None
        return DataLoader(
            TrainingPairs(self.train_source, self.recipe.augment, self.recipe.seed),
            batch_sampler=PositionBatches(
                lambda: trainer.global_step,
                trainer.max_steps,
                self.recipe.batch_size,
                trainer.global_rank,
                trainer.world_size,
            ),
            num_workers=self.workers,
            collate_fn=_as_it_is,
        )

    def val_dataloader(self) -> DataLoader[StereoSample]:
        """Validation pairs one by one, shared out over the ranks."""
        assert self.trainer is not None
        ranks, rank = self.trainer.world_size, self.trainer.global_rank
        indices = range(rank, len(self.val_source), ranks)  # type: ignore[arg-type]
        return DataLoader(
            Subset(self.val_source, indices), num_workers=self.workers, collate_fn=collate
        )

    def transfer_batch_to_device(
        self, batch: StereoSample, device: torch.device, dataloader_idx: int
    ) -> StereoSample:
        """Move a batch to ``device``."""
        return batch.to(device)


def _as_it_is(batch: Any) -> Any:
    return batch


def moving_average(decay: float) -> WeightAveraging:
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

    return WeightAveraging(multi_avg_fn=update)


def train(
    recipe: Recipe,
    folder: Path,
    *,
    root: Path | None = None,
    textures: Path | None = None,
    initial: Path | None = None,
    resume: bool = False,
    max_time: str | None = None,
    precision: str = "32-true",
    accelerator: str = "auto",
    devices: int | str = 1,
    num_nodes: int = 1,
    workers: int = 0,
    progress: bool = True,
) -> StereoModule:
    """Train a network; write checkpoints, logs and the weights into ``folder``.

    ``folder`` gets ``recipe.json``, ``last.ckpt``, ``metrics.csv``, TensorBoard's events and, at
    the end of the run, ``weights.safetensors`` (averaged where the recipe has an average).

    Args:
        recipe: What to train, on what, how.
        folder: Folder of the run.
        root: Folder of the recipe's data set.
        textures: Folder of photographs for procedural scenes.
        initial: Weights to start from instead of fresh ones.
        resume: Go on from ``folder/last.ckpt``, exactly where it was written.
        max_time: Stop, with a checkpoint, after this time, written DD:HH:MM:SS.
        precision: Lightning's precision, such as "bf16-mixed".
        accelerator: Lightning's accelerator.
        devices: Devices per node.
        num_nodes: Nodes.
        workers: Processes that read files.
        progress: Show a progress bar.

    Returns:
        The module, with the averaged weights.

    Raises:
        InputError: If the folder holds another run, or none to resume.
    """
    last = folder / "last.ckpt"
    if resume and not last.is_file():
        raise InputError(f"nothing to resume: {last} is not there; start without --resume")
    if not resume and last.exists():
        raise InputError(f"{folder} holds a run already: resume it, or choose another folder")
    data = RunData(recipe, root, textures, workers)
    ranks = int(devices) * num_nodes if str(devices).isdigit() else 1
    global_batch = recipe.batch_size * ranks
    steps = recipe.steps or _steps(recipe, data, global_batch)
    module = StereoModule(recipe, steps, global_batch)
    if initial is not None:
        module.net.load_state_dict(load_weights(initial).state_dict(), strict=False)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recipe.json").write_text(recipe.to_json() + "\n")
    callbacks: list[Callback] = [
        CheckpointAtEnd(last),
        ModelCheckpoint(
            folder, "last", every_n_train_steps=recipe.save_every, enable_version_counter=False
        ),
    ]
    if recipe.ema:
        callbacks.append(moving_average(recipe.ema))
    trainer = L.Trainer(
        accelerator=accelerator,
        devices=devices,
        num_nodes=num_nodes,
        precision=precision,  # type: ignore[arg-type]
        max_steps=steps,
        max_epochs=-1,
        max_time=max_time,
        val_check_interval=recipe.val_every,
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        log_every_n_steps=10,
        use_distributed_sampler=False,
        sync_batchnorm=accelerator != "cpu" and ranks > 1,
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
    trainer.fit(module, data, ckpt_path=last if resume else None, weights_only=False)
    if trainer.is_global_zero:
        save_weights(module.net, folder / "weights.safetensors")
    return module


def _steps(recipe: Recipe, data: RunData, global_batch: int) -> int:
    """Steps of a recipe that counts in passes over its data."""
    pairs = len(data.sources("cpu")[0])  # type: ignore[arg-type]
    assert recipe.epochs is not None
    return max(1, recipe.epochs * pairs // global_batch)
