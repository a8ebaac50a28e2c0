"""Rectification of a stream's pictures on the way, as its cameras' calibration says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.rig.cameras import CameraPair
from mobilestereonet.errors import InputError


class Rectifier:
    """Rectifies pairs of raw pictures of two cameras whose rectification is known.

    Args:
        cameras: The cameras, with their ``rectification`` and the size of their pictures.

    Raises:
        InputError: If they have none.
    """

    def __init__(self, cameras: CameraPair) -> None:
        if cameras.rectification is None or cameras.size is None:
            raise InputError("the cameras' calibration does not tell how to rectify their pictures")
        self.size = cameras.size
        self._maps = []
        for camera, rotation, projection in zip(
            (cameras.left, cameras.right),
            cameras.rectification.rotations,
            cameras.rectification.projections,
            strict=True,
        ):
            undistort = cv2.fisheye if camera.fisheye else cv2
            self._maps.append(
                undistort.initUndistortRectifyMap(
                    camera.matrix,
                    camera.distortion,
                    rotation,
                    projection[:, :3],
                    self.size,
                    cv2.CV_16SC2,
                )
            )

    def __call__(self, pictures: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        """The rectified left and right picture, black where the cameras saw nothing.

        Raises:
            InputError: If a picture is of another size than the calibration.
        """
        for picture in pictures:
            height, width = picture.shape[:2]
            if (width, height) != self.size:
                raise InputError(
                    f"the picture has {width}x{height}, its camera_info {self.size[0]}x"
                    f"{self.size[1]} (width x height)"
                )
        return [
            np.asarray(cv2.remap(picture, map1, map2, interpolation=cv2.INTER_LINEAR))
            for picture, (map1, map2) in zip(pictures, self._maps, strict=True)
        ]
