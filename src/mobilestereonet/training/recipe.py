"""Training recipes as data: the paper's schedules, and ours for procedural scenes."""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from types import UnionType
from typing import Any, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.errors import InputError
from mobilestereonet.scenes import SceneConfig
from mobilestereonet.weights import is_embedded

_PLACES = {"root", "textures"}
"""Values that say where the data lie, not what they are."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Everything that decides a training run but the machine it runs on.

    A run writes its files and folders with absolute paths.

    Attributes:
        model: Name of the network, see `list_models`.
        max_disparity: Disparities 0 .. max_disparity - 1 are searched.
        estimator: How the trained network estimates a disparity, see `NetConfig`; training itself
            takes the mean.
        coarse_pass: Train with a coarse pass, see `NetConfig`. Weights without one can start it.
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
        batch_size: Pairs per device and step.
        epochs: Length of the run in passes over the data; None where ``steps`` says it.
        steps: Length of the run in steps; None where ``epochs`` says it.
        optimizer: "adam", as in the paper, or "muon" (see `training.muon`), which learns more from
            as many steps.
        lr: Learning rate at a global batch (all devices) of ``lr_batch`` pairs. It grows
            in proportion to the global batch.
        lr_batch: The global batch that ``lr`` is meant for (the paper's: 8 in 2D, 4 in 3D).
        schedule: Points (share of the run, factor of the learning rate), joined by lines; two
            points at one position are a jump.
        clip: Largest norm of the gradient; None does not clip.
        ema: Decay of the weights' moving average that is validated and exported; 0 has none.
        full_heads: Heads, counted from the last, that the full-resolution smooth L1 against the
            ground truth trains.
        cross_entropy: Weight of the coarse cross entropy of all heads beside the smooth L1, against
            the ground truth and against a teacher.
        val_every: Steps between two validations; a run of fewer validates after its last.
        save_every: Steps between two checkpoints.
        volume_cross_entropy: Weight of the same cross entropy taken straight from a learned cost
            volume, which reaches the features on a short way.
        teacher: Another network to learn from, where it is sure, beside or without ground truth:
            the name of embedded weights, or a weights file. It sees each pair before the changes
            of colour and sensor. None: ground truth alone.
        distil: Weight of what the teacher says, against the ground truth's 1.
        zero_residuals: Start the residual branches of fresh weights at zero, see
            `StereoNet.zero_residuals`; the paper does not.
        seed: Seed of the fresh weights, the order of the data and the augmentation.
    """

    model: str = "msnet2d"
    max_disparity: int = 192
    estimator: str = "mean"
    coarse_pass: bool = False
    data: str = "procedural"
    root: str | None = None
    textures: str | None = None
    weights: str | None = None
    data_options: dict[str, Any] = field(default_factory=dict)
    val_options: dict[str, Any] | None = None
    scenes: SceneConfig = field(default_factory=SceneConfig)
    val_scenes: int = 16
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    batch_size: int = 8
    epochs: int | None = None
    steps: int | None = None
    optimizer: str = "adam"
    lr: float = 1e-3
    lr_batch: int = 8
    schedule: tuple[tuple[float, float], ...] = ((0.0, 1.0), (1.0, 1.0))
    clip: float | None = None
    ema: float = 0.0
    full_heads: int = 4
    cross_entropy: float = 0.0
    val_every: int = 1000
    save_every: int = 250
    volume_cross_entropy: float = 0.0
    zero_residuals: bool = False
    teacher: str | None = None
    distil: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        if (self.epochs is None) == (self.steps is None):
            raise InputError(
                f"a recipe needs either epochs or steps, got epochs={self.epochs} and "
                f"steps={self.steps}: set one of them to null"
            )
        positive = ("batch_size", "lr", "lr_batch", "full_heads", "val_every", "save_every")
        for name in (*positive, "val_scenes", "epochs", "steps", "clip", "distil"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"recipe: {name} must be positive, got {value}")
        if self.optimizer not in ("adam", "muon"):
            raise InputError(f"recipe: optimizer must be adam or muon, got {self.optimizer!r}")
        if self.estimator not in ("mean", "mode"):
            raise InputError(f"recipe: estimator must be mean or mode, got {self.estimator!r}")
        if self.teacher is not None and not self.cross_entropy > 0:
            raise InputError(
                "recipe: a teacher needs cross_entropy > 0, the weight of its distribution, got "
                f"{self.cross_entropy}: set it, such as cross_entropy=5"
            )
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

    def lr_factor(self, share: float) -> float:
        """Factor of the learning rate after ``share`` (0..1) of the run."""
        positions, factors = zip(*self.schedule, strict=True)
        return float(np.interp(share, positions, factors))

    def with_absolute_paths(self) -> Recipe:
        """The same recipe, which finds its files from any folder."""
        paths = {"root": self.root, "textures": self.textures}
        by_name = {"weights": self.weights, "teacher": self.teacher}
        paths |= {key: name for key, name in by_name.items() if name and not is_embedded(name)}
        given = {key: Path(path) for key, path in paths.items() if path is not None}
        return override(self, {key: str(path.resolve()) for key, path in given.items()})

    def changes(self, now: Recipe) -> str:
        """Values in which ``now`` differs, in words; files may have moved."""
        old, new = _values(self), _values(now)
        moved = {name for name in _PLACES if old[name] and new[name]}
        names = [name for name in new if old[name] != new[name] and name not in moved]
        return ", ".join(f"{name} {old[name]} -> {new[name]}" for name in names)

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
        estimator="mode",
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
        optimizer="muon",
        schedule=((0.0, 0.01), (0.02, 1.0), (0.5, 1.0), (1.0, 0.01)),
        clip=1.0,
        ema=0.999,
        full_heads=1,
        cross_entropy=5.0,
        volume_cross_entropy=5.0,
        zero_residuals=True,
    ),
}


def _values(config: Any, prefix: str = "") -> dict[str, Any]:
    """Values of a recipe and its parts, by the names that ``--set`` takes."""
    values: dict[str, Any] = {}
    for part in dataclasses.fields(config):
        name, value = prefix + part.name, getattr(config, part.name)
        nested = dataclasses.is_dataclass(value)
        values |= _values(value, f"{name}.") if nested else {name: value}
    return values


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
    if not path.is_file():
        raise FileNotFoundError(f"{path.parent} holds no run: there is no {path.name} in it")
    try:
        return cast(Recipe, _build(Recipe, json.loads(path.read_text("utf-8")), "recipe"))
    except (ValueError, InputError) as error:  # ValueError: no JSON, or no text at all
        raise InputError(f"{path}: not a recipe: {error}") from None


def override(recipe: Recipe, values: Mapping[str, Any]) -> Recipe:
    """A recipe with other values.

    Args:
        recipe: The recipe.
        values: New values by name, such as ``lr`` or ``augment.noise``.

    Raises:
        InputError: If a name is none of the recipe's, or a value has the wrong type.
    """
    record = dataclasses.asdict(recipe)
    for key, value in values.items():
        *parents, name = key.split(".")
        target: Any = record
        for parent in parents:
            if isinstance(target, dict) and target.get(parent) is None:
                target[parent] = {}
            target = target[parent] if isinstance(target, dict) else None
        if not isinstance(target, dict):
            raise InputError(f"recipe: there is no {key}: {parents[-1]} has no parts")
        target[name] = value
    return cast(Recipe, _build(Recipe, record, "recipe"))


def _did_you_mean(key: str, own: Iterable[str]) -> str:
    """The name most like ``key``: one of the part that it was looked for in, or of any other."""
    like = difflib.get_close_matches(key, own, n=1, cutoff=0.75)
    if not like:
        names = list(_values(get_recipe("procedural")))
        parts = [name.rpartition(".")[2] for name in names]
        near = difflib.get_close_matches(key, parts, n=1, cutoff=0.65)
        like = [name for name, part in zip(names, parts, strict=True) if part in near]
    return f" (did you mean {' or '.join(like)}?)" if like else ""


def _build(hint: Any, value: Any, name: str) -> Any:
    """A value of the hinted type from plain JSON: dataclasses and tuples, nested."""
    kind, members = get_origin(hint) or hint, get_args(hint)
    if dataclasses.is_dataclass(kind) and isinstance(value, dict):
        hints = get_type_hints(kind)
        for key in value:
            if key not in hints:
                near = _did_you_mean(key, hints)
                raise InputError(f"{name} has no value {key!r}{near}, only {', '.join(hints)}")
        parts = {key: _build(hints[key], item, key) for key, item in value.items()}
        return cast(Any, kind)(**parts)
    if kind in (UnionType, Union):
        return None if value is None else _build(members[0], value, name)
    if kind is tuple and isinstance(value, list | tuple):
        kinds = members[:1] * len(value) if members[-1] is Ellipsis else members
        if len(kinds) == len(value):
            return tuple(_build(*pair, name) for pair in zip(kinds, value, strict=True))
    elif kind is float and type(value) is int:
        return float(value)
    elif isinstance(value, kind) and (kind is bool or not isinstance(value, bool)):
        return value
    wanted = str(hint) if members else kind.__name__
    if issubclass(kind, Mapping):
        wanted = 'a JSON object such as {"name": 1}'
    elif dataclasses.is_dataclass(kind):
        names = ", ".join(part.name for part in dataclasses.fields(kind))
        wanted = f"a JSON object with some of {names}"
    raise InputError(f"{name} must be {wanted}, got {value!r}")
