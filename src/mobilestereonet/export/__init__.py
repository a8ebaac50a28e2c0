"""Files for other runtimes and devices; each is run and compared before it is called done."""

from mobilestereonet.export.base import Format, Job
from mobilestereonet.export.export import FORMATS, TOLERANCE, Export, export_model, find_format
from mobilestereonet.export.pairs import calibration_pairs

__all__ = [
    "FORMATS",
    "TOLERANCE",
    "Export",
    "Format",
    "Job",
    "calibration_pairs",
    "export_model",
    "find_format",
]
