"""Checks of options that need no heavy import, so that mistakes are told at once.

An option's check is its callback: ``typer.Option(callback=one_of(PRECISIONS))``; where it knows all
names, the shell completes them. The names here are those of rooms that import PyTorch; tests
compare them.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Collection, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import typer

from mobilestereonet.atomic import note_inputs
from mobilestereonet.cli.sources import (
    RECIPES,
    network_fields,
    networks,
    recipe_fields,
    words_of_networks,
)
from mobilestereonet.errors import InputError
from mobilestereonet.settings import choice_hint, likeliest_name, parse_assignments
from mobilestereonet.versions import explain_missing, packaged_versions

ENGINES = ("torch", "onnxruntime", "openvino")
"""Engines that run a network."""

QUALITIES = ("fast", "balanced", "best")

PRECISIONS = ("auto", "fp32", "bf16", "fp16")

TRAINING_PRECISIONS = (
    *("32-true", "bf16-mixed", "16-mixed", "bf16-true", "16-true", "64-true"),
    *("32", "bf16", "16", "64", "transformer-engine", "transformer-engine-float16"),
)
"""Lightning's."""

ACCELERATORS = ("auto", "cpu", "gpu", "cuda", "mps", "tpu")
"""Lightning's."""

TABLES = ("2", "3a", "3b", "appendix2d", "appendix3d")
"""The paper's ablations."""

ABLATIONS = ("table*", "appendix*")
"""Patterns of the networks in these tables, which are many."""

FORMATS = ("onnx", "openvino", "executorch", "litert", "pt2", "coreml")
"""Formats of ``msnet export``."""

EXPORT_PRECISIONS = ("fp32", "fp16", "int8")

BENCHMARKS = ("kitti2015", "kitti2012", "middlebury", "eth3d")

BENCHMARK_SIZES = ("Q", "H", "F")

TABLE_FORMATS = ("markdown", "latex", "csv", "html")
TABLE_ENDINGS = (".md", ".tex", ".csv", ".html")
"""Tables that compare models."""

STATISTICS = ("mean", "median", "per-pixel")
"""Of such a table."""

MAP_KINDS = (
    *("disparity.png", "disparity.pfm", "disparity.npy", "picture.png"),
    *("depth.png", "depth.npy", "depth.tiff", "points.bin"),
)
"""Maps of ``msnet batch``."""

LAYOUTS = ("side-by-side", "top-bottom")
ORDERS = ("left-right", "right-left")
ROTATIONS = (0, 90, 180, 270)
"""What a user may say about the views."""

PAIR_BY = ("name", "order", "nearest")
"""Ways to pair image files."""

UNITS = ("m", "cm", "mm")
"""Units of lengths in a calibration."""

FLOAT_ENDINGS = (".npy", ".tif", ".tiff")
DEPTH_ENDINGS = (".png", *FLOAT_ENDINGS)
POINTS_ENDINGS = (".ply", ".glb")
MESH_ENDINGS = (".glb", ".obj", ".stl")
VIDEO_ENDINGS = (".mp4", ".mkv", ".mov")
BAG_ENDINGS = (".mcap", ".bag")

WEIGHTS_ENDINGS = (".safetensors", ".ckpt", ".pth", ".pt", ".tar", ".bin")

_DEVICE = r"auto|[a-z]+(:\d+)?|[A-Z]+(\.\d+)?"
"""Of PyTorch, such as cuda:1, or of OpenVINO, such as GPU."""

Callback = Callable[[typer.CallbackParam, Any], Any]


def each(
    check: Callable[[str, Any], None], complete: Callable[[], Collection[str]] | None = None
) -> Callback:
    """The callback of an option that checks each of its values.

    Args:
        check: Takes the option, such as "--device", and a value; raises an error if it is bad.
        complete: Gives the names that the shell completes.
    """

    def callback(parameter: typer.CallbackParam, values: Any) -> Any:
        name = max(parameter.opts, key=len).rstrip("_")
        for value in values if isinstance(values, list | tuple) else [values]:
            if value is not None:
                check(name, value)
        return values

    callback.complete = complete  # type: ignore[attr-defined]
    return callback


def one_of(names: Collection[str | int] | Callable[[], Collection[str]]) -> Callback:
    """Check that a value is one of some names or numbers."""

    def known() -> list[str]:
        return [str(name) for name in (names() if callable(names) else names)]

    def check(option: str, value: str | int) -> None:
        _check_name(option, str(value), known())

    return each(check, known)


def _check_name(option: str, value: str, names: Collection[str]) -> None:
    if value not in names:
        raise InputError(f"{option} {value}: {choice_hint(value, names)}")


def ends_in(endings: Sequence[str], what: str) -> Callback:
    """Check that a file to write has one of some endings; ``what``: "depth is", "videos are"."""

    def check(option: str, path: Path) -> None:
        if path.suffix.lower() not in endings:
            raise InputError(f"{path}: {what} written as {', '.join(endings)}")

    return each(check)


def matches(pattern: str, how: str) -> Callback:
    """Check that a value matches a regular expression, which ``how`` puts into words."""

    def check(option: str, value: str) -> None:
        if not re.fullmatch(pattern, value):
            raise InputError(f"{option} {value}: write it as {how}")

    return each(check)


def _check_file(option: str, path: Path) -> None:
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    note_inputs(path)


def _check_folder(option: str, path: Path) -> None:
    if not path.is_dir():
        raise FileNotFoundError(f"no folder {path}")


def _check_weights(option: str, source: Path | str) -> None:
    if Path(source).suffix in WEIGHTS_ENDINGS and not Path(source).exists():
        raise FileNotFoundError(f"{source}: no such file")
    note_inputs(source)


def check_network(option: str, name: str) -> None:
    """Check the value of an option that names a network; see `check_registered`."""
    if not _is_users_class(option, name):
        check_registered(name)


def _is_users_class(option: str, name: str) -> bool:
    """Whether a name is ``FILE.py:CLASS``; checks that there is such a file."""
    path, _, attribute = name.rpartition(":")
    if not path.endswith(".py"):
        return False
    if not attribute.isidentifier():
        raise InputError(f"{option} {name}: write it as my_net.py:MyNet")
    if not Path(path).is_file():
        raise FileNotFoundError(f"{option} {name}: there is no file {path}")
    return True


def _check_assignment(option: str, text: str) -> None:
    parse_assignments([text])


def _check_recipe_value(option: str, text: str) -> None:
    (name,) = parse_assignments([text])
    first, _, rest = name.partition(".")
    parts = recipe_fields()
    part, key = (first, rest.partition(".")[0]) if first in parts and rest else ("recipe", first)
    if key not in parts[part]:
        below = [f"{part}.{key}" for part in ("scenes", "augment") for key in parts[part]]
        known = [*parts["recipe"], *below, *(f"net.{key}" for key in network_fields())]
        raise InputError(f"{part} has no value {key!r}{likeliest_name(key, parts[part], known)}")


def check_network_values(model: str | None, names: Collection[str]) -> None:
    """Check names of values of a network's config, as far as it can be without PyTorch.

    Args:
        model: The network, or its weights; classes of the user's own are not looked into.
        names: The names.

    Raises:
        InputError: If a name is one of no network.
    """
    if model is not None and ".py:" in model:
        return
    for name in names:
        if name not in (known := network_fields()):
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.7)
            hint = f"did you mean {near[0]}?" if near else "`msnet models NAME` shows those of one"
            raise InputError(f"networks have no value {name!r}: {hint}")


def _check_recipe(option: str, recipe: str) -> None:
    if recipe.endswith(".json"):
        _check_file(option, Path(recipe))
    else:
        _check_name(option, recipe, RECIPES)


def _check_source(option: str, source: str) -> None:
    if not (Path(source).exists() or "://" in source or re.search(r"[*?[]", source)):
        raise FileNotFoundError(f"{source}: no such file or folder")
    note_inputs(source)


existing_file = each(_check_file)
existing_source = each(_check_source)
existing_folder = each(_check_folder)
weights_file = each(_check_weights)
network_name = each(check_network, networks)
recipe_name = each(_check_recipe, lambda: RECIPES)
assignment = each(_check_assignment)
recipe_value = each(_check_recipe_value)
device_name = matches(_DEVICE, "auto, cpu, cuda or cuda:1")


def check_registered(name: str) -> None:
    """Check the name of a network, as far as it can be without importing the networks.

    A name that stands nowhere in their files is none; those of the ablations are composed.

    Raises:
        InputError: If it is none.
    """
    if any(fnmatch(name, pattern) for pattern in ABLATIONS):
        return
    if name not in words_of_networks():
        near = difflib.get_close_matches(name, networks()) or ["msnet2d", "msnet3d"]
        raise InputError(
            f"unknown model {name!r}: did you mean {', '.join(near)}? `msnet models` lists all"
        )


def trained_names() -> list[str]:
    """Names of what matches without further files: weights in the package, their networks, sgbm."""
    versions = packaged_versions()
    return sorted({"sgbm", *versions, *(version.partition(".")[0] for version in versions)})


def check_trained(model: str | None, weights: Path | None, option: str = "--model") -> None:
    """Check the name of a network that must have weights, as far as it can be without PyTorch.

    Args:
        model: Value of ``--model``.
        weights: Value of ``--weights``.
        option: What messages call the first one.

    Raises:
        FileNotFoundError: If it names a file that is not there.
        InputError: If it names no network, or one without weights in the package.
    """
    if model is None or _is_users_class(option, model):
        return
    path = model.removeprefix("onnx:").partition(",")[0]  # onnx:FILE,option=value
    if model.startswith("onnx:") and not Path(path).is_file():
        raise FileNotFoundError(f"{option} {model}: there is no file {path}")
    if Path(path).suffix in WEIGHTS_ENDINGS and not Path(path).is_file():
        raise FileNotFoundError(f"{option} {model}: no such file")
    if path != model or "/" in model or Path(model).exists():
        return  # an ONNX file, or what a file, a folder or the hub holds
    if weights is not None:
        if model != "sgbm":  # which is told that it has no weights
            check_registered(model)
        return
    known = trained_names()
    if model in known:
        return
    if packaged_versions(model.partition(".")[0]):
        raise InputError(explain_missing(model))
    names = [name for name in known if "." not in name]
    near = difflib.get_close_matches(model, names, n=1)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(names)};"
    raise InputError(
        f"no weights of {model!r} come with the package: {hint} Networks without any, see "
        "`msnet models`, need --weights FILE"
    )
