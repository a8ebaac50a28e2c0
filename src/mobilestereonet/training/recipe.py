"""Training recipes as data: the paper's schedules, and ours for procedural scenes."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.data.synthetic import SceneConfig
from mobilestereonet.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Everything that decides a training run but the machine it runs on.

    Attributes:
        model: Name of the network, see `list_models`.
        max_disparity: Disparities 0 .. max_disparity - 1 are searched.
        data: "procedural", or the name of a data set, see `msnet evaluate --help`.
        data_options: Options of the data set's scanner, such as its split.
        val_options: The same for validation; None validates on procedural scenes.
        scenes: What procedural scenes look like, their size and seed.
        val_scenes: Procedural scenes to validate on.
        augment: Random crop and augmentation.
        batch_size: Pairs per device and step.
        epochs: Length of the run in passes over the data; None where ``steps`` says it.
        steps: Length of the run in steps; None where ``epochs`` says it.
        lr: Learning rate of Adam at a global batch (all devices) of ``lr_batch`` pairs. It grows
            in proportion to the global batch.
        lr_batch: The global batch that ``lr`` is meant for.
        schedule: Points (share of the run, factor of the learning rate), joined by lines; two
            points at one position are a jump.
        clip: Largest norm of the gradient; None does not clip.
        ema: Decay of the weights' moving average that is validated and exported; 0 has none.
        full_heads: Heads, counted from the last, that the full-resolution smooth L1 trains.
        cross_entropy: Weight of the coarse cross entropy of all heads beside the smooth L1.
        val_every: Steps between two validations.
        save_every: Steps between two checkpoints.
        zero_residuals: Start the residual branches of fresh weights at zero, see
            `StereoNet.zero_residuals`; the paper does not.
        seed: Seed of the fresh weights, the order of the data and the augmentation.
    """

    model: str = "msnet2d"
    max_disparity: int = 192
    data: str = "procedural"
    data_options: dict[str, Any] = field(default_factory=dict)
    val_options: dict[str, Any] | None = None
    scenes: SceneConfig = field(default_factory=SceneConfig)
    val_scenes: int = 16
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    batch_size: int = 8
    epochs: int | None = None
    steps: int | None = None
    lr: float = 1e-3
    lr_batch: int = 8
    schedule: tuple[tuple[float, float], ...] = ((0.0, 1.0), (1.0, 1.0))
    clip: float | None = None
    ema: float = 0.0
    full_heads: int = 4
    cross_entropy: float = 0.0
    val_every: int = 1000
    save_every: int = 250
    zero_residuals: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if (self.epochs is None) == (self.steps is None):
            raise InputError(
                f"a recipe needs either epochs or steps, got epochs={self.epochs} and "
                f"steps={self.steps}"
            )
        for name in ("batch_size", "lr", "lr_batch", "full_heads", "val_every", "save_every"):
            if getattr(self, name) <= 0:
                raise InputError(f"recipe: {name} must be positive, got {getattr(self, name)}")
        if not 0 <= self.ema < 1:
            raise InputError(f"recipe: ema must be in 0 <= ema < 1, got {self.ema}")

    def lr_factor(self, share: float) -> float:
        """Factor of the learning rate after ``share`` (0..1) of the run."""
        positions, factors = zip(*self.schedule, strict=True)
        return float(np.interp(share, positions, factors))

    def to_json(self) -> str:
        """The whole recipe as indented JSON."""
        return json.dumps(dataclasses.asdict(self), indent=2)


_PAPER_CROP = AugmentConfig(height=256, width=512)

RECIPES: dict[str, Recipe] = {
    "paper-sceneflow": Recipe(
        data="sceneflow",
        data_options={"split": "train"},
        val_options={"split": "test"},
        augment=_PAPER_CROP,
        epochs=20,
        schedule=(
            (0.0, 1.0),
            (0.5, 1.0),
            (0.5, 0.5),
            (0.6, 0.5),
            (0.6, 0.25),
            (0.7, 0.25),
            (0.7, 0.125),
            (0.8, 0.125),
            (0.8, 0.0625),
            (1.0, 0.0625),
        ),
    ),
    "paper-kitti2015": Recipe(
        data="kitti2015",
        data_options={"split": "train"},
        val_options={"split": "val"},
        augment=_PAPER_CROP,
        epochs=400,
        schedule=((0.0, 1.0), (0.5, 1.0), (0.5, 0.1), (1.0, 0.1)),
    ),
    "procedural": Recipe(
        scenes=SceneConfig(height=320, width=640),
        augment=AugmentConfig(
            height=256,
            width=512,
            scale=(-0.3, 0.4),
            vertical_shift=0.7,
            rotation=0.1,
            exposure=(0.25, 0.55),
            brightness=0.2,
            contrast=0.3,
            saturation=0.5,
            hue=0.3,
            gamma=0.4,
            view_change=0.2,
            grey=0.1,
            vignette=0.2,
            blur=1.0,
            blur_probability=0.3,
            noise=0.03,
            patch_probability=0.2,
        ),
        steps=60_000,
        schedule=((0.0, 0.01), (0.02, 1.0), (0.5, 1.0), (1.0, 0.01)),
        clip=1.0,
        ema=0.999,
        full_heads=1,
        cross_entropy=5.0,
        zero_residuals=True,
    ),
}


def get_recipe(name: str) -> Recipe:
    """A named recipe.

    Raises:
        InputError: If the name is unknown.
    """
    if name not in RECIPES:
        raise InputError(f"unknown recipe {name!r}: choose one of {', '.join(RECIPES)}")
    return RECIPES[name]


def read_recipe(path: Path) -> Recipe:
    """The recipe that a run wrote beside its checkpoints.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is no recipe.
    """
    try:
        recipe = _build(Recipe, json.loads(path.read_text()))
    except (json.JSONDecodeError, UnicodeDecodeError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a recipe: {error}") from None
    assert isinstance(recipe, Recipe)
    return recipe


def override(recipe: Recipe, assignments: list[str]) -> Recipe:
    """Change values of a recipe by assignments such as ``lr=5e-4`` or ``augment.noise=0.02``.

    Values are JSON; what is no JSON is taken as text.

    Raises:
        InputError: If an assignment has no "=", or names no field.
    """
    values = dataclasses.asdict(recipe)
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise InputError(f"{assignment!r}: an override is written key=value")
        *parents, name = key.split(".")
        target = values
        for parent in parents:
            target = target.get(parent, {})
        if name not in target and not key.startswith(("data_options.", "val_options.")):
            raise InputError(f"{key!r} is no value of a recipe: choose from {', '.join(target)}")
        try:
            target[name] = json.loads(text)
        except json.JSONDecodeError:
            target[name] = text
    rebuilt = _build(Recipe, values)
    assert isinstance(rebuilt, Recipe)
    return rebuilt


def _build(kind: Any, values: dict[str, Any]) -> Any:
    """A dataclass from plain JSON values, nested dataclasses and tuples included."""
    hints = get_type_hints(kind)
    arguments = {
        name: _build(hints[name], value)
        if dataclasses.is_dataclass(hints.get(name))
        else _tuples(value)
        for name, value in values.items()
    }
    return kind(**arguments)


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list | tuple) else value
