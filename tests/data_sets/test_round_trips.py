"""Whatever is written is read again: any values, any shapes."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mobilestereonet.data import (
    Calibration,
    read_calibration,
    read_disparity,
    read_disparity_png,
    read_image,
    read_pfm,
    write_disparity_png,
    write_npy,
    write_pfm,
    write_png,
)
from mobilestereonet.data.calibration import write_calibration
from mobilestereonet.data.depth_files import write_depth

EXAMPLES = settings(max_examples=60, deadline=None)
SIDES = st.integers(1, 9)
MAPS = st.tuples(SIDES, SIDES)
PICTURES = st.tuples(SIDES, SIDES, st.just(3))


def positive(low, high):
    return st.floats(low, high, allow_subnormal=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("round_trips")


@EXAMPLES
@given(values=arrays.arrays(np.float32, MAPS | PICTURES))
def test_pfm(folder, values):
    write_pfm(folder / "a.pfm", values)
    again = read_pfm(folder / "a.pfm")
    assert again.dtype == np.float32
    np.testing.assert_array_equal(again, values)


@EXAMPLES
@given(image=arrays.arrays(np.uint8, MAPS | PICTURES) | arrays.arrays(np.uint16, MAPS | PICTURES))
def test_png(folder, image):
    write_png(folder / "a.png", image)
    again = read_image(folder / "a.png")
    assert again.dtype == image.dtype
    expected = image if image.ndim == 3 else image[..., None]
    np.testing.assert_array_equal(again, np.broadcast_to(expected, again.shape))


@EXAMPLES
@given(values=arrays.arrays(np.float32, MAPS))
def test_npy(folder, values):
    write_npy(folder / "a.npy", values)
    np.testing.assert_array_equal(np.load(folder / "a.npy"), values)
    disparity, valid = read_disparity(folder / "a.npy")
    known = values[np.isfinite(values)]
    if (known < 0).sum() > (known > 0).sum():  # some sets store negative disparities
        values = -values
    np.testing.assert_array_equal(valid, np.isfinite(values) & (values > 0))
    np.testing.assert_array_equal(disparity, np.where(valid, values, 0))


@EXAMPLES
@given(
    values=arrays.arrays(
        np.float32, MAPS, elements=st.floats(-9, 250, width=32) | st.just(math.inf)
    )
)
def test_disparity_png(folder, values):
    write_disparity_png(folder / "a.png", values)
    disparity, valid = read_disparity_png(folder / "a.png")
    np.testing.assert_array_equal(valid, np.isfinite(values) & (values > 0))
    # Half a level; what rounds to 0 is written as one level, as 0 is "unknown".
    np.testing.assert_allclose(disparity[valid], values[valid].clip(1 / 256), atol=0.501 / 256)


@EXAMPLES
@given(depth=arrays.arrays(np.float32, MAPS, elements=st.floats(0, 65, width=32)))
def test_depth(folder, depth):
    for ending in (".npy", ".tiff", ".png"):
        write_depth(folder / f"a{ending}", depth)
    np.testing.assert_array_equal(np.load(folder / "a.npy"), depth)
    np.testing.assert_array_equal(cv2.imread(str(folder / "a.tiff"), -1), depth)
    metres = cv2.imread(str(folder / "a.png"), -1) / 1000
    known = depth > 0
    np.testing.assert_allclose(metres[known], depth[known].clip(0.001), atol=0.00051)
    assert not metres[~known].any()


SIZES = st.tuples(st.integers(2, 9999), st.integers(2, 9999))


@st.composite
def calibrations(draw, sizes=SIZES):
    """Calibrations of views of a size, which they tell."""
    width, height = size = draw(sizes)
    focals = positive(0.12 * width, 99 * width)
    return Calibration(
        focal=draw(focals),
        baseline=draw(positive(1.001e-3, 9.99)),
        doffs=draw(st.floats(-500, 500)),
        cx=draw(st.none() | st.floats(0, width - 1)),
        cy=draw(st.none() | st.floats(0, height - 1)),
        size=size,
        focal_y=draw(st.none() | focals),
    )


def close(read, written, size):
    """The same up to the last digits: millimetres and products are in between."""
    assert read.focal_lengths == pytest.approx(written.focal_lengths, rel=2e-6)
    assert read.baseline == pytest.approx(written.baseline, rel=1e-9)
    assert read.doffs == pytest.approx(written.doffs, abs=1e-6)
    centre = written.principal_point(*size)
    assert (read.cx, read.cy) == pytest.approx(centre, abs=1e-6)


@EXAMPLES
@given(calibration=calibrations())
def test_calibration(folder, calibration):
    size = calibration.size
    write_calibration(folder / "calib.txt", calibration, size)
    again = read_calibration(folder / "calib.txt")
    assert again.size == size
    close(again, calibration, size)


@EXAMPLES
@given(
    calibration=calibrations(st.just((640, 480))),
    ending=st.sampled_from(["yml", "xml", "json"]),
    q=st.booleans(),
)
def test_calibration_of_opencv(folder, calibration, ending, q):
    """The matrices as OpenCV's documentation defines them, in files that OpenCV writes."""
    (fx, fy), (cx, cy) = calibration.focal_lengths, calibration.principal_point(640, 480)
    left = np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1.0, 0]])
    right = left.copy()
    right[0, 2], right[0, 3] = cx + calibration.doffs, -fx * calibration.baseline
    reproject = np.zeros((4, 4))
    reproject[0, [0, 3]], reproject[1, [1, 3]], reproject[2, 3] = (
        (1, -cx),
        (fx / fy, -cy * fx / fy),
        fx,
    )
    reproject[3, 2:] = np.array([1, calibration.doffs]) / calibration.baseline
    path = folder / f"stereo.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, matrix in {"Q": reproject}.items() if q else {"P1": left, "P2": right}.items():
        storage.write(name, matrix)
    storage.release()
    close(read_calibration(path, unit="m"), calibration, (640, 480))
