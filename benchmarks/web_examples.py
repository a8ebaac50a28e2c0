"""Write the example pairs of `msnet web` into the package.

    python benchmarks/web_examples.py SAMPLES

SAMPLES is the folder ``samples/data`` of OpenCV's sources (Apache-2.0; on Debian in the package
opencv-doc), with a board in front of two cameras, which is rectified here. The others are rendered.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

import mobilestereonet.web
from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.scenes import ProceduralScenes, SceneConfig

CONFIG = SceneConfig(
    height=320,
    width=512,
    max_disparity=96,
    min_disparity=32,
    kinds={"street": 1, "room": 1, "table": 1, "park": 1},
    noise_textures=32,
)
SCENES = {"Street": 0, "Room": 3, "Park": 9, "Traffic": 11}
BOARD = (9, 6)
"""Inner corners of the board."""
SHOWN_BOARD = "01"
QUALITY = 90
"""Of WebP, of 100."""

Views = tuple[Picture, Picture]


def board(samples: Path) -> Views:
    """A pair of OpenCV's calibration pictures, rectified with all of them."""
    pairs = {
        left.stem[-2:]: [
            cv2.imread(str(path))
            for path in (left, left.with_name(left.name.replace("left", "right")))
        ]
        for left in sorted(samples.glob("left[01][0-9].jpg"))
    }
    corners = [
        [cv2.findChessboardCorners(view, BOARD) for view in views] for views in pairs.values()
    ]
    found = [[each[1] for each in both] for both in corners if all(each[0] for each in both)]
    grid = np.zeros((BOARD[0] * BOARD[1], 3), np.float32)
    grid[:, :2] = np.mgrid[: BOARD[0], : BOARD[1]].T.reshape(-1, 2)
    grids, size = [grid] * len(found), (640, 480)
    lenses = [
        cv2.calibrateCamera(grids, [both[side] for both in found], size, None, None)[1:3]
        for side in (0, 1)
    ]
    (own, bent), (other, its) = lenses
    *_, turn, move, _, _ = cv2.stereoCalibrate(
        grids, *zip(*found, strict=True), own, bent, other, its, size
    )
    turns = cv2.stereoRectify(own, bent, other, its, size, turn, move, alpha=0)
    left, right = (
        cv2.remap(
            view,
            *cv2.initUndistortRectifyMap(*lens, turned, projected, size, cv2.CV_32FC1),
            cv2.INTER_CUBIC,
        )
        for view, lens, turned, projected in zip(
            pairs[SHOWN_BOARD], lenses, turns[:2], turns[2:4], strict=True
        )
    )
    return left, right


def main() -> None:
    """Write one side-by-side picture per pair, and the calibrations that are known."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("samples", type=Path)
    pairs = {"Board": board(parser.parse_args().samples)}
    cameras: dict[str, dict[str, float] | None] = {"Board": None}  # nobody says its squares' size
    scenes = ProceduralScenes(CONFIG)
    for name, index in SCENES.items():
        sample = scenes[index]
        pairs[name] = to_picture(sample.left), to_picture(sample.right)
        known = sample.calibration
        assert known is not None  # rendered scenes have one
        cameras[name] = {key: getattr(known, key) for key in ("focal", "baseline", "doffs")}
    folder = Path(mobilestereonet.web.__file__).parent / "pairs"
    folder.mkdir(exist_ok=True)
    for name, views in pairs.items():
        both = Image.fromarray(np.hstack(views))
        both.save(folder / f"{name}.webp", quality=QUALITY, method=6)
    (folder / "cameras.json").write_text(json.dumps(cameras, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
