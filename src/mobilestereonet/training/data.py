"""Training and validation batches of a run, from files or procedural scenes."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch.utils.data import DataLoader, Dataset, Subset

from mobilestereonet.data import open_data_set
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.data.scanners.base import StereoDataSet
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.scenes import ProceduralScenes
from mobilestereonet.scenes.textures import find_photographs
from mobilestereonet.training.batches import StepRequests, TrainingPairs, Uses
from mobilestereonet.training.pool import Delivery, PairPool
from mobilestereonet.training.recipe import Recipe

with needs_extra("train"):
    import lightning as L

_VALIDATION_SEED = 1_000_003
"""Added to the scenes' seed: validation scenes are never trained on."""


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

    def train_dataloader(self) -> DataLoader[Delivery]:
        """What the steps from the current one on take, for `on_after_batch_transfer`."""
        trainer, recipe = self.trainer, self.recipe
        assert trainer is not None
        self._pool = PairPool(recipe.augment, recipe.seed, clean=recipe.teacher is not None)
        requests = StepRequests(
            lambda: trainer.global_step,
            trainer.max_steps if trainer.max_steps > 0 else None,
            recipe.batch_size,
            Uses(recipe.uses, recipe.pool),
            trainer.global_rank,
            trainer.world_size,
        )
        return DataLoader(
            TrainingPairs(self.train_source, recipe.seed),
            sampler=requests,
            batch_size=None,
            num_workers=self.workers,
            pin_memory=self._pins,
            worker_init_fn=_ignore_sigint,
            collate_fn=_identity,
        )

    def on_after_batch_transfer(self, batch: Any, dataloader_idx: int) -> Any:
        """Make the training batch, on the training device; others stay as they are."""
        return self._pool.batch(batch) if isinstance(batch, Delivery) else batch

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
            worker_init_fn=_ignore_sigint,
            collate_fn=collate,
        )


def _ignore_sigint(worker: int) -> None:
    # A terminal sends Ctrl-C to all processes, and a run needs its readers to end its step.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _identity(batch: Any) -> Any:
    return batch
