"""SceneFlow: FlyingThings3D, Monkaa and Driving."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.disparity_files import read_disparity_pfm
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.sample import Calibration
from mobilestereonet.data.scanners.base import Frame, StereoDataSet, occlusion_from_right_view
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError


@register_data_set("sceneflow")
class SceneFlow(StereoDataSet):
    """The synthetic set of Mayer et al. (CVPR 2016), in the paper's selection.

    The three archives may lie in folders of their own, as drawn, or all in the root::

        root
        ├── FlyingThings3D
        │   ├── frames_finalpass/{TRAIN,TEST}/{A,B,C}/0000/{left,right}/0006.png
        │   └── disparity/{TRAIN,TEST}/{A,B,C}/0000/{left,right}/0006.pfm
        ├── Monkaa
        │   ├── frames_finalpass/a_rain_of_stones_x2/{left,right}/0000.png
        │   └── disparity/a_rain_of_stones_x2/{left,right}/0000.pfm
        └── Driving
            ├── frames_finalpass/{15,35}mm_focallength/scene_{forwards,backwards}/{fast,slow}/
            │   └── {left,right}/0001.png
            └── disparity/{15,35}mm_focallength/scene_{forwards,backwards}/{fast,slow}/
                └── {left,right}/0001.pfm

    ``train`` is every left frame of FlyingThings3D TRAIN, Monkaa and Driving (35,454), ``test``
    every left frame of FlyingThings3D TEST (4,370). Disparity is known at every pixel, occlusion
    follows from the ground truth of both views. The baseline is 1 Blender unit, given as 1 m.

    Args:
        split: ``train`` or ``test``.
        render: ``finalpass`` (with motion blur and defocus; the paper's) or ``cleanpass``.
        subset: ``FlyingThings3D``, ``Monkaa`` or ``Driving`` alone; all if left out.
        webp: If True, the views are those of the WebP archives (``frames_finalpass_webp``).

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"train": 35454, "test": 4370}
    _counts: ClassVar = {
        "train": {"FlyingThings3D": 22390, "Monkaa": 8664, "Driving": 4400},
        "test": {"FlyingThings3D": 4370},
    }
    _folders: ClassVar = {
        "FlyingThings3D": "[Ff]lying[Tt]hings3[Dd]/",
        "Monkaa": "[Mm]onkaa/",
        "Driving": "[Dd]riving/",
    }

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        render: str = "finalpass",
        subset: str | None = None,
        webp: bool = False,
        strict: bool = False,
    ) -> None:
        if render not in ("finalpass", "cleanpass"):
            raise InputError(f"SceneFlow: render must be finalpass or cleanpass, got {render!r}")
        if subset is not None and subset not in self._folders:
            names = ", ".join(self._folders)
            raise InputError(f"SceneFlow: subset must be one of {names}, got {subset!r}")
        if split == "test" and subset not in (None, "FlyingThings3D"):
            raise InputError(f"SceneFlow: only FlyingThings3D has a test split, not {subset}")
        self.views = f"frames_{render}" + ("_webp" if webp else "")
        self.suffix = ".webp" if webp else ".png"
        self.subset = subset
        super().__init__(root, split, strict=strict)

    def official_count(self) -> int | None:
        """Number of frames of the chosen subsets."""
        counts = self._counts[self.split]
        return sum(counts.values()) if self.subset is None else counts[self.subset]

    def patterns(self) -> Sequence[str]:
        """Globs of the left views, one per subset and place."""
        # The depth of the folders tells the subsets apart where all lie in the root.
        scenes = {
            "FlyingThings3D": f"{self.split.upper()}/[ABC]/*",
            "Monkaa": "*",
            "Driving": "*mm_focallength/scene_*/*",
        }
        return [
            f"{folder}{self.views}/{scenes[subset]}/left/*{self.suffix}"
            for subset in self._counts[self.split]
            if self.subset in (None, subset)
            for folder in ("", self._folders[subset])
        ]

    def frame(self, left: Path) -> Frame:
        """Paths of the right view and of the PFM of the same name."""
        parts = left.relative_to(self.root).parts
        start = parts.index(self.views)
        truth = self.root.joinpath(*parts[:start], "disparity", *parts[start + 1 :])
        return Frame(
            name="/".join((*parts[start + 1 : -2], left.stem)),
            left=left,
            right=_other_view(left),
            disparity=truth.with_suffix(".pfm"),
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read dense disparity, positive whatever the release's sign."""
        return read_disparity_pfm(truth)

    def read_occluded(self, truth: Path, disparity: FloatMap, valid: Mask) -> Mask | None:
        """Compute occlusion, if the right view's ground truth is there too."""
        right = _other_view(truth)
        if not right.is_file():
            return None
        return occlusion_from_right_view(disparity, valid, *read_disparity_pfm(right))

    def read_calibration(self, left: Path) -> Calibration:
        """Calibration of the virtual camera: focal length 450 px for Driving's 15 mm, else 1050."""
        focal = 450.0 if "15mm_focallength" in left.parts else 1050.0
        return Calibration(focal=focal, baseline=1.0, cx=479.5, cy=269.5)


def _other_view(left: Path) -> Path:
    return left.parents[1] / "right" / left.name
