"""Weights files that describe themselves: safetensors with the network's name and config inside."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from mobilestereonet.atomic import write_atomically, write_text
from mobilestereonet.errors import InputError
from mobilestereonet.nets import ConfidenceFit, StereoModel, list_models, model_info, model_name
from mobilestereonet.text import parse_json, shorten

CHECKPOINT_ENDINGS = (".bin", ".ckpt", ".pt", ".pth", ".tar")
"""Endings of PyTorch's own files, which `torch.save` writes."""
COUNTER = "num_batches_tracked"
"""A buffer that only a batch norm without momentum would read, and there is none: not saved."""
CONFIDENCE_FIT = "confidence_fit"
"""Key of a file's metadata for its `ConfidenceFit`."""
_FAMILY = "msnet2d"
"""Family of weights files that do not name their network: their config tells which one it is."""


@dataclass(frozen=True)
class WeightsFile:
    """Content of a weights file, before any network is built.

    Attributes:
        source: What was read, for errors.
        state: Tensors by name.
        model: Registered name of the network, or a class reference such as "my_net.py:MyNet";
            None where the file does not tell.
        config: Values of the network's config, all or some.
        confidence_fit: Calibration of the confidence; None where the file has none.
    """

    source: str
    state: dict[str, Tensor]
    model: str | None = None
    config: dict[str, Any] = field(default_factory=dict)
    confidence_fit: ConfidenceFit | None = None


def save_weights(
    net: StereoModel,
    path: str | Path,
    *,
    card: dict[str, Any] | None = None,
    dtype: torch.dtype | None = None,
) -> None:
    """Write a network as safetensors, with its name, config and `ConfidenceFit` in the metadata.

    Args:
        net: The network, of any architecture.
        path: The ``.safetensors`` file to write, atomically.
        card: Where the weights come from and what they reach (training, data, metrics, licence),
            written beside the file as ``<name>.json``.
        dtype: Type of the learned weights, such as ``torch.float16`` for a file of half the size;
            by default each keeps its own. Statistics of batch norms always do: a variance may
            leave the range of half precision.

    Raises:
        InputError: If the file would not end in ``.safetensors``, or a weight is not finite in
            its type.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise InputError(f"{path}: a weights file must end in .safetensors")
    learned = {name for name, _ in net.named_parameters(remove_duplicate=False)}
    tensors = {}
    for name, value in net.state_dict().items():
        if name.endswith(COUNTER):
            continue
        target = dtype if dtype is not None and name in learned else value.dtype
        # Cloned: tensors that share their memory cannot be written.
        tensors[name] = value.to("cpu", target).clone(memory_format=torch.contiguous_format)
        if not tensors[name].isfinite().all():
            raise InputError(f"{path}: {name} is not finite as {target}: nothing saved")
    metadata = {"model": model_reference(net), "config": json.dumps(asdict(net.config))}
    if net.confidence_fit is not None:
        metadata[CONFIDENCE_FIT] = json.dumps(asdict(net.confidence_fit))
    if card is not None:
        write_json(path.with_suffix(".json"), card)
    write_atomically(path, lambda file: file.write_bytes(save(tensors, metadata)))


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write indented JSON, atomically."""
    write_text(path, json.dumps(content, indent=2, ensure_ascii=False) + "\n")


def model_reference(net: StereoModel) -> str:
    """What a weights file calls a network: a registered name, or a class such as "my_net.py:MyNet".

    A variant that has no name of its own is called by one of its class; its config tells the rest.
    """
    registered = list_models(imported=True)
    names = [name for name in registered if model_info(name).network is type(net)]
    exact = model_name(net.config)
    if names:
        return Path(exact if exact in names else names[0]).name  # the user's own have a folder
    return f"{Path(inspect.getfile(type(net))).name}:{type(net).__qualname__}"


def read_weights_file(path: Path) -> WeightsFile:
    """Read a ``.safetensors`` file.

    Raises:
        InputError: If the file is cut off, or its metadata are damaged.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise InputError(
            f"{path}: not a whole safetensors file ({error}); PyTorch's own files must end in one "
            f"of {', '.join(CHECKPOINT_ENDINGS)}"
        ) from error
    if not state:
        raise InputError(f"{path}: holds no tensors")
    if "config" not in metadata:
        return WeightsFile(str(path), state, metadata.get("model"))
    fit = parse_fit(metadata, str(path))
    return WeightsFile(str(path), state, *parse_config(path, metadata), confidence_fit=fit)


def parse_fit(metadata: Mapping[str, str], source: str) -> ConfidenceFit | None:
    """The calibration of the confidence in a file's metadata; None where there is none.

    Raises:
        InputError: If it is damaged.
    """
    if CONFIDENCE_FIT not in metadata:
        return None
    values = parse_json(metadata[CONFIDENCE_FIT], f"{source}: its {CONFIDENCE_FIT}")
    try:
        return ConfidenceFit(**values)
    except (InputError, TypeError) as error:
        raise InputError(
            f"{source}: its {CONFIDENCE_FIT} does not fit this version: {error}"
        ) from None


def parse_config(path: Path, record: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Network and config of a file's metadata, whose config may be JSON within JSON.

    Raises:
        InputError: If the config is no JSON object.
    """
    config = record["config"]
    if isinstance(config, str):
        config = parse_json(config, f"{path}: its network config")
    if not isinstance(config, dict):
        raise InputError(
            f"{path}: its network config is no JSON object, got {shorten(repr(config))}"
        )
    return str(record.get("model", _FAMILY)), config
