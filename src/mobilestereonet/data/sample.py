"""The records of a stereo pair: `StereoSample` and its `Calibration`."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.data.sizes import check_untold_size, wrong_size
from mobilestereonet.errors import InputError


@dataclass(frozen=True)
class Calibration:
    """Calibration of a rectified pair.

    Depth is ``focal * baseline / (disparity + doffs)``.

    Attributes:
        focal: Horizontal focal length of the rectified cameras, in pixels.
        baseline: Distance between the camera centres, in metres.
        doffs: Difference of the principal points, right minus left, in pixels.
        cx: Column of the left view's principal point, in pixels; None if unknown.
        cy: Row of the left view's principal point, in pixels; None if unknown.
        size: Width and height of the views that it belongs to, in pixels; None if unknown.
        focal_y: Vertical focal length, in pixels; None if it is the horizontal one. Depth does
            not depend on it, the height of points does.
    """

    focal: float
    baseline: float
    doffs: float = 0.0
    cx: float | None = None
    cy: float | None = None
    size: tuple[int, int] | None = None
    focal_y: float | None = None

    def __post_init__(self) -> None:
        for name in ("focal", "focal_y", "baseline"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                hint = ": are the cameras swapped?" if name == "baseline" and value < 0 else ""
                raise InputError(
                    f"calibration: {name} must be positive and finite, got {value:g}{hint}"
                )
        for name in ("doffs", "cx", "cy"):
            if not math.isfinite(getattr(self, name) or 0):
                raise InputError(f"calibration: {name} must be finite, got {getattr(self, name)}")
        if self.size is not None and not all(0 < side < math.inf for side in self.size):
            raise InputError(
                f"calibration: width and height must be positive and finite, got {self.size}"
            )

    @property
    def focal_lengths(self) -> tuple[float, float]:
        """Horizontal and vertical focal length, in pixels."""
        return self.focal, self.focal if self.focal_y is None else self.focal_y

    def require_size(self, width: int, height: int) -> None:
        """Check that the calibration belongs to views of this size.

        Raises:
            InputError: If it is known to be of another: depth would be wrong by the ratio. Where
                it tells no size, its principal point does, with a warning if it is not clear.
        """
        if self.size is None:
            if self.cx is not None and self.cy is not None:
                doubt = check_untold_size(self.cx, self.cy, (width, height))
                if doubt:
                    warnings.warn(f"calibration: {doubt}", stacklevel=2)
            return
        if tuple(self.size) == (width, height):
            return
        raise wrong_size(self.size, (width, height), "the calibration is of views of")

    def resized(self, size: tuple[int, int]) -> Calibration:
        """Calibration of the views resized to another width and height.

        Raises:
            InputError: If its own size is unknown.
        """
        if self.size is None:
            raise InputError("a calibration that tells no size cannot follow a resizing")
        fx, fy = size[0] / self.size[0], size[1] / self.size[1]
        focal, focal_y = self.focal * fx, self.focal_lengths[1] * fy
        return Calibration(
            focal=focal,
            baseline=self.baseline,
            doffs=self.doffs * fx,
            cx=None if self.cx is None else (self.cx + 0.5) * fx - 0.5,
            cy=None if self.cy is None else (self.cy + 0.5) * fy - 0.5,
            size=size,
            focal_y=None if focal == focal_y else focal_y,
        )

    def principal_point(self, width: int, height: int) -> tuple[float, float]:
        """Column and row of the left view's principal point; the view's middle if unknown."""
        return (
            (width - 1) / 2 if self.cx is None else self.cx,
            (height - 1) / 2 if self.cy is None else self.cy,
        )


@dataclass(frozen=True)
class StereoSample:
    """Rectified pair, or a batch of pairs, with ground truth where there is one.

    One sample has images of shape (3, H, W) and maps of shape (H, W); a batch has one more
    dimension in front. Left pixel (x, y) matches right pixel (x - disparity, y).

    Attributes:
        left: Left view, RGB float32 in 0..1.
        right: Right view, RGB float32 in 0..1.
        disparity: Ground truth of the left view, float32 in pixels, 0 where ``valid`` is False.
        valid: True where the ground truth is known.
        occluded: True where the left pixel is not visible in the right view.
        foreground: True on the objects that KITTI 2015 calls foreground.
        calibration: Geometry of the pair; None in a batch.
        name: Name of the sample in reports and file names.
    """

    left: Tensor
    right: Tensor
    disparity: Tensor | None = None
    valid: Tensor | None = None
    occluded: Tensor | None = None
    foreground: Tensor | None = None
    calibration: Calibration | None = None
    name: str = ""

    def to(self, device: torch.device | str) -> StereoSample:
        """Copy of the sample whose tensors lie on ``device``."""
        # A copy to the CPU that does not wait could be read before it is there.
        wait = torch.device(device).type == "cpu"
        return self.map(lambda tensor: tensor.to(device, non_blocking=not wait))

    def pin_memory(self) -> StereoSample:
        """Copy of the sample in page-locked memory, for asynchronous copies to a GPU."""
        return self.map(Tensor.pin_memory)

    def map(self, function: Callable[[Tensor], Tensor]) -> StereoSample:
        """Copy of the sample with ``function`` applied to every image and map."""
        tensors: dict[str, Any] = {
            field.name: function(value)
            for field in fields(self)
            if isinstance(value := getattr(self, field.name), Tensor)
        }
        return replace(self, **tensors)


def collate(samples: Sequence[StereoSample]) -> StereoSample:
    """Stack samples of one size into a batch.

    Args:
        samples: Samples with equal image sizes. A map that one of them lacks is left out.

    Returns:
        One sample whose tensors have a batch dimension, named after its parts.

    Raises:
        InputError: If the sizes differ.
    """
    sizes = {tuple(sample.left.shape[-2:]) for sample in samples}
    if len(sizes) != 1:
        listed = ", ".join(f"{height}x{width}" for height, width in sorted(sizes))
        raise InputError(
            f"a batch needs images of one size, got {listed}: crop them or use batch size 1"
        )
    stacked: dict[str, Any] = {}
    for field in ("left", "right", "disparity", "valid", "occluded", "foreground"):
        values = [getattr(sample, field) for sample in samples]
        if all(value is not None for value in values):
            stacked[field] = torch.stack(values)
    return StereoSample(**stacked, name=",".join(sample.name for sample in samples))
