import cv2
import numpy as np
import pytest

from mobilestereonet.data.depth_files import write_depth
from mobilestereonet.errors import InputError

DEPTH = np.array([[0, 1.2344, 65.535], [65.536, 1000, 0.0001]], np.float32)


def test_png_is_millimetres(tmp_path):
    write_depth(tmp_path / "depth.png", DEPTH)
    levels = cv2.imread(str(tmp_path / "depth.png"), cv2.IMREAD_UNCHANGED)
    assert levels.dtype == np.uint16
    # Too far for 16 bits is unknown, and 0.1 mm is not.
    np.testing.assert_array_equal(levels, [[0, 1234, 65535], [0, 0, 1]])


@pytest.mark.parametrize("ending", ["npy", "tif", "tiff", "TIFF"])
def test_float_files_are_metres(tmp_path, ending):
    path = tmp_path / f"depth.{ending}"
    write_depth(path, DEPTH)
    read = np.load(path) if ending == "npy" else cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, DEPTH)


def test_other_endings_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"depth\.exr: depth is written as \.png, \.npy"):
        write_depth(tmp_path / "depth.exr", DEPTH)
    assert not list(tmp_path.iterdir())
