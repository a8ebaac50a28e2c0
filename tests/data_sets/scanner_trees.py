"""Small trees in the layouts of public data sets, and what must be read from them."""

import struct

import cv2
import numpy as np
import torch

H, W = 4, 12
LEFT, RIGHT = 51, 102  # grey levels of the views: 0.2 and 0.4


def put_image(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    if np.isscalar(image):
        image = np.full((H, W, 3), image, np.uint8)
    elif image.ndim == 3:
        image = image[..., ::-1]
    assert cv2.imwrite(str(path), image)


def put_pfm(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = values.shape
    numbers = struct.pack(f"<{values.size}f", *values[::-1].ravel())
    path.write_bytes(f"Pf \n{width} {height} \n-1.0\n".encode() + numbers)


def put_npy(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, values)


def put_text(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def flat(value, dtype=np.float32):
    return np.full((H, W), value, dtype)


def check_views(sample):
    torch.testing.assert_close(sample.left, torch.full((3, H, W), 0.2))
    torch.testing.assert_close(sample.right, torch.full((3, H, W), 0.4))


def check_disparity(sample, expected):
    """Expected disparity, 0 where it must be unknown."""
    expected = torch.as_tensor(expected, dtype=torch.float32).expand(H, W)
    torch.testing.assert_close(sample.disparity, expected)
    torch.testing.assert_close(sample.valid, expected > 0)
