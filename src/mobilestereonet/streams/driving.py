"""Folders of driving data: KITTI's odometry, which is SemanticKITTI's, and KITTI-360."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from mobilestereonet.data.calibration import read_calibration
from mobilestereonet.data.files import read_bytes
from mobilestereonet.errors import InputError
from mobilestereonet.streams.laser import Pose
from mobilestereonet.streams.pairs import IMAGE_ENDINGS, PairFiles, joined_files, pair_folders

_NO_PAIRS = (
    "no sequences/*/image_2 or image_0 in it, as KITTI's odometry and SemanticKITTI have, nor "
    "data_2d_raw/*/image_00/data_rect, as KITTI-360 has"
)
_KITTI_360 = "data_2d_raw/*/image_{}/data_rect/*.png"


def find_pairs(
    left: str | Path, right: str | Path | None = None, pair_by: str | None = None
) -> list[PairFiles]:
    """Find the pairs of two folders, of a driving data set, or of files with both views each.

    Args:
        left: Folder of left views, or a pattern such as ``run/cam0/*.png``. Without ``right``, the
            folder of KITTI's odometry or SemanticKITTI, which holds ``sequences/00/image_2`` and
            so on, or that of KITTI-360, which holds ``data_2d_raw`` and ``calibration``; or a
            folder or a pattern of pictures with both views side by side, or MPO files.
        right: Folder of right views whose files have the same names, or a pattern whose wildcards
            stand for the same as in ``left``.
        pair_by: How two folders are paired, see `pair_folders`.

    Returns:
        The pairs in the order of their names, in which 10 comes after 9.

    Raises:
        FileNotFoundError: If a folder or a view does not exist.
        InputError: If a view has no partner, two have one name, or the folders do not tell which
            images are meant.
    """
    if right is not None:
        return pair_folders(left, right, pair_by)
    root = Path(left)
    if any(root.glob(_KITTI_360.format("00"))):
        return _kitti_360(root)
    if (root / "sequences").is_dir():
        return _kitti_odometry(root)
    if root.is_dir() and not any(file.suffix.lower() in IMAGE_ENDINGS for file in root.iterdir()):
        raise InputError(
            f"{root}: {_NO_PAIRS}; give two folders or patterns, the left views and the right "
            "ones, or a folder of pictures that have both"
        )
    return joined_files(left)


def _kitti_odometry(root: Path) -> list[PairFiles]:
    sequences = root / "sequences"
    cameras = next((c for c in ((2, 3), (0, 1)) if any(sequences.glob(f"*/image_{c[0]}"))), None)
    if cameras is None:
        raise InputError(f"{root}: {_NO_PAIRS}")
    left, right = (f"{sequences}/*/image_{camera}/*.png" for camera in cameras)
    known = {
        file.parent.name: (read_calibration(file, cameras), _odometry_pose(file, cameras[0]))
        for file in sequences.glob("*/calib.txt")
    }
    pairs = []
    for pair in pair_folders(left, right):
        sequence, _, frame = pair.name.split("/")
        calibration, pose = known.get(sequence, (None, None))
        name = f"{sequence}/{frame}"
        pairs.append(replace(pair, name=name, calibration=calibration, to_laser=pose))
    return pairs


def _odometry_pose(file: Path, camera: int) -> Pose | None:
    """From a rectified camera's frame to the scanner's; None if the file has no ``Tr``."""
    from_laser = _matrix(file, "Tr", 4)
    projection = _matrix(file, f"P{camera}", 4)
    if from_laser is None or projection is None:
        return None
    # P = K [1 | t], where t leads from camera 0 to this one, and Tr leads from the laser to 0.
    offset = np.linalg.solve(projection[:, :3], projection[:, 3])
    rotation = np.linalg.inv(from_laser[:, :3])
    return np.column_stack((rotation, -rotation @ (from_laser[:, 3] + offset)))


def _kitti_360(root: Path) -> list[PairFiles]:
    cameras = root / "calibration/perspective.txt"
    calibration = read_calibration(cameras, (0, 1)) if cameras.is_file() else None
    pose = _kitti_360_pose(cameras, root / "calibration/calib_cam_to_velo.txt")
    pairs = []
    left, right = (root / _KITTI_360.format(camera) for camera in ("00", "01"))
    for pair in pair_folders(left, right):
        drive, *_, frame = pair.name.split("/")
        name = f"{drive}/{frame}"
        pairs.append(replace(pair, name=name, calibration=calibration, to_laser=pose))
    return pairs


def _kitti_360_pose(cameras: Path, laser: Path) -> Pose | None:
    """From the rectified left camera's frame to the scanner's; None if a file is not there."""
    if not (cameras.is_file() and laser.is_file()):
        return None
    to_laser, rectification = _matrix(laser, "", 4), _matrix(cameras, "R_rect_00", 3)
    if to_laser is None or rectification is None:
        return None
    # The laser's file is of the raw camera, whose frame R_rect turns into the rectified one.
    return np.column_stack((to_laser[:, :3] @ rectification.T, to_laser[:, 3]))


def _matrix(file: Path, name: str, columns: int) -> Pose | None:
    """A matrix of three rows in a KITTI file; None if the file has none of this name."""
    text = read_bytes(file).decode("utf-8", errors="replace")
    row = re.search(rf"^{name} *:(.*)$" if name else r"\A(.*)", text, flags=re.MULTILINE)
    if row is None:
        return None
    try:
        return np.array([float(word) for word in row[1].split()]).reshape(3, columns)
    except ValueError:
        raise InputError(
            f"{file}: {name or 'it'} must hold {3 * columns} numbers, got {row[1].strip()!r}"
        ) from None
