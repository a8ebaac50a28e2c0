"""Devices of PyTorch, by their names on the command line."""

from __future__ import annotations

import torch

from mobilestereonet.errors import InputError

AUTO = "auto"
"""Name of the fastest device that is there, and of the precision that suits it."""


def torch_device(device: str | torch.device) -> torch.device:
    """A device of PyTorch that is there.

    Args:
        device: "cpu", "cuda", "cuda:1", "mps" or another of PyTorch's; "auto" is CUDA's or Apple's
            GPU if PyTorch finds one, else the CPU.

    Raises:
        InputError: If there is no such device here.
    """
    if device == AUTO:
        accelerators = [name for name in ("cuda", "mps") if _count(name)]
        device = accelerators[0] if accelerators else "cpu"
    try:
        found = torch.device(device)
    except RuntimeError:
        found = torch.device("meta")
    if found.type == "meta":
        raise InputError(
            f"unknown device {str(device)!r}: cpu, cuda, cuda:1 and mps are such, and auto"
        )
    if found.type == "cpu":
        return torch.device("cpu")
    index, count = found.index or 0, _count(found.type)
    if index >= count:
        raise InputError(
            f"device {str(device)!r}: PyTorch finds {count or 'no'} {found.type} device here: use "
            "cpu"
        )
    return torch.device(found.type, index)


def _count(kind: str) -> int:
    """Number of devices of a type such as "cuda" that PyTorch can use."""
    if kind == "mps":
        return int(torch.backends.mps.is_available())
    module = getattr(torch, kind, None)
    return int(module.device_count()) if module and hasattr(module, "device_count") else 0
