"""Scanners: one small class for each public data set's official folder layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args, get_type_hints

from mobilestereonet.data.scanners.base import Frame, StereoDataSet, occlusion_from_right_view
from mobilestereonet.data.scanners.driving_stereo import DrivingStereo
from mobilestereonet.data.scanners.kitti import KITTI2012, KITTI2015, VirtualKITTI2
from mobilestereonet.data.scanners.middlebury import (
    ETH3D,
    MiddEval3,
    Middlebury2014,
    Middlebury2021,
)
from mobilestereonet.data.scanners.middlebury_grey import (
    Middlebury2003,
    Middlebury2005,
    Middlebury2006,
)
from mobilestereonet.data.scanners.pair_folder import PairFolder
from mobilestereonet.data.scanners.sceneflow import SceneFlow
from mobilestereonet.data.scanners.sintel import Sintel
from mobilestereonet.errors import InputError

__all__ = [
    "ETH3D",
    "KITTI2012",
    "KITTI2015",
    "DrivingStereo",
    "Frame",
    "MiddEval3",
    "Middlebury2003",
    "Middlebury2005",
    "Middlebury2006",
    "Middlebury2014",
    "Middlebury2021",
    "PairFolder",
    "SceneFlow",
    "Sintel",
    "StereoDataSet",
    "VirtualKITTI2",
    "data_sets",
    "occlusion_from_right_view",
    "open_data_set",
]


def data_sets() -> dict[str, type[StereoDataSet]]:
    """Every data set that can be opened by name."""
    return {
        "sceneflow": SceneFlow,
        "kitti2012": KITTI2012,
        "kitti2015": KITTI2015,
        "vkitti2": VirtualKITTI2,
        "drivingstereo": DrivingStereo,
        "middlebury2003": Middlebury2003,
        "middlebury2005": Middlebury2005,
        "middlebury2006": Middlebury2006,
        "middlebury2014": Middlebury2014,
        "middlebury2021": Middlebury2021,
        "middeval3": MiddEval3,
        "eth3d": ETH3D,
        "sintel": Sintel,
        "folder": PairFolder,
    }


def open_data_set(name: str, root: str | Path, **options: Any) -> StereoDataSet:
    """Open a data set by name.

    Args:
        name: A key of `data_sets`.
        root: Folder in which the data set's archives were unpacked.
        **options: Arguments of the class, such as ``split``.

    Returns:
        The data set, scanned and checked.

    Raises:
        FileNotFoundError: If nothing is found, or a file of a frame is missing.
        InputError: If the name or an option is unknown, or an option's value of the wrong type.
    """
    known = data_sets()
    if name not in known:
        raise InputError(f"unknown data set {name!r}, choose one of {', '.join(known)}")
    hints = get_type_hints(known[name].__init__)
    del hints["root"], hints["return"]
    for option, value in options.items():
        if option not in hints:
            raise InputError(f"{name} has no option {option!r}, only {', '.join(hints)}")
        _check_type(f"{name}: {option}", value, hints[option])
    return known[name](root, **options)


def _check_type(name: str, value: Any, hint: Any) -> None:
    """Refuse what a command line may give in place of a value of the hinted type."""
    kinds = get_args(hint) or (hint,)
    if float in kinds:
        kinds += (int,)
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        wanted = "true or false" if hint is bool else getattr(hint, "__name__", hint)
        raise InputError(f"{name} must be {wanted}, got {value!r}")
