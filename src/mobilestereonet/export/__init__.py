"""Export of networks to files for other runtimes; each file is run and compared first."""

from mobilestereonet.export.base import Format, Job
from mobilestereonet.export.export import FORMATS, TOLERANCE_PX, Export, export_model, find_format
from mobilestereonet.export.pairs import calibration_pairs

__all__ = [
    "FORMATS",
    "TOLERANCE_PX",
    "Export",
    "Format",
    "Job",
    "calibration_pairs",
    "export_model",
    "find_format",
]
