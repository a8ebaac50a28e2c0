"""Makes the start page's moving picture: a pair, its disparity and its turning point cloud.

python docs/figures/hero.py

The pair is scikit-image's Motorcycle, the network msnet3d. The ground is transparent, so that it
fits light and dark pages.
"""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont, ImageOps

from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.data.motorcycle import CALIBRATION, motorcycle
from mobilestereonet.inference import PointCloud, StereoMatcher
from mobilestereonet.plots import colour_disparity

FILE = Path(__file__).parents[1] / "images/hero.webp"

PANEL = (344, 232)
"""Width and height of a panel, in px."""
GAP_PX, LINE_PX = 26, 24
FRAMES, SECONDS = 48, 4.8
SWING = 22.0
"""Angle in degrees by which the cloud turns to either side."""
GROUND, GREY = (17, 21, 28), (128, 138, 148)
MAX_DEPTH_M = 5.5


def view_of(cloud: PointCloud, degrees: float, across: float) -> Picture:
    """The points from a camera that turns around their middle, far points first.

    Args:
        cloud: The points.
        degrees: Angle to the side, and by a fourth of it upwards.
        across: Width of the scene in the picture, in metres at the middle's depth.
    """
    size = (2 * PANEL[0], 2 * PANEL[1])  # drawn at twice the size: smooth when made smaller
    middle = np.median(cloud.points, axis=0)
    side, up = math.radians(degrees), math.radians(-6 - abs(degrees) / 4)
    about_y = cv2.Rodrigues(np.array([0.0, side, 0.0]))[0]
    about_x = cv2.Rodrigues(np.array([up, 0.0, 0.0]))[0]
    points = (cloud.points - middle) @ (about_x @ about_y).T
    x, y, z = points.T
    z = z + middle[2]
    focal = size[0] * middle[2] / across
    columns = np.round(focal * x / z + size[0] / 2).astype(int)
    rows = np.round(focal * y / z + size[1] / 2).astype(int)
    picture = np.full((size[1], size[0], 3), GROUND, np.uint8)
    order = np.argsort(-z)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            _draw(picture, rows[order] + down, columns[order] + right, cloud.colours[order])
    return cv2.resize(picture, PANEL, interpolation=cv2.INTER_AREA)


def _draw(
    picture: Picture, rows: NDArray[np.int_], columns: NDArray[np.int_], colours: Picture
) -> None:
    height, width = picture.shape[:2]
    seen = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    picture[rows[seen], columns[seen]] = colours[seen]


def pair_panel(left: Picture, right: Picture) -> Image.Image:
    """Both views, the right one behind the left one."""
    panel = Image.new("RGBA", PANEL)
    size = (round(0.78 * PANEL[0]), round(0.78 * PANEL[1]))
    for view, place in ((right, (PANEL[0] - size[0], 0)), (left, (0, PANEL[1] - size[1]))):
        small = Image.fromarray(cv2.resize(view, size, interpolation=cv2.INTER_AREA))
        panel.paste(ImageOps.expand(small.crop((2, 2, size[0] - 2, size[1] - 2)), 2, GREY), place)
    return panel


def main() -> None:
    """Match the pair, draw all frames and write the file."""
    sample = motorcycle()
    left, right = to_picture(sample.left), to_picture(sample.right)
    result = StereoMatcher.from_pretrained("msnet3d", left_right=True)(left, right)
    cloud = result.points(CALIBRATION, max_depth=MAX_DEPTH_M)
    disparity = cv2.resize(colour_disparity(result.disparity), PANEL, interpolation=cv2.INTER_AREA)
    width = 3 * PANEL[0] + 2 * GAP_PX
    still = Image.new("RGBA", (width, PANEL[1] + LINE_PX))
    places = [index * (PANEL[0] + GAP_PX) for index in range(3)]
    still.paste(pair_panel(left, right), (places[0], 0))
    still.paste(Image.fromarray(disparity), (places[1], 0))
    draw = ImageDraw.Draw(still)
    font = ImageFont.load_default(15)
    for place, text in zip(places, ("left and right view", "disparity", "points"), strict=True):
        draw.text((place + PANEL[0] / 2, PANEL[1] + 4), text, GREY, font, anchor="ma")
    for place in places[1:]:
        tip = (place - 5, PANEL[1] / 2)
        draw.line([(place - GAP_PX + 4, tip[1]), tip], GREY, 3)
        draw.polygon([tip, (tip[0] - 8, tip[1] - 6), (tip[0] - 8, tip[1] + 6)], GREY)
    frames = []
    for index in range(FRAMES):
        frame = still.copy()
        angle = SWING * math.sin(2 * math.pi * index / FRAMES)
        frame.paste(Image.fromarray(view_of(cloud, angle, across=2.3)), (places[2], 0))
        frames.append(frame)
    duration = round(1000 * SECONDS / FRAMES)
    options = {"quality": 76, "method": 6, "minimize_size": True}
    frames[0].save(
        FILE, save_all=True, append_images=frames[1:], duration=duration, loop=0, **options
    )
    print(f"{FILE}: {FILE.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
