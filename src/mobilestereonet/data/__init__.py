"""Stereo pairs: the sample record, files, public data sets, augmentation."""

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.calibration import read_calibration
from mobilestereonet.data.disparity_files import (
    read_disparity,
    read_disparity_pfm,
    read_disparity_png,
    write_disparity_png,
)
from mobilestereonet.data.encoded_disparities import (
    read_depth_as_disparity,
    read_disparity_exr,
    read_disparity_fsd,
    read_disparity_hdf5,
    read_disparity_sintel,
)
from mobilestereonet.data.files import read_pfm, write_npy, write_pfm, write_png
from mobilestereonet.data.image_files import read_image
from mobilestereonet.data.images import FloatMap, Mask, image_to_tensor
from mobilestereonet.data.rig import Rig
from mobilestereonet.data.sample import Calibration, StereoSample, collate
from mobilestereonet.data.scanners import (
    Frame,
    PairFolder,
    PatternDataSet,
    StereoDataSet,
    data_sets,
    occlusion_from_right_view,
    open_data_set,
    register_data_set,
)

__all__ = [
    "Calibration",
    "FloatMap",
    "Frame",
    "Mask",
    "PairFolder",
    "PatternDataSet",
    "Rig",
    "StereoDataSet",
    "StereoSample",
    "collate",
    "data_sets",
    "image_to_tensor",
    "occlusion_from_right_view",
    "open_data_set",
    "read_calibration",
    "read_depth_as_disparity",
    "read_disparity",
    "read_disparity_exr",
    "read_disparity_fsd",
    "read_disparity_hdf5",
    "read_disparity_pfm",
    "read_disparity_png",
    "read_disparity_sintel",
    "read_image",
    "read_pfm",
    "register_data_set",
    "write_atomically",
    "write_disparity_png",
    "write_npy",
    "write_pfm",
    "write_png",
]
