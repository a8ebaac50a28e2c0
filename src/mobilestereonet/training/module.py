"""The training step."""

from __future__ import annotations

import math
import time
from collections import deque
from statistics import median
from typing import Any, cast

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.nn.utils import (
    convert_conv2d_weight_memory_format,
    convert_conv3d_weight_memory_format,
)

from mobilestereonet.accelerate import accelerate
from mobilestereonet.data.images import pad, to_picture, unpad
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.metrics import StereoMetrics
from mobilestereonet.nets import StereoModel, VolumeModel, build_model
from mobilestereonet.nets.model import fitting_side
from mobilestereonet.nets.operations import eval_mode
from mobilestereonet.plots import colour_disparity, error_map
from mobilestereonet.training.callbacks import Clock
from mobilestereonet.training.objective import Objective, Part
from mobilestereonet.training.optimizers import make_optimizer
from mobilestereonet.training.pool import TrainingBatch
from mobilestereonet.training.recipe import Recipe
from mobilestereonet.training.teacher import Teacher

with needs_extra("train"):
    import lightning as L
    from lightning.pytorch.loggers import TensorBoardLogger
    from lightning.pytorch.utilities import rank_zero_info


class StereoModule(L.LightningModule):
    """A network in training under a recipe.

    A step is skipped, and counted in ``train/skipped``, when no rank has a pixel to learn from or
    when the gradient's norm (and so any loss) is not finite; the running statistics of the batch
    norms are put back as they were. With fp16 these are also the steps whose gradients the scaler
    finds too large.

    Args:
        recipe: The recipe.
        steps: Length of the run in steps; not used with a clock.
        global_batch: Pairs per step over all devices; the learning rate grows with it.
        clock: Gives the share of the run that is over, where its length is a duration.
    """

    def __init__(
        self, recipe: Recipe, steps: int, global_batch: int, clock: Clock | None = None
    ) -> None:
        super().__init__()
        self.recipe = recipe
        torch.manual_seed(recipe.seed)
        self.net = build_model(recipe.model, **recipe.net)
        if recipe.zero_residuals:
            try:
                self.net.zero_residuals()
            except InputError as error:
                raise InputError(f"recipe: {error}: --set zero_residuals=false") from None
        for part in self._frozen_parts(self.net):
            part.requires_grad_(False)
        # As the accelerated form has them; a moving average is copied before that is made.
        convert_conv2d_weight_memory_format(self.net, torch.channels_last)
        convert_conv3d_weight_memory_format(self.net, torch.channels_last_3d)
        self.objective = Objective(recipe, self.net)
        self.teacher = None if recipe.teacher is None else Teacher(recipe.teacher, self.net)
        self.val_metrics = StereoMetrics(self.net.max_disparity)
        self.steps = steps
        self.clock = clock
        self.lr = recipe.lr * global_batch / recipe.lr_batch
        self.skipped: Tensor
        self.register_buffer("skipped", torch.zeros((), dtype=torch.long))
        self._saved_buffers: list[Tensor] = []
        # In a tuple, so that neither checkpoints nor the optimizer see it.
        self._accelerated: tuple[StereoModel, ...] = ()
        self._step_ended = 0.0
        self._seconds: deque[float] = deque(maxlen=20)

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """Disparity (B, H, W) of RGB views (B, 3, H, W) in 0..1 of any size, in eval mode."""
        height, width = left.shape[-2:]
        size = [fitting_side(self.net, side) for side in (height, width)]
        views = [pad(self.net.preprocessing(view), *size) for view in (left, right)]
        net = self._accelerated[0] if self._accelerated else self.net
        with eval_mode(net):
            return unpad(cast(Tensor, net(*views).disparity), height, width)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Note the precision, which the recipe does not hold."""
        checkpoint["precision"] = self.trainer.precision

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Tell where a run goes on in another precision."""
        if self._trainer is None:  # loaded without a run
            return
        now = self.trainer.precision
        if (before := checkpoint.get("precision", now)) != now:
            rank_zero_info(
                f"Not an exact continuation, the precision has changed: {before} -> {now}; "
                f"--precision {before} keeps it"
            )

    def on_fit_start(self) -> None:
        """Make the accelerated form, once the network is on its device."""
        fast = accelerate(self.net, "training").train()
        for part in self._frozen_parts(fast):
            part.eval()
        if self.recipe.frozen_norms:
            for module in fast.modules():
                if isinstance(module, _BatchNorm):
                    module.eval()
        self._accelerated = (fast,)

    def _frozen_parts(self, net: StereoModel) -> list[nn.Module]:
        parts = []
        for name in self.recipe.frozen:
            try:
                parts.append(net.get_submodule(name))
            except AttributeError:
                names = ", ".join(name for name, _ in net.named_children())
                raise InputError(
                    f"recipe: frozen names {name!r}, which {self.recipe.model} does not have; it "
                    f"has {names}"
                ) from None
        return parts

    def on_fit_end(self) -> None:
        """Let the accelerated form go."""
        self._accelerated = ()

    @property
    def accelerated(self) -> StereoModel:
        """The network in its form for training, which shares the parameters; during a fit only."""
        return self._accelerated[0]

    def on_train_start(self) -> None:
        """Start the clock."""
        self._step_ended = time.monotonic()

    def training_step(self, batch: TrainingBatch, batch_idx: int) -> Tensor:
        """Loss of one batch; its gradient, averaged over ranks, is that of the mean over pixels."""
        self._save_buffers()
        pairs = batch.augmented
        if pairs.disparity is None and self.teacher is None:
            raise InputError(
                f"{pairs.name} has no ground truth: choose another split to train on, or set a "
                "teacher"
            )
        net = self.accelerated
        net.set_step(self.global_step)
        outputs = net(net.preprocessing(pairs.left), net.preprocessing(pairs.right))
        with torch.autocast(self.device.type, enabled=False):
            parts = [self.objective.truth(net, outputs, pairs)]
            if self.teacher is not None:
                assert batch.clean is not None and isinstance(net, VolumeModel)
                parts.append(self.objective.taught(net, outputs, *self.teacher(batch.clean)))
        loss = self._mean_over_ranks(parts)
        self.log("train/loss", loss.detach())
        self.log("loss", loss.detach(), prog_bar=True, logger=False)
        self.log("train/lr", self.optimizers().param_groups[0]["lr"])  # type: ignore[union-attr]
        for name, figure in parts[0].figures.items():
            self.log(f"train/{name}", figure)
            if name == "epe":
                self.log("EPE", figure, prog_bar=True, logger=False)
        return loss

    def _mean_over_ranks(self, parts: list[Part]) -> Tensor:
        """Loss whose gradient, averaged over ranks, is that of the mean over all ranks' pixels."""
        pixels = torch.stack([part.pixels for part in parts])
        ranks = self.trainer.world_size
        if ranks > 1:
            dist.all_reduce(pixels)
        losses = torch.stack([part.total for part in parts]) * ranks / pixels.clamp_min(1)
        if self.teacher is None:
            return losses[0]
        self.log("train/teacher_loss", losses[1].detach())
        return losses[0] + self.recipe.distil * losses[1]

    def on_train_batch_end(self, outputs: Any, batch: TrainingBatch, batch_idx: int) -> None:
        """Log the speed: the median of some steps leaves checkpoints and validation out."""
        now = time.monotonic()
        self._seconds.append(now - self._step_ended)
        self._step_ended = now
        rate = len(batch.augmented.left) * self.trainer.world_size / median(self._seconds)
        self.log("train/samples_per_second", rate)
        self.log("samples/s", rate, prog_bar=True, logger=False)

    def validation_step(self, batch: StereoSample, batch_idx: int) -> None:
        """Score one batch; the first one's pictures go to TensorBoard."""
        prediction = self(batch.left, batch.right).float()
        self.val_metrics.update(prediction, batch)
        if batch_idx == 0 and self.trainer.is_global_zero:
            self._log_pictures(batch, prediction)

    def on_validation_epoch_end(self) -> None:
        """Log the figures of all validation pairs, over all ranks."""
        scores = self.val_metrics.compute()
        self.val_metrics.reset()
        self.log_dict(scores.figures("val/"), rank_zero_only=True)

    def share(self, step: int) -> float:
        """Share of the run (0..1) that is over at a step, the same in all processes."""
        if self.clock is None:
            return step / self.steps
        return float(self.trainer.strategy.broadcast(self.clock.share()))

    def configure_optimizers(self) -> Any:
        """The recipe's optimizer, its learning rate by the recipe's schedule at every step."""
        recipe = self.recipe
        optimizer = make_optimizer(
            recipe.optimizer, self.net.parameters(), self.lr, recipe.optimizer_options
        )
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: recipe.lr_factor(self.share(step))
        )
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    def configure_gradient_clipping(
        self,
        optimizer: torch.optim.Optimizer,
        gradient_clip_val: float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        """Clip the gradient, or drop it: optimizers leave parameters without a gradient alone."""
        clip = self.recipe.clip or math.inf
        norm = torch.nn.utils.clip_grad_norm_(self.net.parameters(), clip)
        self.log("train/gradient_norm", norm)
        if not (0 < norm < math.inf):
            optimizer.zero_grad(set_to_none=True)
            torch._foreach_copy_(list(self.net.buffers()), self._saved_buffers)
            self.skipped += 1
        self.log("train/skipped", self.skipped.float())

    def _save_buffers(self) -> None:
        buffers = list(self.net.buffers())
        if self._saved_buffers and self._saved_buffers[0].device == buffers[0].device:
            torch._foreach_copy_(self._saved_buffers, buffers)
        else:
            self._saved_buffers = [buffer.clone() for buffer in buffers]

    def _log_pictures(self, batch: StereoSample, prediction: Tensor) -> None:
        assert batch.disparity is not None and batch.valid is not None
        truth, valid = batch.disparity[0], batch.valid[0]
        largest = float(truth.max())
        panels = {
            "left": to_picture(batch.left[0]),
            "truth": colour_disparity(truth, largest, valid),
            "prediction": colour_disparity(prediction[0], largest),
            "error": error_map(prediction[0], truth, valid),
        }
        for logger in self.loggers:
            if isinstance(logger, TensorBoardLogger):
                for name, picture in panels.items():
                    logger.experiment.add_image(
                        f"val/{name}", picture, self.global_step, dataformats="HWC"
                    )
