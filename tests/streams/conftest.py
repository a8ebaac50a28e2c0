"""Sequences, captures and a matcher to try streams on."""

import cv2
import numpy as np
import pytest
from noise_pairs import make_pair

from mobilestereonet import StereoMatcher


class CountingMatcher(StereoMatcher):
    """OpenCV's matcher, which tells how many pairs it matched."""

    count = 0

    def match(self, pair):
        self.count += 1
        return super().match(pair)


@pytest.fixture
def matcher():
    return CountingMatcher.from_pretrained("sgbm", max_disparity=64)


@pytest.fixture
def sequence(tmp_path):
    """Folders left and right with eleven pairs; pair i has disparity 10 + i."""
    for index in range(11):
        for side, view in zip(("left", "right"), make_pair(10 + index, index), strict=True):
            (tmp_path / side).mkdir(exist_ok=True)
            assert cv2.imwrite(str(tmp_path / side / f"view_{index}.png"), view[..., ::-1])
    return tmp_path


@pytest.fixture
def write_capture(tmp_path):
    """Writes pictures to a video with OpenCV alone; gives its path."""

    def write(name, pictures):
        path = tmp_path / name
        height, width = pictures[0].shape[:2]
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (width, height))
        assert writer.isOpened()
        for picture in pictures:
            writer.write(np.ascontiguousarray(picture[..., ::-1]))
        writer.release()
        return path

    return write
