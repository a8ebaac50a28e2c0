import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from mobilestereonet import Calibration, InputError, StereoResult
from mobilestereonet.inference.filter import MetricFilter
from mobilestereonet.inference.geometry import (
    PointCloud,
    depth_edges,
    depth_from_disparity,
    point_cloud,
)

CALIBRATION = Calibration(focal=100.0, baseline=0.5, doffs=2.0, cx=1.0, cy=0.0)


def test_depth():
    disparity = np.array([[8, 3, -2, 0.5, np.inf]], np.float32)
    valid = np.array([[True, False, True, True, True]])
    # 100 px * 0.5 m / (d + 2 px); -2 px is infinitely far, and so is nothing at infinity.
    expected = [[5, 0, 0, 20, 0]]
    np.testing.assert_allclose(depth_from_disparity(disparity, valid, CALIBRATION), expected)


def test_edges_are_both_sides_of_a_step():
    disparity = np.full((5, 6), 10, np.float32)
    disparity[2:4, 3:5] = 30
    disparity[0] = 9.5  # a slope is no edge
    valid = np.ones_like(disparity, dtype=bool)
    edges = depth_edges(disparity, valid)
    expected = np.zeros((5, 6), bool)
    expected[2:4, 2:6] = expected[1:5, 3:5] = True
    np.testing.assert_array_equal(edges, expected)
    # What is unknown, whatever its value, makes no edge.
    valid[2:4, 3:5] = False
    for value in (30, np.inf, np.nan):
        disparity[2:4, 3:5] = value
        assert not depth_edges(disparity, valid).any()


def test_points_lie_where_the_pinhole_camera_says():
    depth = np.array([[2.0, 0, 4.0], [0, 1.0, 0]], np.float32)
    colours = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    cloud = point_cloud(depth, colours, CALIBRATION)
    # x = (column - 1) z / 100, y = row z / 100.
    expected = [[-0.02, 0, 2], [0.04, 0, 4], [0, 0.01, 1]]
    np.testing.assert_allclose(cloud.points, expected, rtol=1e-6)
    np.testing.assert_array_equal(cloud.colours, [[0, 1, 2], [6, 7, 8], [12, 13, 14]])
    centred = point_cloud(depth, colours, Calibration(focal=100.0, baseline=0.5))
    np.testing.assert_allclose(centred.points[0], [-1 * 0.02, -0.5 * 0.02, 2], rtol=1e-6)
    oblong = point_cloud(depth, colours, replace(CALIBRATION, focal_y=50.0))
    np.testing.assert_allclose(oblong.points, cloud.points * [1, 2, 1], rtol=1e-6)


@pytest.fixture
def result():
    disparity = np.full((4, 8), 8, np.float32)
    disparity[:, 4:] = 48
    return StereoResult(
        left=np.full((4, 8, 3), 7, np.uint8),
        disparity=disparity,
        valid=np.ones((4, 8), bool),
        confidence=np.linspace(0, 1, 32, dtype=np.float32).reshape(4, 8),
        occluded=np.eye(4, 8, dtype=bool),
    )


def test_which_pixels_give_a_point(result):
    # Columns 3 and 4 are the edge, the diagonal is occluded; depth is 5 m and 1 m.
    assert len(result.points(CALIBRATION).points) == 32 - 2 * 4 - 3
    assert len(result.points(CALIBRATION, edges=True).points) == 32 - 4
    near = result.points(CALIBRATION, max_depth=4.0, edges=True)
    assert len(near.points) == 16
    np.testing.assert_allclose(near.points[:, 2], 1)
    sure = result.points(CALIBRATION, min_confidence=0.5, edges=True)
    assert len(sure.points) == 16 - 2  # the lower half; two of the diagonal lie in it


def test_depth_and_points_pass_one_filter(result):
    # Without limits: all but what the left-right check found.
    np.testing.assert_array_equal(result.depth(CALIBRATION) > 0, ~result.occluded)
    for limits, kept in (
        (MetricFilter(edges=False), 32 - 2 * 4 - 3),
        (MetricFilter(max_depth=4.0, edges=True), 16),
        (MetricFilter(min_confidence=0.5, edges=True), 16 - 2),
        (MetricFilter(0.5, 4.0, edges=False), 6),
    ):
        filtered = replace(result, filter=limits)
        depth = filtered.depth(CALIBRATION)
        assert np.count_nonzero(depth) == len(filtered.points(CALIBRATION).points) == kept
        assert np.isfinite(depth).all()
    with pytest.raises(InputError, match="needs a matcher with confidence=True"):
        replace(result, confidence=None, filter=MetricFilter(0.5)).depth(CALIBRATION)
    for bad in ({"min_confidence": 2}, {"max_depth": 0}, {"max_depth": np.nan}):
        with pytest.raises(InputError, match="must be"):
            MetricFilter(**bad)


def test_ply_is_read_by_another_reader(tmp_path):
    points = np.array([[0.25, -1.5, 2], [3, 4, 5.5]], np.float32)
    colours = np.array([[255, 0, 7], [1, 2, 3]], np.uint8)
    PointCloud(points, colours).save(tmp_path / "cloud.ply")
    header, _, body = (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")
    assert b"format binary_little_endian 1.0" in header
    assert b"element vertex 2\n" in header
    properties = [line.split()[1:] for line in header.splitlines() if line.startswith(b"property")]
    names = b" ".join(name for _, name in properties).decode()
    assert names.startswith("x y z red green blue")
    sizes = {b"float": "f", b"uchar": "B"}
    layout = "<" + "".join(sizes[kind] for kind, _ in properties)
    assert len(body) == 2 * struct.calcsize(layout)
    for index, row in enumerate(struct.iter_unpack(layout, body)):
        assert row[:3] == tuple(points[index])
        assert row[3:6] == tuple(colours[index])


def test_glb_is_upright(tmp_path):
    points = np.array([[0.25, -1.5, 2], [3, 4, 5.5]], np.float32)
    PointCloud(points, np.full((2, 3), 9, np.uint8)).save(tmp_path / "cloud.glb")
    content = (tmp_path / "cloud.glb").read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    (size,) = struct.unpack_from("<I", content, 12)
    document = json.loads(content[20 : 20 + size])
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0  # points
    assert "COLOR_0" in primitive["attributes"]
    accessor = document["accessors"][primitive["attributes"]["POSITION"]]
    # y up and z backward, of the same two points.
    assert accessor["count"] == 2
    np.testing.assert_allclose(accessor["min"], [0.25, -4, -5.5])
    np.testing.assert_allclose(accessor["max"], [3, 1.5, -2])


def test_refused(tmp_path):
    cloud = PointCloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    with pytest.raises(InputError, match=r"cloud\.ply: no point to write"):
        cloud.save(tmp_path / "cloud.ply")
    with pytest.raises(InputError, match=r"cloud\.obj: points are written as \.ply or \.glb"):
        cloud.save(tmp_path / "cloud.obj")
    assert not list(tmp_path.iterdir())
