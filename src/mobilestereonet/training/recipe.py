"""A training run as data."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from mobilestereonet import settings
from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.errors import InputError
from mobilestereonet.nets import model_config
from mobilestereonet.scenes import SceneConfig
from mobilestereonet.settings import differences
from mobilestereonet.training.optimizers import check_optimizer
from mobilestereonet.weights import is_embedded

MODEL_LOSS = "model"
"""A recipe's loss that is the network's own."""

CROSS_ENTROPY_TARGETS = ("planes", "disparity", "surfaces")

_LOCATIONS = {"root", "textures"}
"""Recipe values that locate the data; they do not change what is trained."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Complete, machine-independent configuration of a training run.

    The ``recipe.json`` of a run names files and folders by absolute paths.

    Attributes:
        model: Name of the network, see `list_models`, or a class of the user's own as
            ``my_net.py:MyNet``.
        net: Values of the network's config by name, in place of the model's, such as
            ``max_disparity``, ``cost_volume``, ``estimator`` or ``coarse_pass`` (see `NetConfig`).
        data: "procedural", or the name of a data set, see `msnet evaluate --help`.
        root: Folder of the data set; None for procedural scenes.
        textures: Folder of photographs for procedural scenes.
        weights: Weights to start from instead of fresh ones, see `load_model`; read at the start
            only, not on resumption.
        data_options: Options of the data set's scanner, such as its split.
        val_options: The same for validation; None validates on procedural scenes.
        scenes: What procedural scenes look like, their size and seed.
        val_scenes: Procedural scenes to validate on.
        augment: Random crop and augmentation.
        uses: How often each pair that was read or rendered is trained on, each time with another
            crop and augmentation.
        pool: Pairs in use at a time, held in the training device's memory, 11 bytes a pixel. On
            several devices each pair is rendered for one of them if this is a multiple of the
            global batch and ``batch_size`` one of ``uses``.
        batch_size: Pairs per device and step.
        epochs: Length of the run, in as many pairs as the data set has; None where ``steps`` or
            ``duration`` says it.
        steps: Length of the run in steps; None where ``epochs`` says it. A run with a ``duration``
            writes here how many it took: without the duration the recipe repeats it.
        duration: Length of the run by the clock, such as "90s", "12m" or "1.5h"; the schedule
            follows the time in training, which a resumed run keeps.
        optimizer: "adam", as in the paper; "muon" (see `training.muon`), which learns more from
            as many steps; "rmsprop" or "sgd".
        optimizer_options: Other arguments of the optimizer's class in `torch.optim`, or of `Muon`,
            such as ``weight_decay``.
        lr: Learning rate at a global batch (all devices) of ``lr_batch`` pairs. It grows
            in proportion to the global batch.
        lr_batch: The global batch that ``lr`` is meant for (the paper's: 8 in 2D, 4 in 3D).
        schedule: Points (share of the run, factor of the learning rate), joined by lines; two
            points at one position are a jump.
        clip: Largest norm of the gradient; None does not clip.
        ema: Decay of the weights' moving average that is validated and exported; 0 has none.
        loss: Loss against the ground truth: "model", the network's own, or a function of the
            user's own as ``my_loss.py:function``. It takes what the network gives in training
            mode, the ground truth (B, H, W) in px, and the pixels that count, (B, H, W) bool; it
            returns the mean over these pixels, a scalar.
        full_heads: Heads, counted from the last, that this loss trains; None: all of them. Needs
            a network with a cost volume, as do ``cross_entropy``, ``volume_cross_entropy`` and
            ``teacher``.
        cross_entropy: Weight of the coarse cross entropy of all heads beside the smooth L1, against
            the ground truth and against a teacher.
        cross_entropy_target: What the cross entropy wants against the ground truth: "planes", the
            two coarse planes beside the disparity in proportion; "disparity", a narrow Laplacian
            around it over all disparities between the planes, too, which leaves no fraction of a
            pixel preferred; or "surfaces", the same with more than one at edges (see
            `training.losses`). Of the last two the heads of ``full_heads`` learn at every pixel.
        val_every: Steps between two validations; a run of fewer validates after its last.
        save_every: Steps between two checkpoints.
        volume_cross_entropy: Weight of the same cross entropy taken straight from a learned cost
            volume, which reaches the features on a short way.
        teacher: Another network to learn from, where it is sure, beside or without ground truth:
            the name of embedded weights, or a weights file. It sees each pair before the changes
            of colour and sensor. None: ground truth alone.
        distil: Weight of what the teacher says, against the ground truth's 1.
        zero_residuals: Start the residual branches of fresh weights at zero, in networks that
            have such a method; the paper does not.
        frozen: Parts of the network that keep their weights and batch norm statistics, by the
            names of their modules, such as "features".
        frozen_norms: Batch norms normalise by the statistics of the weights that training starts
            from, and keep them: for fine-tuning with few pairs per step, whose own statistics vary.
        seed: Seed of the fresh weights, the order of the data and the augmentation.
    """

    model: str = "msnet2d"
    net: dict[str, Any] = field(default_factory=dict)
    data: str = "procedural"
    root: str | None = None
    textures: str | None = None
    weights: str | None = None
    data_options: dict[str, Any] = field(default_factory=dict)
    val_options: dict[str, Any] | None = None
    scenes: SceneConfig = field(default_factory=SceneConfig)
    val_scenes: int = 16
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    uses: int = 1
    pool: int = 256
    batch_size: int = 8
    epochs: int | None = None
    steps: int | None = None
    duration: str | None = None
    optimizer: str = "adam"
    optimizer_options: dict[str, Any] = field(default_factory=dict)
    lr: float = 1e-3
    lr_batch: int = 8
    schedule: tuple[tuple[float, float], ...] = ((0.0, 1.0), (1.0, 1.0))
    clip: float | None = None
    ema: float = 0.0
    loss: str = MODEL_LOSS
    full_heads: int | None = None
    cross_entropy: float = 0.0
    cross_entropy_target: str = "planes"
    val_every: int = 1000
    save_every: int = 250
    volume_cross_entropy: float = 0.0
    zero_residuals: bool = False
    teacher: str | None = None
    distil: float = 1.0
    frozen: tuple[str, ...] = ()
    frozen_norms: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.duration is not None and self.epochs is not None:
            raise InputError(
                f"a recipe needs either epochs or a duration, got epochs={self.epochs} and "
                f"duration={self.duration}: set one of them to null"
            )
        if self.duration is None and (self.epochs is None) == (self.steps is None):
            raise InputError(
                f"a recipe needs either epochs or steps, got epochs={self.epochs} and "
                f"steps={self.steps}: set one of them to null"
            )
        if self.seconds is not None and self.seconds <= 0:
            raise InputError(f"recipe: duration must be positive, got {self.duration}")
        positive = ("batch_size", "lr", "lr_batch", "full_heads", "val_every", "save_every")
        for name in (*positive, "val_scenes", "uses", "pool", "epochs", "steps", "clip", "distil"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"recipe: {name} must be positive, got {value}")
        check_optimizer(self.optimizer, self.optimizer_options)
        if self.cross_entropy_target not in CROSS_ENTROPY_TARGETS:
            raise InputError(
                f"recipe: cross_entropy_target must be {' or '.join(CROSS_ENTROPY_TARGETS)}, got "
                f"{self.cross_entropy_target!r}"
            )
        if self.cross_entropy_target != "planes" and not self.cross_entropy > 0:
            raise InputError(
                f"recipe: cross_entropy_target={self.cross_entropy_target!r} needs cross_entropy > "
                f"0, got {self.cross_entropy}: set it, such as cross_entropy=5"
            )
        if self.teacher is not None and not self.cross_entropy > 0:
            raise InputError(
                "recipe: a teacher needs cross_entropy > 0, the weight of its distribution, got "
                f"{self.cross_entropy}: set it, such as cross_entropy=5"
            )
        for name in ("cross_entropy", "volume_cross_entropy"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(f"recipe: {name} must not be negative, got {getattr(self, name)}")
        if not 0 <= self.ema < 1:
            raise InputError(f"recipe: ema must be in 0 <= ema < 1, got {self.ema}")
        if not 0 <= self.seed < 1 << 32:
            raise InputError(f"recipe: seed must be in 0 .. 2^32 - 1, got {self.seed}")
        shares = [0.0, *(share for share, _ in self.schedule), 1.0]
        if not self.schedule or any(a > b for a, b in pairwise(shares)):
            raise InputError(
                "recipe: schedule needs points (share, factor) with shares that rise in 0..1, "
                f"got {self.schedule}"
            )

    @property
    def crop_pixels(self) -> int:
        """Pixels of a view that the network is trained on; of scenes where there is no crop."""
        height = self.augment.height or self.scenes.height
        return height * (self.augment.width or self.scenes.width)

    @property
    def seconds(self) -> float | None:
        """Length of a run by the clock.

        Raises:
            InputError: If the duration cannot be read.
        """
        if self.duration is None:
            return None
        found = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", self.duration)
        if found is None:
            raise InputError(
                f"recipe: duration must be a number with s, m or h, such as 12m, got "
                f"{self.duration!r}"
            )
        return float(found[1]) * {"s": 1, "m": 60, "h": 3600}[found[2]]

    def lr_factor(self, share: float) -> float:
        """Factor of the learning rate after ``share`` (0..1) of the run."""
        positions, factors = zip(*self.schedule, strict=True)
        return float(np.interp(share, positions, factors))

    def with_absolute_paths(self) -> Recipe:
        """The same recipe, which finds its files from any folder."""
        paths = {"root": self.root, "textures": self.textures}
        by_name = {"weights": self.weights, "teacher": self.teacher}
        paths |= {key: name for key, name in by_name.items() if name and not is_embedded(name)}
        given = {key: str(Path(path).resolve()) for key, path in paths.items() if path is not None}
        for key in ("model", "loss"):
            given[key] = absolute_reference(getattr(self, key))
        return dataclasses.replace(self, **given)  # type: ignore[arg-type]

    def changes(self, now: Recipe) -> str:
        """Values in which ``now`` differs, in words; files may have moved, a clock counts steps."""
        changed = changed_values(self, now)
        return ", ".join(f"{name} {old} -> {new}" for name, (old, new) in changed.items())

    def to_json(self) -> str:
        """The whole recipe as indented JSON."""
        return json.dumps(dataclasses.asdict(self), indent=2)


def changed_values(before: Recipe, now: Recipe) -> dict[str, tuple[Any, Any]]:
    """Values in which two recipes differ; files may have moved, a clock counts steps."""
    moved = {name for name in _LOCATIONS if getattr(before, name) and getattr(now, name)}
    if before.duration is not None and now.duration is not None:
        moved.add("steps")
    changed = differences(before, now)
    return {name: pair for name, pair in changed.items() if name not in moved}


def absolute_reference(reference: str) -> str:
    """A reference such as ``my_net.py:MyNet`` with the file's whole path; other names stay."""
    file, colon, name = reference.rpartition(":")
    return f"{Path(file).resolve()}{colon}{name}" if file.endswith(".py") else reference


def override(recipe: Recipe, values: Mapping[str, Any]) -> Recipe:
    """A recipe with other values.

    Args:
        recipe: The recipe.
        values: New values by name, such as ``lr`` or ``augment.noise``.

    Raises:
        InputError: If a name is none of the recipe's, or a value has the wrong type.
    """
    model = values.get("model", recipe.model)
    return settings.override(recipe, values, "recipe", also_known=net_names({"model": model}))


def net_names(record: Any) -> list[str]:
    """Values of a recipe's network by the names that ``--set`` takes, as far as it is known."""
    with suppress(InputError, AttributeError, TypeError):
        config = model_config(record.get("model", Recipe.model))
        return [f"net.{part.name}" for part in dataclasses.fields(config)]
    return []
