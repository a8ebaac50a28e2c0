"""The files that the pages' commands take."""

import shutil

import cv2
import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from mobilestereonet.data import Calibration, write_pfm
from mobilestereonet.data.calibration import write_calibration

HEIGHT, WIDTH = 128, 256
FOCAL, BASELINE = 340.0, 0.193


def _write_opencv(path, **matrices):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, matrix in matrices.items():
        storage.write(name, matrix)
    storage.release()


def _write_calibrations(folder):
    camera = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    left = np.hstack([camera, np.zeros((3, 1))])
    right = left - [[0, 0, 0, FOCAL * BASELINE], [0] * 4, [0] * 4]
    in_mm = left - [[0, 0, 0, 1000 * FOCAL * BASELINE], [0] * 4, [0] * 4]
    write_calibration(folder / "calib.txt", Calibration(FOCAL, BASELINE), (WIDTH, HEIGHT))
    rows = [" ".join(map(repr, matrix.ravel().tolist())) for matrix in (left, right)]
    for name, key in (
        ("calib_cam_to_cam.txt", "P_rect_0{}"),
        ("kitti_odometry/sequences/00/calib.txt", "P{}"),
    ):
        lines = (f"{key.format(2 + index)}: {row}\n" for index, row in enumerate(rows))
        (folder / name).write_text("".join(lines))
    ros = f"projection_matrix:\n  rows: 3\n  cols: 4\n  data: {right.ravel().tolist()}\n"
    (folder / "right.yaml").write_text(ros)
    _write_opencv(folder / "rectified.yml", P1=left, P2=in_mm)
    straight = {"M1": camera, "D1": np.zeros(5), "M2": camera, "D2": np.zeros(5), "R": np.eye(3)}
    _write_opencv(folder / "stereo.yml", **straight, T=np.array([-1000 * BASELINE, 0, 0]))


LAYOUTS = {
    "run/{}/00{}.png": ("left", "right"),
    "run/cam{}_{}.png": (0, 1),
    "scenes/{1}/im{0}.png": (0, 1),
    "kitti_odometry/sequences/00/image_{}/00000{}.png": (2, 3),
}
"""Names of sequences on the streams' page, and what tells the sides apart."""


def _write_sequences(folder, left, right):
    """Two frames in each layout, and as videos."""
    for layout, sides in LAYOUTS.items():
        for side, view in zip(sides, (left, right), strict=True):
            for index in range(2):
                path = folder / layout.format(side, index)
                path.parent.mkdir(parents=True, exist_ok=True)
                assert cv2.imwrite(str(path), view)
    videos = {"left": left, "right": right, "side_by_side": np.hstack([left, right])}
    for name, view in videos.items():
        code = cv2.VideoWriter.fourcc(*"mp4v")
        video = cv2.VideoWriter(str(folder / f"{name}.mp4"), code, 10, view.shape[1::-1])
        for _ in range(2):
            video.write(view)
        video.release()
    assert cv2.imwrite(str(folder / "side_by_side.png"), videos["side_by_side"])


def _write_boards(folder):
    """Pictures of a chessboard, as the page about two webcams takes them."""
    square, across, down = 12, 10, 7
    rows, columns = np.mgrid[: down * square, : across * square] // square
    board = np.where((rows + columns) % 2, 255, 0).astype(np.uint8)
    board = cv2.copyMakeBorder(board, 12, 12, 12, 12, cv2.BORDER_CONSTANT, value=255)
    camera = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    metres = 0.025 / square
    plane = np.array(
        [
            [metres, 0, -board.shape[1] / 2 * metres],
            [0, metres, -board.shape[0] / 2 * metres],
            [0, 0, 1],
        ]
    )
    for index, tilt in enumerate(np.mgrid[-0.4:0.4:3j, -0.4:0.4:3j].reshape(2, -1).T):
        turn, _ = cv2.Rodrigues(np.array([*tilt, 0.1 * tilt[0]]))
        for side, x in (("left", 0.03), ("right", -0.03)):
            pose = np.column_stack([turn[:, :2], [x, 0.01 * tilt[0], 0.55 + 0.1 * tilt[1]]])
            view = cv2.warpPerspective(
                board, camera @ pose @ plane, (WIDTH, HEIGHT), flags=cv2.INTER_AREA, borderValue=200
            )
            path = folder / f"board/{side}/{index:02}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), view)


@pytest.fixture(scope="session")
def shared_files(tmp_path_factory):
    """A small real pair under the pages' names, with calibrations and ground truth."""
    folder = tmp_path_factory.mktemp("pages")
    demo = folder / "demo"
    demo.mkdir()
    *views, truth = stereo_motorcycle()
    left, right = (
        cv2.resize(view[..., ::-1], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for view in views
    )
    for name, view in (("left", left), ("right", right)):
        (folder / "my_pairs" / name).mkdir(parents=True)
        for path in (f"{name}.png", f"raw_{name}.png", f"my_pairs/{name}/000.png"):
            assert cv2.imwrite(str(folder / path), view)
        assert cv2.imwrite(str(demo / f"{name}.png"), view)
    for name in ("calib.txt", "side_by_side.txt"):
        write_calibration(demo / name, Calibration(FOCAL, BASELINE), (WIDTH, HEIGHT))
    _write_sequences(folder, left, right)
    shutil.copy(folder / "side_by_side.mp4", demo)
    scale = WIDTH / truth.shape[1]
    small = cv2.resize(truth * scale, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    write_pfm(demo / "truth.pfm", small.astype(np.float32))
    (folder / "my_pairs" / "disparity").mkdir()
    write_pfm(folder / "my_pairs" / "disparity" / "000.pfm", small.astype(np.float32))
    _write_calibrations(folder)
    _write_boards(folder)
    return folder
