"""Public benchmarks: their pairs, and the files that their servers take.

Sources: the ``readme.txt`` of the KITTI 2012 and 2015 development kits, the README and the upload
page of Middlebury's MiddEval3 SDK, and ETH3D's documentation.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mobilestereonet.data.scanners import NothingFoundError, StereoDataSet, open_data_set
from mobilestereonet.errors import InputError
from mobilestereonet.settings import choice_hint


@dataclass(frozen=True)
class Submission:
    """File names of one submission archive.

    Attributes:
        maps: Scene to the name of its disparity map in the archive: a ``.png`` with KITTI's 16
            bits, or a ``.pfm``.
        runtimes: Scene to the name of the text file with its seconds; empty where the server
            takes none.
        runtime_label: Text before the number in that file.
    """

    maps: Mapping[str, str]
    runtimes: Mapping[str, str] = field(default_factory=dict)
    runtime_label: str = ""

    def only(self, scenes: Collection[str]) -> Submission:
        """The part of it that belongs to some scenes."""
        maps, runtimes = (
            {scene: name for scene, name in names.items() if scene in scenes}
            for names in (self.maps, self.runtimes)
        )
        return Submission(maps, runtimes, self.runtime_label)


@dataclass(frozen=True)
class Benchmark:
    """Public benchmark: where its pairs are, and which files its server takes.

    File names are templates of ``{split}``, ``{size}``, ``{scene}`` and ``{method}``.

    Attributes:
        data_set: Name of the data set that `open_data_set` takes.
        scenes: Splits that are submitted, and the scenes of each.
        map_file: Template of the disparity maps' names.
        runtime_file: Template of the runtime files' names; None where the server takes none.
        runtime_label: Text before the seconds in these files.
        sizes: Sizes of the views to choose from; empty where there is one.
        method_pattern: Regular expression of the methods' names; None where names do not matter.
        method_rule: The same in words.
        takes_training_alone: Whether the server scores the training split alone, for a trial.
    """

    data_set: str
    scenes: Mapping[str, Sequence[str]]
    map_file: str
    runtime_file: str | None = None
    runtime_label: str = ""
    sizes: Sequence[str] = ()
    method_pattern: str | None = None
    method_rule: str = ""
    takes_training_alone: bool = False

    def splits(self, training_only: bool) -> list[str]:
        """Splits of the data set to match."""
        return ["training"] if training_only else [*self.scenes]

    def file_names(
        self, template: str, method: str, size: str, training_only: bool
    ) -> Iterator[tuple[str, str]]:
        """Pairs of a scene and its file's name."""
        for split in self.splits(training_only):
            for scene in self.scenes[split]:
                yield (
                    scene,
                    template.format(split=split, size=size, scene=scene, method=method),
                )


_MIDDLEBURY_TRAINING = """
    Adirondack ArtL Jadeplant Motorcycle MotorcycleE Piano PianoL Pipes Playroom Playtable
    PlaytableP Recycle Shelves Teddy Vintage
"""
_MIDDLEBURY_TEST = """
    Australia AustraliaP Bicycle2 Classroom2 Classroom2E Computer Crusade CrusadeP Djembe DjembeL
    Hoops Livingroom Newkuba Plants Staircase
"""
_ETH3D_TRAINING = """
    delivery_area_1l delivery_area_1s delivery_area_2l delivery_area_2s delivery_area_3l
    delivery_area_3s electro_1l electro_1s electro_2l electro_2s electro_3l electro_3s facade_1s
    forest_1s forest_2s playground_1l playground_1s playground_2l playground_2s playground_3l
    playground_3s terrace_1s terrace_2s terrains_1l terrains_1s terrains_2l terrains_2s
"""
_ETH3D_TEST = """
    lakeside_1l lakeside_1s sand_box_1l sand_box_1s storage_room_1l storage_room_1s
    storage_room_2_1l storage_room_2_1s storage_room_2_2l storage_room_2_2s storage_room_2l
    storage_room_2s storage_room_3l storage_room_3s tunnel_1l tunnel_1s tunnel_2l tunnel_2s
    tunnel_3l tunnel_3s
"""

BENCHMARKS: dict[str, Benchmark] = {
    "kitti2015": Benchmark(
        data_set="kitti2015",
        scenes={"testing": [f"{index:06d}_10" for index in range(200)]},
        map_file="disp_0/{scene}.png",
    ),
    "kitti2012": Benchmark(
        data_set="kitti2012",
        scenes={"testing": [f"{index:06d}_10" for index in range(195)]},
        map_file="{scene}.png",
    ),
    "middlebury": Benchmark(
        data_set="middeval3",
        scenes={"training": _MIDDLEBURY_TRAINING.split(), "test": _MIDDLEBURY_TEST.split()},
        map_file="{split}{size}/{scene}/disp0{method}.pfm",
        runtime_file="{split}{size}/{scene}/time{method}.txt",
        sizes=("Q", "H", "F"),
        # The SDK takes a name that ends in _s for sparse results.
        method_pattern=r"[A-Za-z0-9_-]+(?<!_s)",
        method_rule="letters, digits, - and _, and no _s at the end",
        takes_training_alone=True,
    ),
    "eth3d": Benchmark(
        data_set="eth3d",
        scenes={"training": _ETH3D_TRAINING.split(), "test": _ETH3D_TEST.split()},
        map_file="low_res_two_view/{scene}.pfm",
        runtime_file="low_res_two_view/{scene}.txt",
        runtime_label="runtime ",
    ),
}
"""Every benchmark that archives can be written for, by name."""


def plan_submission(
    benchmark: str, method: str, size: str = "Q", training_only: bool = False
) -> Submission:
    """Plan a submission: the file names that a benchmark's server takes.

    Args:
        benchmark: One of `BENCHMARKS`.
        method: Name of the method; Middlebury puts it into its file names.
        size: Middlebury's ``Q``, ``H`` or ``F``.
        training_only: Middlebury without the test scenes, for its temporary table.

    Raises:
        InputError: If a value is none of these.
    """
    entry = _find(benchmark, size, training_only)
    if entry.method_pattern and not re.fullmatch(entry.method_pattern, method):
        raise InputError(f"method {method!r}: {benchmark} takes {entry.method_rule}")
    how = method, size, training_only
    return Submission(
        dict(entry.file_names(entry.map_file, *how)),
        dict(entry.file_names(entry.runtime_file, *how)) if entry.runtime_file else {},
        entry.runtime_label,
    )


def open_benchmark(
    benchmark: str,
    root: Path,
    size: str = "Q",
    training_only: bool = False,
    partial: bool = False,
) -> list[StereoDataSet]:
    """Open the data sets that a benchmark scores, checked to be complete.

    Args:
        benchmark: One of `BENCHMARKS`.
        root: Folder in which the benchmark's archives were unpacked.
        size: Middlebury's ``Q``, ``H`` or ``F``.
        training_only: Middlebury without the test scenes.
        partial: Take the pairs that are there, whatever is missing.

    Raises:
        FileNotFoundError: If there is no pair.
        InputError: If a value is none of these, or the number of pairs is not the official one.
    """
    entry = _find(benchmark, size, training_only)
    options = {"size": size} if entry.sizes else {}
    parts, absent = [], None
    for split in entry.splits(training_only):
        try:
            with warnings.catch_warnings():
                if partial:
                    warnings.filterwarnings("ignore", ".* expected .* frames")
                parts.append(
                    open_data_set(entry.data_set, root, split=split, strict=not partial, **options)
                )
        except NothingFoundError as error:
            absent = error
            if not partial:
                raise
    if absent is not None and not parts:
        raise absent
    return parts


def _find(benchmark: str, size: str, training_only: bool) -> Benchmark:
    """Entry of a benchmark, checked to take these options."""
    if benchmark not in BENCHMARKS:
        raise InputError(f"unknown benchmark {benchmark!r}: {choice_hint(benchmark, BENCHMARKS)}")
    entry = BENCHMARKS[benchmark]
    if training_only and not entry.takes_training_alone:
        raise InputError(f"{benchmark} takes no archive of training scenes alone")
    if entry.sizes and size not in entry.sizes:
        raise InputError(f"{benchmark}'s size is one of {', '.join(entry.sizes)}, got {size!r}")
    return entry
