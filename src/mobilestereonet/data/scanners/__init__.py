"""Scanners: one small class for each public data set's official folder layout.

A new data set is one file here: a subclass of `StereoDataSet` under `register_data_set`.
"""

from importlib import import_module
from pkgutil import iter_modules

from mobilestereonet.data.scanners.base import (
    Frame,
    NothingFoundError,
    StereoDataSet,
    occlusion_from_right_view,
)
from mobilestereonet.data.scanners.pair_folder import PairFolder
from mobilestereonet.data.scanners.patterns import PatternDataSet
from mobilestereonet.data.scanners.registry import data_sets, open_data_set, register_data_set

__all__ = [
    "Frame",
    "NothingFoundError",
    "PairFolder",
    "PatternDataSet",
    "StereoDataSet",
    "data_sets",
    "occlusion_from_right_view",
    "open_data_set",
    "register_data_set",
]

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
