"""``msnet info``."""

from __future__ import annotations

import json
import platform
import re
import sys
from importlib import metadata

from mobilestereonet import __version__
from mobilestereonet.cli.options import AsJson
from mobilestereonet.versions import packaged_versions


def info(as_json: AsJson = False) -> None:
    """Print versions and devices, as a report of a problem needs them."""
    facts = {
        "mobilestereonet": __version__,
        "weights": ", ".join(packaged_versions()),
        "Python": f"{platform.python_version()}, {platform.platform()}",
        "devices": ", ".join(_devices()),
        "OpenCV": _opencv(),
        "packages": ", ".join(_packages()),
    }
    if as_json:
        print(json.dumps(facts, indent=2))
        return
    for name, value in facts.items():
        print(f"{name}: {value}")
    owners = opencv_packages()
    if len(owners) > 1:
        print(
            f"msnet: {' and '.join(owners)} share one folder, cv2: what was installed last counts, "
            "and removing one breaks the other. Keep one: pip uninstall both, then install it",
            file=sys.stderr,
        )


def opencv_packages() -> list[str]:
    """Names of the installed packages that bring OpenCV, of which there should be one."""
    return sorted(set(metadata.packages_distributions().get("cv2", ())))


def _devices() -> list[str]:
    import torch

    gpus = [torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())]
    mps = ["mps"] if torch.backends.mps.is_available() else []
    processor = f"{platform.processor() or platform.machine()}, {torch.get_num_threads()} threads"
    return [processor, *gpus, *mps]


def _opencv() -> str:
    """OpenCV's version, and the packages that brought it."""
    try:
        import cv2

        version = cv2.__version__
    except (ImportError, AttributeError) as error:
        version = f"damaged ({error})"
    owners = ", ".join(f"{name} {metadata.version(name)}" for name in opencv_packages())
    return f"{version}, of {owners}"


def _packages() -> list[str]:
    """The installed ones of the packages that this one, or an extra of it, needs."""
    try:
        needed = metadata.requires("mobilestereonet") or []
    except metadata.PackageNotFoundError:  # a source tree that is not installed
        needed = []
    found = []
    for name in sorted({re.split(r"[^\w.-]", line)[0] for line in needed}):
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            continue
    return found
