"""Any stereo network in an ONNX file as an inference engine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.data.images import pad, unpad
from mobilestereonet.engines.onnx_options import (
    OnnxOptions,
    options_in_metadata,
    parse_name,
    read_options,
)
from mobilestereonet.engines.onnxruntime import find_provider, open_session
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import Prediction, Preprocessing
from mobilestereonet.weights.files import parse_fit

_CONFIDENCE = "confidence"
_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}


class OnnxFileEngine:
    """Runs an ONNX file with two views as inputs and a disparity map as output in ONNX Runtime.

    What the file expects is taken from ``model``, else from the metadata in the file
    (``metadata_props`` with names of `OnnxOptions`); `mobilestereonet.export` writes it. A file
    that says nothing of its preprocessing needs options that do: ``scale=1`` for RGB in 0..1.

    A file of fixed size takes views up to that size, which are padded to it.

    Args:
        model: "onnx:FILE" with options after commas, such as
            ``onnx:net.onnx,scale=255,mean=123.7/116.3/103.5,std=58.4/57.1/57.4,size_multiple=32``;
            ``normalise=imagenet`` stands for scale, mean and std of ImageNet in 0..1.
        threads: Threads on a CPU; None leaves them to ONNX Runtime.
        device: "cpu", "cuda", "cuda:1" ..., or "auto", see `find_provider`.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If ONNX Runtime is missing or cannot load the file, it is no such network, or
            an option is unknown, missing or wrong.

    Attributes:
        model: Name of the file without its ending.
        path: The file.
        options: What it expects.
        fixed_size: Height and width that the file takes; None if it takes any.
        has_confidence: Whether it has an output ``confidence``, as this package's exports have.
        confidence_fit: Calibration of the confidence in the file's metadata.
    """

    name = "onnxruntime"
    prefix = "onnx:"
    min_side = 1

    def __init__(
        self, model: str, *, threads: int | None = None, device: str | torch.device = "cpu"
    ) -> None:
        self.path, given = parse_name(model.removeprefix(self.prefix))
        if not self.path.is_file():
            raise FileNotFoundError(f"{self.path}: no such file")
        if threads is not None and threads < 1:
            raise InputError(f"threads must be at least 1, got {threads}")
        self.model = self.path.stem
        self.threads = threads
        self._session, self.device = _open(self.path, threads, device)
        metadata = dict(self._session.get_modelmeta().custom_metadata_map)
        self.options = read_options(self.path, options_in_metadata(metadata) | given)
        self._inputs = _views(self.path, self._session.get_inputs(), self.options)
        outputs = self._session.get_outputs()
        self._output = _disparity(self.path, outputs, self.options)
        self.has_confidence = _CONFIDENCE in [description.name for description in outputs]
        self.confidence_fit = parse_fit(metadata, str(self.path))
        shape = self._inputs[0].shape
        self._channels_last = shape[1] != 3 and shape[3] == 3
        height, width = shape[1:3] if self._channels_last else shape[2:]
        any_size = isinstance(height, str | None) or isinstance(width, str | None)
        self.fixed_size: tuple[int, int] | None = None if any_size else (height, width)
        self._type = _TYPES[self._inputs[0].type]
        half = self._type == np.float16
        self.precision = metadata.get("precision", "fp16" if half else "fp32")
        self.size_multiple = 1 if self.fixed_size else self.options.size_multiple
        self.max_disparity = self.options.max_disparity
        self.preprocessing = Preprocessing(self.options.mean, self.options.std, self.options.scale)

    def __call__(self, left: Tensor, right: Tensor, confidence: bool = False) -> Prediction:
        """Match a batch of pairs, one after the other, see `Engine`."""
        if left.shape != right.shape or left.ndim != 4 or left.shape[1] != 3:
            raise InputError(
                f"{self.path} takes two views of shape (B, 3, H, W), got "
                f"{tuple(left.shape)} and {tuple(right.shape)}"
            )
        height, width = left.shape[-2:]
        size = self._padded_size(height, width)
        views = [pad(view.float().cpu(), *size) for view in (left, right)]
        pairs = zip(*(view.split(1) for view in views), strict=True)
        wanted = [self._output.name, *([_CONFIDENCE] if confidence and self.has_confidence else [])]
        found = zip(*(self._match(left, right, wanted) for left, right in pairs), strict=True)
        disparity, *more = (unpad(torch.cat(maps), height, width) for maps in found)
        disparity = disparity * self.options.disparity_scale
        return Prediction(*(map_.to(self.device) for map_ in (disparity, *more)))

    def _padded_size(self, height: int, width: int) -> tuple[int, int]:
        if self.fixed_size is None:
            multiple = self.options.size_multiple
            width = max(width, self.options.min_width)
            return math.ceil(height / multiple) * multiple, math.ceil(width / multiple) * multiple
        if height > self.fixed_size[0] or width > self.fixed_size[1]:
            fixed = "{} x {}".format(*self.fixed_size)
            raise InputError(
                f"{self.path} takes views up to {fixed} (height x width), got {height} x {width}: "
                f"match in tiles of {fixed}, or export it with a larger or with variable size"
            )
        return self.fixed_size

    def _match(self, left: Tensor, right: Tensor, outputs: list[str]) -> list[Tensor]:
        """Outputs (1, H, W) for one pair (1, 3, H, W)."""
        feed = {
            description.name: self._array(view)
            for description, view in zip(self._inputs, (left, right), strict=True)
        }
        try:
            found = self._session.run(outputs, feed)
        except Exception as error:  # it has a class of its own for each kind of failure
            reason = str(error).strip().split("\n")[0]
            shape = "{} x {}".format(*left.shape[-2:])
            raise InputError(
                f"{self.path}: ONNX Runtime fails on views of {shape} (height x width): {reason}; "
                "does it need size_multiple=N or min_width=N?"
            ) from error
        size = tuple(left.shape[-2:])
        return [
            torch.from_numpy(self._single_map(name, map_, size).astype(np.float32))
            for name, map_ in zip(outputs, found, strict=True)
        ]

    def _single_map(self, name: str, found: NDArray[Any], size: tuple[int, ...]) -> NDArray[Any]:
        """(1, H, W) of an output (1, 1, H, W), (1, H, W), (H, W), (1, H, W, 1), or a flow's x."""
        if found.ndim == 4 and found.shape[:2] == (1, 2):
            found = found[:, :1]
        if [n for n in found.shape if n != 1] != [n for n in size if n != 1]:
            raise InputError(
                f"{self.path}: output {name!r} has the shape {found.shape}, not one map of "
                f"{size[0]} x {size[1]}: choose another by output=NAME"
            )
        return found.reshape(1, *size)

    def _array(self, view: Tensor) -> NDArray[Any]:
        if self.options.colour == "bgr":
            view = view.flip(1)
        if self._channels_last:
            view = view.permute(0, 2, 3, 1)
        array = view.contiguous().numpy()
        if self._type == np.uint8:
            array = np.clip(np.round(array), 0, 255)
        return array.astype(self._type)


def _open(path: Path, threads: int | None, device: str | torch.device) -> tuple[Any, torch.device]:
    try:
        import onnxruntime  # noqa: F401
    except ImportError:
        raise InputError(
            f'{path}: needs onnxruntime: pip install "mobilestereonet[onnx]"'
        ) from None
    target, results = find_provider(device)
    try:
        return open_session(path, target, threads), results
    except InputError:
        raise
    except Exception as error:  # it has a class of its own for each kind of failure
        reason = str(error).strip().split("\n")[0]
        raise InputError(f"{path}: ONNX Runtime cannot load it: {reason}") from error


def _views(path: Path, inputs: Sequence[Any], options: OnnxOptions) -> tuple[Any, Any]:
    """Inputs of the left and the right view."""
    names = [description.name for description in inputs]
    if len(inputs) != 2:
        raise InputError(
            f"{path} has the inputs {', '.join(names)}: two views are needed, and nothing else"
        )
    for description in inputs:
        shape = description.shape
        if description.type not in _TYPES or len(shape) != 4 or 3 not in (shape[1], shape[3]):
            raise InputError(
                f"{path}: input {description.name} is {description.type} {shape}, no batch of "
                "colour views (1, 3, height, width)"
            )
        if isinstance(shape[0], int) and shape[0] != 1:
            raise InputError(f"{path} takes {shape[0]} pairs at a time: export it for one")
    left, right = options.left or _only(names, "left"), options.right or _only(names, "right")
    if not left and not right:
        left, right = names
    left = left or next(name for name in names if name != right)
    right = right or next(name for name in names if name != left)
    if sorted((left, right)) != sorted(names):
        raise InputError(f"{path}: its inputs are {' and '.join(names)}, not {left} and {right}")
    return inputs[names.index(left)], inputs[names.index(right)]


def _only(names: Sequence[str], word: str) -> str:
    """The name that has a word in it, if one alone has."""
    alike = [name for name in names if word in name.lower()]
    return alike[0] if len(alike) == 1 else ""


def _disparity(path: Path, outputs: Sequence[Any], options: OnnxOptions) -> Any:
    """The output that is the disparity."""
    names = [description.name for description in outputs]
    wanted = [name for name in names if name == options.output]
    if not options.output:
        wanted = names if len(names) == 1 else [name for name in names if "disp" in name.lower()]
    if len(wanted) != 1:
        raise InputError(
            f"{path} has the outputs {', '.join(names)}: say which one is the disparity, such as "
            f",output={names[-1]}"
        )
    return outputs[names.index(wanted[0])]
