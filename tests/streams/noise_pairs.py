"""Pairs whose disparity is known: a picture of noise, and the same one moved."""

import cv2
import numpy as np

HEIGHT, WIDTH = 48, 160


def make_pair(disparity, seed=0):
    """Left and right view, (48, 160, 3) uint8."""
    rng = np.random.default_rng(seed)
    noise = rng.integers(0, 256, (HEIGHT, WIDTH + 64, 3), dtype=np.uint8)
    scene = cv2.GaussianBlur(noise, (3, 3), 0)
    return scene[:, :WIDTH], scene[:, disparity : disparity + WIDTH]


def centre(disparity):
    """Where every view has a partner, away from the borders."""
    return disparity[10:-10, 80:-20]
