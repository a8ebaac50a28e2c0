"""Checks of a command's values that need no heavy import, so that mistakes are told at once."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand

from mobilestereonet.errors import InputError
from mobilestereonet.settings import parse_assignments

ENGINES = ("torch", "onnxruntime", "openvino")
"""Names of the engines that run a network; a test compares them with `engines.choose`."""

RECIPES = ("procedural", "procedural-plain", "paper-sceneflow", "paper-kitti2015")
"""Names of the recipes; a test compares them with `training.recipe`."""

FORMATS = ("onnx", "openvino", "executorch", "litert", "pt2", "coreml")
"""Names of the formats of ``msnet export``; a test compares them with `export`."""

OUTPUT_ENDINGS = {"depth": (".png", ".npy", ".tif", ".tiff"), "points": (".ply", ".glb")}
"""Endings of files that depth and points are written to; a test compares them with their rooms."""

PRECISIONS = ("auto", "fp32", "bf16", "fp16")

UNITS = ("m", "mm")
"""Units of lengths in a calibration; a test compares them with `data.camera_files`."""

_DEVICE = r"auto|[a-z]+(:\d+)?|[A-Z]+(\.\d+)?"
"""Of PyTorch, such as cuda:1, or of OpenVINO, such as GPU."""

_WEIGHTS_ENDINGS = (".safetensors", ".ckpt", ".pth", ".pt", ".tar", ".bin")

_FILES = ("left", "right", "calib", "calib_left")
"""Parameters that name files to read."""

_FOLDERS = ("root", "textures")
"""Parameters that name folders to read."""


class EarlyCheck(TyperCommand):
    """Command that checks its values before it imports what it needs."""

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        """Check, then run."""
        check_values(ctx.params)
        return super().invoke(ctx)


def check_values(values: Mapping[str, Any]) -> None:
    """Check what parameters of commands have in common, by their names.

    Args:
        values: Values by the parameters' names.

    Raises:
        FileNotFoundError: If a file or folder to read does not exist.
        InputError: If a value is none of its parameter's, or no such model is there.
    """
    for name in _FILES:
        given = values.get(name)
        for path in given if isinstance(given, list | tuple) else [given]:
            if isinstance(path, Path) and not path.exists():
                raise FileNotFoundError(f"{path}: no such file")
    weights = values.get("weights")
    if isinstance(weights, Path) and weights.suffix in _WEIGHTS_ENDINGS and not weights.exists():
        raise FileNotFoundError(f"{weights}: no such file")
    for name in _FOLDERS:
        folder = values.get(name)
        if isinstance(folder, Path) and not folder.is_dir():
            raise FileNotFoundError(f"no folder {folder}")
    for name in ("settings", "assignments"):
        parse_assignments(values.get(name) or [])
    if not str(values.get("recipe")).endswith(".json"):
        _check_choice("--recipe", values.get("recipe"), RECIPES)
    _check_choice("format", values.get("format_"), FORMATS)
    for name, endings in OUTPUT_ENDINGS.items():
        for path in values.get(name) or ():
            if isinstance(path, Path) and path.suffix.lower() not in endings:
                verb = "are" if name == "points" else "is"
                raise InputError(f"{path}: {name} {verb} written as {', '.join(endings)}")
    if "runtime" in values:
        _check_choice("--runtime", values["runtime"], ENGINES)
        _check_choice("--precision", values.get("precision"), PRECISIONS)
    if values.get("unit") not in (None, *UNITS):
        raise InputError(f"--unit {values['unit']}: there are {', '.join(UNITS)}")
    device = values.get("device")
    if device is not None and not re.fullmatch(_DEVICE, device):
        raise InputError(f"--device {device}: write it as auto, cpu, cuda or cuda:1")
    # Training takes networks without weights.
    if "weights" in values and "model" in values and "recipe" not in values:
        models = values["model"]
        for model in models if isinstance(models, list | tuple) else [models]:
            _check_model(model, values["weights"])


def _check_choice(option: str, value: str | None, choices: Sequence[str]) -> None:
    if value is None or value in choices:
        return
    near = difflib.get_close_matches(value, choices, n=1)
    hint = f"did you mean {near[0]}? There are" if near else "there are"
    raise InputError(f"{option} {value}: {hint} {', '.join(choices)}")


def _check_model(model: str | None, weights: object) -> None:
    """Check the name of a network that must have weights, where it can be told without PyTorch."""
    if model is None:
        return
    # onnx:FILE,option=value or FILE.py:CLASS
    is_onnx = model.startswith("onnx:")
    path = model[5:].partition(",")[0] if is_onnx else model.rpartition(":")[0]
    if path:
        if not Path(path).is_file():
            raise FileNotFoundError(f"--model {model}: there is no file {path}")
        return
    if Path(model).suffix in _WEIGHTS_ENDINGS and not Path(model).is_file():
        raise FileNotFoundError(f"--model {model}: no such file")
    if weights is not None or "/" in model or Path(model).exists():
        return  # the weights tell, or it is one of the hub
    versions = [path.stem for path in (Path(__file__).parents[1] / "weights").glob("*.safetensors")]
    embedded = sorted({"sgbm", *(version.partition(".")[0] for version in versions)})
    if model not in embedded and model not in versions:
        near = difflib.get_close_matches(model, embedded, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(embedded)};"
        raise InputError(
            f"no weights of {model!r} come with the package: {hint} Networks without any, see "
            "`msnet models`, need --weights FILE"
        )
