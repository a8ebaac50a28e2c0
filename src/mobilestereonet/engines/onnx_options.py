"""What an ONNX file of a stereo network expects and gives, as options."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import IMAGENET


@dataclass(frozen=True)
class OnnxOptions:
    """What an ONNX file expects and gives, so far as its inputs and outputs do not show it.

    Attributes:
        scale: Factor of RGB values in 0..1, such as 255 for a file that takes 0..255.
        mean: Mean of red, green and blue after scaling, which is subtracted.
        std: Standard deviation of red, green and blue after scaling, which is divided by.
        colour: "rgb" or "bgr", the order of the input's channels.
        size_multiple: Height and width are padded to multiples of this.
        min_width: Narrower views are padded to this width in pixels.
        disparity_scale: Factor from the output to disparity in pixels: -1 for negative ones.
        max_disparity: Disparities that are searched, in pixels; what tiles overlap by.
        left: Name of the left view's input.
        right: Name of the right view's input.
        output: Name of the output that is the disparity.
    """

    scale: float = 1.0
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    colour: str = "rgb"
    size_multiple: int = 1
    min_width: int = 1
    disparity_scale: float = 1.0
    max_disparity: int = 192
    left: str = ""
    right: str = ""
    output: str = ""


def parse_name(text: str) -> tuple[Path, dict[str, str]]:
    """File and options of ``FILE,key=value,...``; the file's name may have commas."""
    file, *assignments = re.split(r",(?=[a-z_]+=)", text)
    return Path(file), dict(assignment.split("=", 1) for assignment in assignments)


def options_in_metadata(metadata: Mapping[str, str]) -> dict[str, str]:
    """Options that a file tells, in words of `OnnxOptions` or of this package's exports."""
    names = {field.name for field in fields(OnnxOptions)} - {"left", "right", "output"}
    options = {name: value for name, value in metadata.items() if name in names}
    if metadata.get("normalisation", "").startswith("inside"):
        # Scale, mean and std say what the graph does.
        options = {"scale": "1", "size_multiple": metadata["size_multiple"]}
        options["min_width"] = metadata["smallest_width"]
        options["max_disparity"] = str(int(metadata["disparity_range"].split("..")[1]) + 1)
    return options


def read_options(path: Path, texts: Mapping[str, str]) -> OnnxOptions:
    """Options from texts by their names.

    Raises:
        InputError: If one is unknown or wrong, or none says how the views are preprocessed.
    """
    options = OnnxOptions()
    texts = dict(texts)
    preset = texts.pop("normalise", None)
    if preset == "imagenet":
        options = replace(options, mean=IMAGENET.mean, std=IMAGENET.std)
    elif preset is not None:
        raise InputError(f"{path}: normalise must be imagenet, got {preset!r}")
    elif not texts.keys() & {"scale", "mean", "std"}:
        raise InputError(
            f"{path} does not say how it takes the views: add the options, such as ,scale=1 (RGB "
            "in 0..1), ,scale=255 (0..255) or ,normalise=imagenet"
        )
    names = [field.name for field in fields(OnnxOptions)]
    for name, text in texts.items():
        if name not in names:
            known = ", ".join([*names, "normalise"])
            raise InputError(f"{path}: unknown option {name!r}: there are {known}")
        default = getattr(options, name)
        try:
            value: Any = _triple(text) if isinstance(default, tuple) else type(default)(text)
        except ValueError:
            raise InputError(f"{path}: {name} cannot be {text!r}") from None
        options = replace(options, **{name: value})
    if options.colour not in ("rgb", "bgr"):
        raise InputError(f"{path}: colour must be rgb or bgr, got {options.colour!r}")
    for name in ("size_multiple", "min_width", "max_disparity"):
        if getattr(options, name) < 1:
            raise InputError(f"{path}: {name} must be at least 1, got {getattr(options, name)}")
    if 0 in options.std:
        raise InputError(f"{path}: std must not be 0, got {options.std}")
    return options


def _triple(text: str) -> tuple[float, ...]:
    """One number for all channels, or three of them, divided by slashes or commas."""
    values = tuple(float(value) for value in re.split("[/,]", text.strip("[]()")))
    if len(values) not in (1, 3):
        raise ValueError(text)
    return values * 3 if len(values) == 1 else values
