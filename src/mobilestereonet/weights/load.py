"""Networks by name: with the weights of the package, of a file, of a folder or of the hub."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoModel, build_model
from mobilestereonet.text import read_json
from mobilestereonet.weights.authors import from_authors
from mobilestereonet.weights.build import build_from
from mobilestereonet.weights.caffe import ENDING as CAFFE_ENDING
from mobilestereonet.weights.caffe import read_caffemodel
from mobilestereonet.weights.checkpoints import read_checkpoint
from mobilestereonet.weights.embedded import embedded_file, embedded_models, is_embedded
from mobilestereonet.weights.files import (
    CHECKPOINT_ENDINGS,
    WeightsFile,
    parse_config,
    read_weights_file,
)
from mobilestereonet.weights.hub import download
from mobilestereonet.weights.numpy_files import read_numpy_file
from mobilestereonet.weights.reversing import from_reversing

_ENDINGS = (".safetensors", CAFFE_ENDING, ".npz", *CHECKPOINT_ENDINGS)
_UNREADABLE = {
    ".index": "a TensorFlow snapshot",
    ".meta": "a TensorFlow snapshot",
    ".t7": "a Torch7 file",
    ".net": "a Torch7 file",
}
"""Endings of files that other networks are released in, and that need their old framework."""
_IN_FOLDERS = ("model.safetensors", "weights.safetensors")
"""Weights in a folder: the hub's name, and that of a training run."""


def load_model(
    name: str | Path,
    /,
    *,
    model: str | None = None,
    revision: str | None = None,
    config: Mapping[str, Any] | None = None,
    **overrides: Any,
) -> StereoModel:
    """Load a network with trained weights.

    Args:
        name: The first of these that exists:

            - embedded weights: "msnet2d", or a version such as "msnet2d.procedural-1";
            - a file: ``.safetensors`` of `save_weights`, a checkpoint of a training run
              (``last.ckpt``), a PyTorch state dict, or a public checkpoint of a registered network;
            - a folder of `save_pretrained` or of a training run;
            - "organisation/name" on the Hugging Face Hub (extra ``hub``), in the layout of
              `save_pretrained`.
        model: Name of the network, or its class such as "my_net.py:MyNet", where a file does not
            tell; otherwise a check of what it holds.
        revision: Branch, tag or commit on the hub.
        config: Values of the network's config to replace.
        **overrides: The same as keywords, such as ``estimator="mean"``.

    Returns:
        The network in eval mode, float32, on the CPU.

    Raises:
        FileNotFoundError: If there is nothing of that name.
        InputError: If a file is damaged, does not tell its network, holds another one than
            ``model``, or does not fit ``overrides``; or if the hub cannot be read.
    """
    weights = from_reversing(from_authors(_find(name, revision)))
    return build_from(weights, model, {**(config or {}), **overrides})


def create_model(name: str, /, pretrained: bool = False, **overrides: Any) -> StereoModel:
    """A registered network, with fresh weights or those of the package.

    Args:
        name: One of `list_models`; with ``pretrained`` one of `embedded_models`, or a version of
            it such as "msnet2d.procedural-1".
        pretrained: With the weights that come with the package. Others come with `load_model`.
        **overrides: Values of the network's config to change, such as ``max_disparity=256``.

    Returns:
        The network: in training mode with fresh weights, in eval mode with trained ones.

    Raises:
        InputError: If the name or a value is unknown or refused, or there are no such weights.
    """
    if not pretrained:
        return build_model(name, **overrides)
    embedded_file(name)  # nothing but what comes with the package
    return load_model(name, **overrides)


def _find(name: str | Path, revision: str | None) -> WeightsFile:
    text, path = str(name), Path(name)
    embedded = isinstance(name, str) and is_embedded(text)
    if revision is not None and (embedded or path.exists()):
        raise InputError(
            f"revision={revision!r} is of the hub, and {name} is here: leave it out"
            + (", or name a version such as " + embedded_file(text).stem if embedded else "")
        )
    if embedded:
        return replace(_read_file(embedded_file(text)), source=text)
    if path.is_dir():
        return _read_folder(path)
    if path.exists():
        return _read_file(path)
    if re.fullmatch(r"[\w-][\w.-]*/[\w-][\w.-]*", text) and path.suffix not in _ENDINGS:
        return replace(_read_folder(download(text, revision)), source=text)
    if isinstance(name, str) and path.name == text and path.suffix not in _ENDINGS:
        embedded_file(text)  # says what is wrong with the name of a network
    if path.suffix in _ENDINGS:
        raise FileNotFoundError(f"{name}: no such file")
    raise FileNotFoundError(
        f"{name}: neither embedded weights ({', '.join(embedded_models())}) nor a weights file or "
        "folder"
    )


def _read_file(path: Path) -> WeightsFile:
    if not path.is_file():  # a pipe would wait for ever
        raise InputError(f"{path} is a device or a pipe, not a weights file")
    if path.suffix in _UNREADABLE or re.search(r"\.data-\d+-of-\d+$", path.name):
        kind = _UNREADABLE.get(path.suffix, "a TensorFlow snapshot")
        raise InputError(
            f"{path}: {kind} cannot be read without that framework: load it there, and save the "
            "tensors under our names as .safetensors"
        )
    if path.suffix == CAFFE_ENDING:
        return read_caffemodel(path)
    if path.suffix == ".npz":
        return read_numpy_file(path)
    return read_checkpoint(path) if path.suffix in CHECKPOINT_ENDINGS else read_weights_file(path)


def _read_folder(folder: Path) -> WeightsFile:
    """Weights of a folder, with the network that its config.json names, or the file itself."""
    found = [folder / name for name in _IN_FOLDERS if (folder / name).is_file()]
    if not found:
        raise FileNotFoundError(f"{folder} holds no weights: no {' or '.join(_IN_FOLDERS)} in it")
    weights, file = read_weights_file(found[0]), folder / "config.json"
    if not file.is_file():
        return weights
    record = read_json(file)
    if not isinstance(record, dict) or "config" not in record:
        raise InputError(f"{file}: not of this package: it has no network config")
    model, config = parse_config(file, record)
    return replace(weights, model=model, config=config)
