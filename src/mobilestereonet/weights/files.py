"""Weights files that describe themselves: safetensors with the network's config inside."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from mobilestereonet.atomic import write_atomically
from mobilestereonet.errors import InputError
from mobilestereonet.nets import model_config
from mobilestereonet.nets.msnet import StereoNet
from mobilestereonet.nets.msnet_config import NetConfig
from mobilestereonet.weights.authors import load_authors_checkpoint

_EMBEDDED = Path(__file__).parent
_CHECKPOINT_ENDINGS = {".ckpt", ".pt", ".pth", ".tar"}
_CONFIG = "config"
# A counter that only a batch norm without momentum would read, and there is none.
_COUNTER = "num_batches_tracked"


def save_weights(
    net: StereoNet,
    path: str | Path,
    *,
    card: dict[str, Any] | None = None,
    dtype: torch.dtype = torch.float16,
) -> None:
    """Write a network as safetensors, with its config in the metadata.

    Args:
        net: The network.
        path: The ``.safetensors`` file to write, atomically.
        card: Where the weights come from and what they reach (recipe, data, steps, measured
            figures, licence), written beside the file as ``<name>.json``.
        dtype: Type of the learned weights. Statistics of batch norms stay float32: a variance
            may leave the range of half precision.

    Raises:
        InputError: If the file would not end in ``.safetensors``, or a weight is not finite in
            ``dtype``.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise InputError(f"{path}: a weights file must end in .safetensors")
    tensors = {name: value.detach().to(dtype) for name, value in net.named_parameters()}
    tensors |= {name: value for name, value in net.named_buffers() if not name.endswith(_COUNTER)}
    for name, value in tensors.items():
        if not value.isfinite().all():
            raise InputError(f"{path}: {name} is not finite as {dtype}: nothing saved")
    tensors = {name: value.cpu().contiguous() for name, value in tensors.items()}
    metadata = {_CONFIG: json.dumps(asdict(net.config))}
    if card is not None:
        text = json.dumps(card, indent=2, ensure_ascii=False) + "\n"
        write_atomically(path.with_suffix(".json"), lambda file: file.write_text(text, "utf-8"))
    write_atomically(path, lambda file: file.write_bytes(save(tensors, metadata)))


def load_weights(path: str | Path) -> StereoNet:
    """Read a network from a weights file.

    Args:
        path: A file of `save_weights`, or a checkpoint of the authors' release (``.ckpt``,
            ``.tar``, ``.pth``, ``.pt``; see `load_authors_checkpoint`).

    Returns:
        The network in eval mode, float32.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is cut off, or not one of these.
    """
    path = Path(path)
    if path.suffix in _CHECKPOINT_ENDINGS:
        return load_authors_checkpoint(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such weights file")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise InputError(
            f"{path}: not a whole safetensors file ({error}); the authors' checkpoints must end "
            f"in one of {', '.join(sorted(_CHECKPOINT_ENDINGS))}"
        ) from error
    return _build(path, _read_config(path, metadata), state)


def _read_config(path: Path, metadata: dict[str, str]) -> NetConfig:
    if _CONFIG not in metadata:
        raise InputError(
            f"{path}: safetensors of something else: no network config in its metadata"
        )
    try:
        return NetConfig(**json.loads(metadata[_CONFIG]))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: its network config does not fit this version: {error}") from None


def _build(path: Path, config: NetConfig, state: dict[str, Tensor]) -> StereoNet:
    net = StereoNet(config).eval()
    own = net.state_dict()
    counters = {name: value for name, value in own.items() if name.endswith(_COUNTER)}
    expected = {name: value.shape for name, value in own.items() if name not in counters}
    found = {name: value.shape for name, value in state.items()}
    if found != expected:
        misfits = {name for name, _ in expected.items() ^ found.items()}
        raise InputError(
            f"{path}: {len(misfits)} tensors do not fit the network that the file describes, "
            f"such as {min(misfits)!r}"
        )
    net.load_state_dict(state | counters)
    return net


def embedded_models() -> list[str]:
    """Names of the models whose weights come with the package."""
    return sorted(path.stem for path in _EMBEDDED.glob("*.safetensors"))


def load_pretrained(name: str) -> StereoNet:
    """A model with the weights that come with the package, in eval mode, float32.

    Raises:
        InputError: If the name is unknown, or the package has no weights for it.
    """
    return load_weights(_embedded(name))


def open_weights(weights: str | Path) -> StereoNet:
    """Weights to start from: those of the package, or a file's.

    Args:
        weights: The name of a model whose weights come with the package, or a file as
            `load_weights` takes it. A name goes before a file of that name, which its absolute
            path reaches.

    Returns:
        The network in eval mode, float32.

    Raises:
        FileNotFoundError: If there are neither such embedded weights nor such a file.
        InputError: If the file is cut off, or holds no weights.
    """
    embedded = embedded_models()
    if str(weights) in embedded:
        return load_pretrained(str(weights))
    if not Path(weights).is_file():
        raise FileNotFoundError(
            f"{weights}: neither embedded weights ({', '.join(embedded)}) nor a weights file"
        )
    return load_weights(weights)


def card(name: str) -> dict[str, Any]:
    """Where the embedded weights of a model come from, and what they reach.

    Raises:
        InputError: If the name is unknown, or the package has no weights for it.
    """
    content: dict[str, Any] = json.loads(_embedded(name).with_suffix(".json").read_text("utf-8"))
    return content


def _embedded(name: str) -> Path:
    embedded = embedded_models()
    if name not in embedded:
        model_config(name)  # an unknown name has an error of its own
        raise InputError(
            f"no weights of {name!r} come with the package (of {', '.join(embedded) or 'none'}, "
            "they do): pass a weights file"
        )
    return _EMBEDDED / f"{name}.safetensors"
