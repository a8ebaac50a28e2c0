"""Some steps of a network under a recipe, on batches given."""

from collections.abc import Sequence

import lightning as L
import torch
from torch.utils.data import DataLoader

from mobilestereonet import create_model
from mobilestereonet.training.module import StereoModule
from mobilestereonet.training.pool import TrainingBatch
from mobilestereonet.training.recipe import Recipe
from mobilestereonet.weights import save_weights


def fit(
    batches: Sequence[TrainingBatch],
    recipe: Recipe,
    callbacks: Sequence[L.Callback] = (),
    **options,
) -> StereoModule:
    module = StereoModule(recipe, recipe.steps, 8)
    trainer = L.Trainer(
        accelerator="cpu",
        max_epochs=1,
        callbacks=list(callbacks),
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        **options,
    )
    trainer.fit(module, DataLoader(batches, batch_size=None))
    return module


def save_teacher(path, model: str) -> None:
    """Fresh weights that search 32 disparities."""
    torch.manual_seed(1)
    save_weights(create_model(model, max_disparity=32), path)
