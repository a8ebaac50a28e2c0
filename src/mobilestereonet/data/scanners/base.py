"""Base class of the data set scanners: find the frames of a folder layout, check, read."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch.utils.data import Dataset

from mobilestereonet.data.files import visible
from mobilestereonet.data.image_files import read_image
from mobilestereonet.data.images import FloatMap, Mask, image_to_tensor, white_level
from mobilestereonet.data.sample import Calibration, StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.settings import choice_hint


class NothingFoundError(FileNotFoundError):
    """Error of a data set of which no left view is there."""


@dataclass(frozen=True)
class Frame:
    """File paths of one sample.

    Attributes:
        name: Name of the sample in reports and file names; may hold slashes.
        left: Left view.
        right: Right view.
        disparity: Ground truth of the left view; None in a set without ground truth.
    """

    name: str
    left: Path
    right: Path
    disparity: Path | None = None


class StereoDataSet(Dataset[StereoSample], ABC):
    """Data set of stereo pairs, read from the folder layout in which it is published.

    A subclass says which files are left views (`patterns`), what belongs to each (`frame`), and
    how its ground truth is read (`read_disparity` and, where the set has more, the other
    ``read_...`` methods).

    Args:
        root: Folder in which the archives were unpacked.
        split: One of ``splits``; the first of them if left out.
        strict: If True, a number of frames other than the official one is an error, not a
            warning.

    Attributes:
        splits: Official number of frames of each split; None where there is none.
        withheld: Splits whose ground truth is not public.
        frames: The frames found, in the order of their paths.

    Raises:
        NothingFoundError: If no left view is found; the message names the root, the patterns and
            what is there instead.
        FileNotFoundError: If a right view or a ground truth is missing; it names both files.
        InputError: If the split is unknown or, with ``strict``, the number of frames is not the
            official one.
    """

    label: ClassVar[str]
    """What the class is registered as, see `register_data_set`."""
    splits: ClassVar[Mapping[str, int | None]]
    withheld: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, root: str | Path, split: str | None = None, *, strict: bool = False) -> None:
        self.root = Path(root)
        self.split = next(iter(self.splits)) if split is None else split
        if self.split not in self.splits:
            raise InputError(f"{self}: unknown split, {choice_hint(self.split, self.splits)}")
        self.frames = [self.frame(left) for left in self.left_views()]
        if self.split in self.withheld:
            self.frames = [replace(frame, disparity=None) for frame in self.frames]
        if not self.frames:
            looked_for = ", ".join(self.patterns())
            count = sum(1 for pattern in self.patterns() for _ in visible(self.root, pattern))
            if count and len(self.splits) > 1:
                others = ", ".join(split for split in self.splits if split != self.split)
                raise NothingFoundError(
                    f"{self}: {count} frames found in {self.root}, but none of this split: choose "
                    f"another one ({others})"
                )
            raise NothingFoundError(
                f"{self}: nothing found in {self.root}: no {looked_for}; {_content(self.root)}"
            )
        for frame in self.frames:
            _check_files(frame)
        self._check_count(strict)

    def __str__(self) -> str:
        """Name and split, for messages."""
        name = vars(type(self)).get("label", type(self).__name__)
        return f"{name} ({self.split})"

    @abstractmethod
    def patterns(self) -> Sequence[str]:
        """Globs of the left views, below the root."""

    @abstractmethod
    def frame(self, left: Path) -> Frame:
        """Paths of the files that belong to a left view."""

    def left_views(self) -> list[Path]:
        """Paths of the left views of the split, sorted."""
        return sorted({path for pattern in self.patterns() for path in visible(self.root, pattern)})

    def official_count(self) -> int | None:
        """Number of frames of the complete set; None if there is no official one."""
        return self.splits[self.split]

    def require_truth(self, otherwise: str = "") -> None:
        """Check that the pairs have ground truth, before any work is done with them.

        Args:
            otherwise: Another way out, added to the message.

        Raises:
            InputError: If they have none; the message names the way out.
        """
        if self.frames[0].disparity is None:
            ways_out = "; ".join(filter(None, [self.truth_advice(), otherwise]))
            raise InputError(f"{self} has no ground truth: {ways_out}")

    def truth_advice(self) -> str:
        """Advice for the message of `require_truth`."""
        others = [split for split in self.splits if split not in self.withheld]
        return f"choose another split: {', '.join(others)}"

    @abstractmethod
    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read disparity (H, W) in pixels, 0 where unknown, and mask (H, W), True where known."""

    def read_occluded(self, truth: Path, disparity: FloatMap, valid: Mask) -> Mask | None:
        """Read the mask (H, W) of pixels that the right view does not see; None if unknown.

        Only its pixels with ground truth count.
        """
        return None

    def read_foreground(self, truth: Path) -> Mask | None:
        """Read the mask (H, W) of foreground objects; None if the set has no such labels."""
        return None

    def read_calibration(self, left: Path) -> Calibration | None:
        """Read the pair's calibration; None if the set has none."""
        return None

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> StereoSample:
        """Read one sample.

        Raises:
            InputError: If a file is damaged or the sizes within the sample differ.
        """
        frame = self.frames[index]
        images = [read_image(path) for path in (frame.left, frame.right)]
        left, right = (image_to_tensor(image, white_level(*images)) for image in images)
        maps: dict[str, Mask | FloatMap | None] = {}
        if frame.disparity is not None:
            disparity, valid = self.read_disparity(frame.disparity)
            _check_size(frame, left, "disparity", disparity.shape)
            maps = {
                "disparity": disparity,
                "valid": valid,
                "occluded": self._occluded(frame, disparity, valid),
                "foreground": self.read_foreground(frame.disparity),
            }
        tensors = {key: torch.from_numpy(map_) for key, map_ in maps.items() if map_ is not None}
        for key, tensor in {"right": right, **tensors}.items():
            _check_size(frame, left, key, tensor.shape)
        if "occluded" in tensors:
            tensors["occluded"] &= tensors["valid"]
        return StereoSample(
            left=left,
            right=right,
            calibration=self.read_calibration(frame.left),
            name=frame.name,
            **tensors,
        )

    def _occluded(self, frame: Frame, disparity: FloatMap, valid: Mask) -> Mask | None:
        assert frame.disparity is not None
        try:
            return self.read_occluded(frame.disparity, disparity, valid)
        except InputError as error:
            raise InputError(f"{frame.left}: {error}") from None

    def _check_count(self, strict: bool) -> None:
        expected = self.official_count()
        if expected is None or len(self.frames) == expected:
            return
        message = f"{self}: expected {expected} frames, found {len(self.frames)} in {self.root}"
        if strict:
            raise InputError(message)
        warnings.warn(message, stacklevel=3)


def occlusion_from_right_view(
    disparity: FloatMap,
    valid: Mask,
    right_disparity: FloatMap,
    right_valid: Mask,
    tolerance: float = 1.0,
) -> Mask:
    """Mask of the left pixels that the right view does not see, from the truth of both views.

    A left pixel is occluded if its match lies outside the right view, or if the surface that the
    right view shows there is nearer by more than ``tolerance``. Where the right ground truth is
    unknown, the pixel is taken for visible.

    Args:
        disparity: Disparity of the left view (H, W), in pixels.
        valid: Mask (H, W), True where it is known.
        right_disparity: Disparity of the right view (H, W), in pixels, positive.
        right_valid: Mask (H, W), True where that is known.
        tolerance: In pixels of disparity; covers rounding to whole columns on slanted surfaces.

    Returns:
        Mask (H, W), True where the left pixel is known and occluded.

    Raises:
        InputError: If the sizes differ.
    """
    if right_disparity.shape != disparity.shape:
        raise InputError(
            f"the ground truth of the right view is {_size(right_disparity.shape)}, "
            f"that of the left view {_size(disparity.shape)}: they must have one size"
        )
    height, width = disparity.shape
    column = np.floor(np.arange(width) - disparity + 0.5).astype(np.int64)
    row = np.arange(height)[:, None]
    match = row, column.clip(0)
    nearer = right_valid[match] & (right_disparity[match] > disparity + tolerance)
    occluded: Mask = valid & ((column < 0) | nearer)
    return occluded


def _check_files(frame: Frame) -> None:
    if not frame.right.is_file():
        raise FileNotFoundError(f"{frame.left}: its right view {frame.right} is missing")
    if frame.disparity is not None and not frame.disparity.is_file():
        raise FileNotFoundError(f"{frame.left}: its ground truth {frame.disparity} is missing")


def _content(root: Path) -> str:
    """Content of a folder in a few words, for messages."""
    if not root.is_dir():
        return "there is no such folder"
    names = sorted(path.name for path in root.iterdir() if path.name[0] != ".")
    more = ", ..." if len(names) > 6 else ""
    return f"it holds {', '.join(names[:6]) or 'nothing'}{more}"


def _check_size(frame: Frame, left: torch.Tensor, key: str, shape: Sequence[int]) -> None:
    if tuple(shape[-2:]) != tuple(left.shape[-2:]):
        raise InputError(
            f"{frame.left}: left view is {_size(left.shape)}, but {key} is {_size(shape)}"
        )


def _size(shape: Sequence[int]) -> str:
    height, width = shape[-2:]
    return f"{width}x{height}"
