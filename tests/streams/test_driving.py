"""Driving data sets: their folders, and points as their laser scanners give them."""

import cv2
import numpy as np
import pytest

from mobilestereonet import Calibration, InputError, StereoResult
from mobilestereonet.streams import MapFiles, find_pairs, match_pairs
from mobilestereonet.streams.laser import FORWARD_LEFT_UP

FOCAL, CX, CY = 700.0, 80.0, 24.0
TURNED = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0]
FROM_LASER = np.column_stack((TURNED @ FORWARD_LEFT_UP[:, :3].T, [0.01, -0.07, -0.27]))
"""From the scanner to the rectified camera 0, as ``Tr`` has it."""


def row(matrix):
    return " ".join(map(repr, np.ravel(matrix).tolist()))


def projection(x, y=0.0, z=0.0):
    """Of a camera that is at (-x, -y, -z) / focal, in camera 0's frame."""
    return np.array([[FOCAL, 0, CX, x], [0, FOCAL, CY, y], [0, 0, 1, z]])


@pytest.fixture
def odometry(tmp_path, sequence):
    """One frame of KITTI's odometry; camera 2 is not camera 0."""
    folder = tmp_path / "kitti/sequences/00"
    for camera, side in ((2, "left"), (3, "right")):
        (folder / f"image_{camera}").mkdir(parents=True)
        (sequence / side / "view_4.png").rename(folder / f"image_{camera}/000007.png")
    matrices = {2: projection(45, -0.3, 0.005), 3: projection(-339, 2.2, 0.003)}
    lines = [f"P{camera}: {row(matrix)}\n" for camera, matrix in matrices.items()]
    (folder / "calib.txt").write_text("".join(lines) + f"Tr: {row(FROM_LASER)}\n")
    return tmp_path / "kitti"


def read_points(path):
    return np.fromfile(path, "<f4").reshape(-1, 4)


def test_points_lie_where_the_scanner_would_see_them(odometry, msnet, tmp_path):
    out = tmp_path / "maps"
    write = "--write", "points.bin", "--write", "depth.npy"
    code, _, err = msnet("batch", odometry, "-o", out, *write, "--model", "sgbm")
    assert (code, err) == (0, "")
    assert sorted(path.name for path in (out / "00").iterdir()) == [
        "000007_depth.npy",
        "000007_points.bin",
    ]
    points = read_points(out / "00/000007_points.bin")
    assert (points[:, 3] == 1).all()
    # From the scanner to camera 0 and into camera 2's picture, as the data set's own paper has it.
    in_camera = np.column_stack((points[:, :3], np.ones(len(points)))) @ FROM_LASER.T
    homogeneous = np.column_stack((in_camera, np.ones(len(points))))
    u, v, depth = projection(45, -0.3, 0.005) @ homogeneous.T
    columns, rows = np.rint(u / depth).astype(int), np.rint(v / depth).astype(int)
    known = np.load(out / "00/000007_depth.npy")
    np.testing.assert_allclose(known[rows, columns], depth, rtol=1e-4)
    assert np.median(points[:, 0]) == pytest.approx(384 / 14, rel=0.05)  # forward


def test_axes_without_a_scanners_calibration(tmp_path, sequence):
    disparity = np.full((48, 160), 10, np.float32)
    result = StereoResult(np.zeros((48, 160, 3), np.uint8), disparity, disparity > 0)
    calibration = Calibration(focal=100, baseline=0.5, cx=80, cy=24)
    files = MapFiles(tmp_path, ("points.bin",))
    files.save("a", result, calibration)
    points = read_points(tmp_path / "a_points.bin").reshape(48, 160, 4)
    np.testing.assert_allclose(points[0, 0], [5, 80 / 20, 24 / 20, 1])  # ahead, left, up
    with pytest.raises(InputError, match="depth needs a calibration"):
        files.save("c", result, None)


def kitti_360(root, sequence):
    """Two frames of KITTI-360, whose scanner's calibration is of the raw camera 0."""
    for camera, side in (("00", "left"), ("01", "right")):
        folder = root / f"data_2d_raw/2013_05_28_drive_0000_sync/image_{camera}/data_rect"
        folder.mkdir(parents=True)
        for index in range(2):
            (sequence / side / f"view_{index}.png").rename(folder / f"{index:010d}.png")
    (root / "calibration").mkdir()
    rectification = cv2.Rodrigues(np.array([0.01, 0.02, -0.01]))[0]
    to_laser = np.linalg.inv(np.vstack((FROM_LASER, [0, 0, 0, 1])))
    raw = np.column_stack((to_laser[:3, :3] @ rectification, to_laser[:3, 3]))
    lines = [
        "calib_time: 25-May-2013\n",
        f"R_rect_00: {row(rectification)}\n",
        "S_rect_00: 160 48\n",
        f"P_rect_00: {row(projection(0))}\n",
        f"P_rect_01: {row(projection(-420))}\n",
    ]
    (root / "calibration/perspective.txt").write_text("".join(lines))
    (root / "calibration/calib_cam_to_velo.txt").write_text(row(raw) + "\n")
    return to_laser[:3]


def test_kitti_360(tmp_path, sequence, matcher):
    to_laser = kitti_360(tmp_path / "kitti_360", sequence)
    pairs = find_pairs(tmp_path / "kitti_360")
    drive = "2013_05_28_drive_0000_sync"
    assert [pair.name for pair in pairs] == [f"{drive}/{index:010d}" for index in range(2)]
    assert pairs[0].calibration.baseline == pytest.approx(0.6)
    assert pairs[0].calibration.size == (160, 48)
    np.testing.assert_allclose(pairs[1].to_laser, to_laser, atol=1e-12)
    files = MapFiles(tmp_path / "maps", ("points.bin",))
    assert not [status.problem for status in match_pairs(pairs, matcher, files) if status.problem]
    points = read_points(tmp_path / f"maps/{drive}/0000000001_points.bin")
    assert np.median(points[:, 0]) == pytest.approx(420 / 11 + 0.27, rel=0.05)


@pytest.mark.parametrize("text", ["1 2 3", "a b"])
def test_a_damaged_calibration_is_told(tmp_path, sequence, text):
    kitti_360(tmp_path / "kitti_360", sequence)
    (tmp_path / "kitti_360/calibration/calib_cam_to_velo.txt").write_text(text)
    with pytest.raises(InputError, match=rf"calib_cam_to_velo.txt: .*12 numbers, got '{text}'"):
        find_pairs(tmp_path / "kitti_360")
