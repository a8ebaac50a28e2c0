"""Archives for the benchmarks' servers: what they must hold, writing one, checking one.

Sources: the ``readme.txt`` of the KITTI 2012 and 2015 development kits, the README and the upload
page of Middlebury's MiddEval3 SDK, and ETH3D's documentation.
"""

from __future__ import annotations

import math
import re
import shutil
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.disparity_files import write_disparity_png
from mobilestereonet.data.files import decode_image, read_pfm, write_pfm
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.data.scanners import StereoDataSet, open_data_set
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation.matching import DisparityFn, timed_match

BENCHMARKS = ("kitti2015", "kitti2012", "middlebury", "eth3d")

_MIDDLEBURY = {
    "training": "Adirondack ArtL Jadeplant Motorcycle MotorcycleE Piano PianoL Pipes Playroom "
    "Playtable PlaytableP Recycle Shelves Teddy Vintage",
    "test": "Australia AustraliaP Bicycle2 Classroom2 Classroom2E Computer Crusade CrusadeP "
    "Djembe DjembeL Hoops Livingroom Newkuba Plants Staircase",
}
_ETH3D = (
    "delivery_area_1l delivery_area_1s delivery_area_2l delivery_area_2s delivery_area_3l "
    "delivery_area_3s electro_1l electro_1s electro_2l electro_2s electro_3l electro_3s "
    "facade_1s forest_1s forest_2s playground_1l playground_1s playground_2l playground_2s "
    "playground_3l playground_3s terrace_1s terrace_2s terrains_1l terrains_1s terrains_2l "
    "terrains_2s "
    "lakeside_1l lakeside_1s sand_box_1l sand_box_1s storage_room_1l storage_room_1s "
    "storage_room_2_1l storage_room_2_1s storage_room_2_2l storage_room_2_2s storage_room_2l "
    "storage_room_2s storage_room_3l storage_room_3s tunnel_1l tunnel_1s tunnel_2l tunnel_2s "
    "tunnel_3l tunnel_3s"
)


@dataclass(frozen=True)
class Submission:
    """The files of one archive.

    Attributes:
        maps: Scene to the name of its disparity map in the archive: a ``.png`` with KITTI's 16
            bits, or a ``.pfm``.
        runtimes: Scene to the name of the text file with its seconds; empty where the server
            takes none.
        runtime_label: What stands before the number in that file.
    """

    maps: Mapping[str, str]
    runtimes: Mapping[str, str] = field(default_factory=dict)
    runtime_label: str = ""


def plan_submission(
    benchmark: str, method: str, size: str = "Q", training_only: bool = False
) -> Submission:
    """What a benchmark's server takes.

    - ``kitti2015``: ``disp_0/000000_10.png`` to ``000199_10.png`` of the testing set.
    - ``kitti2012``: ``000000_10.png`` to ``000194_10.png`` of the testing set, without a folder.
    - ``middlebury``: ``trainingQ/Adirondack/disp0METHOD.pfm`` and ``timeMETHOD.txt``, and so on
      for 15 training and 15 test scenes of one size.
    - ``eth3d``: ``low_res_two_view/delivery_area_1l.pfm`` and ``.txt``, and so on for 27 training
      and 20 test scenes.

    Args:
        benchmark: One of `BENCHMARKS`.
        method: Name of the method; Middlebury puts it into its file names.
        size: Middlebury's ``Q``, ``H`` or ``F``.
        training_only: Middlebury without the test scenes, for its temporary table.

    Raises:
        InputError: If a value is none of these.
    """
    if training_only and benchmark != "middlebury":
        raise InputError(f"{benchmark} takes no archive of training scenes alone")
    if benchmark == "kitti2015":
        return Submission({f"{i:06d}_10": f"disp_0/{i:06d}_10.png" for i in range(200)})
    if benchmark == "kitti2012":
        return Submission({f"{i:06d}_10": f"{i:06d}_10.png" for i in range(195)})
    if benchmark == "eth3d":
        return Submission(
            {scene: f"low_res_two_view/{scene}.pfm" for scene in _ETH3D.split()},
            {scene: f"low_res_two_view/{scene}.txt" for scene in _ETH3D.split()},
            "runtime ",
        )
    if benchmark != "middlebury":
        raise InputError(f"unknown benchmark {benchmark!r}, choose one of {', '.join(BENCHMARKS)}")
    # The SDK takes a name that ends in _s for sparse results.
    if not re.fullmatch(r"[A-Za-z0-9_-]+(?<!_s)", method):
        raise InputError(
            f"method {method!r}: Middlebury takes letters, digits, - and _, and no _s at the end"
        )
    if size not in ("Q", "H", "F"):
        raise InputError(f"Middlebury's size is Q, H or F, got {size!r}")
    folders = {
        scene: f"{split}{size}/{scene}"
        for split, scenes in _MIDDLEBURY.items()
        if split == "training" or not training_only
        for scene in scenes.split()
    }
    return Submission(
        {scene: f"{folder}/disp0{method}.pfm" for scene, folder in folders.items()},
        {scene: f"{folder}/time{method}.txt" for scene, folder in folders.items()},
    )


def open_benchmark(
    benchmark: str, root: Path, size: str = "Q", training_only: bool = False
) -> list[StereoDataSet]:
    """The pairs that a benchmark wants matched, complete.

    Args:
        benchmark: One of `BENCHMARKS`.
        root: Folder in which the benchmark's archives were unpacked.
        size: Middlebury's ``Q``, ``H`` or ``F``.
        training_only: Middlebury without the test scenes.

    Raises:
        FileNotFoundError: If there is no pair.
        InputError: If their number is not the official one.
    """
    if benchmark.startswith("kitti"):
        return [open_data_set(benchmark, root, split="testing", strict=True)]
    splits = ("training",) if training_only else ("training", "test")
    if benchmark == "middlebury":
        return [
            open_data_set("middeval3", root, split=split, size=size, strict=True)
            for split in splits
        ]
    return [open_data_set(benchmark, root, split=split, strict=True) for split in splits]


def write_submission(
    plan: Submission, match: DisparityFn, data: Iterable[StereoSample], archive: Path
) -> None:
    """Match every scene of a benchmark and write the archive for its server, checked.

    Args:
        plan: What the server takes.
        match: The method. It is called once more in the beginning, so that no scene's time holds
            what only the first call does.
        data: The benchmark's pairs; the last part of a sample's name is its scene.
        archive: ZIP file to write. It is not there before it has passed `check_submission`.

    Raises:
        InputError: If a pair belongs to no scene, a scene is missing, a disparity is not finite
            or too large for the format.
    """
    sizes: dict[str, tuple[int, int]] = {}
    with TemporaryDirectory() as temporary:
        folder = Path(temporary, "files")
        for sample in data:
            scene = sample.name.rsplit("/", 1)[-1]
            if scene not in plan.maps:
                raise InputError(f"{sample.name} is no scene of this benchmark")
            batch = collate([sample])
            if not sizes:
                timed_match(match, batch)
            prediction, seconds = timed_match(match, batch)
            sizes[scene] = (sample.left.shape[-2], sample.left.shape[-1])
            _write_scene(plan, folder, scene, prediction[0].numpy(), seconds)
        packed = Path(temporary, archive.name)
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
            for path in sorted(path for path in folder.rglob("*") if path.is_file()):
                file.write(path, path.relative_to(folder).as_posix())
        check_submission(plan, packed, sizes)
        write_atomically(archive, lambda path: shutil.copyfile(packed, path))


def _write_scene(
    plan: Submission, folder: Path, scene: str, disparity: np.ndarray, seconds: float
) -> None:
    path = folder / plan.maps[scene]
    if path.suffix == ".png":
        # 0 would say that the method has no estimate there.
        write_disparity_png(path, disparity.clip(1 / 256))
    else:
        write_pfm(path, disparity.clip(0))
    if scene in plan.runtimes:
        text = f"{plan.runtime_label}{seconds:.6f}\n"
        (folder / plan.runtimes[scene]).write_text(text)


def check_submission(plan: Submission, archive: Path, sizes: Mapping[str, tuple[int, int]]) -> None:
    """Check an archive as the server would: names, counts, types and sizes.

    Args:
        plan: What the server takes.
        archive: ZIP file.
        sizes: Scene to height and width of its left view.

    Raises:
        InputError: If something is wrong; the message names the first file that is.
    """
    expected = {*plan.maps.values(), *plan.runtimes.values()}
    try:
        with zipfile.ZipFile(archive) as file, TemporaryDirectory() as temporary:
            names = [name for name in file.namelist() if not name.endswith("/")]
            _check_names(archive.name, names, expected)
            file.extractall(temporary)
            for scene, name in plan.maps.items():
                _check_map(Path(temporary), name, sizes[scene])
            for name in plan.runtimes.values():
                _check_runtime(Path(temporary), name, plan.runtime_label)
    except zipfile.BadZipFile as error:
        raise InputError(f"{archive.name}: not a whole ZIP archive: {error}") from error


def _check_names(archive: str, names: list[str], expected: set[str]) -> None:
    for problem, wrong in (
        ("lacks", expected.difference(names)),
        ("has, but should not,", set(names).difference(expected)),
        ("has twice", {name for name in names if names.count(name) > 1}),
    ):
        if wrong:
            raise InputError(
                f"{archive}: {problem} {min(wrong)} ({len(wrong)} such files; "
                f"{len(expected)} are expected, {len(names)} are there)"
            )


def _check_map(folder: Path, name: str, size: tuple[int, int]) -> None:
    path = folder / name
    if path.suffix == ".png":
        values = decode_image(path)
        if values.dtype != np.uint16:
            raise InputError(f"{name}: a KITTI map has 16 bits, this one is {values.dtype}")
        if not values.any():
            raise InputError(f"{name}: every value is 0, which means no estimate")
    else:
        values = read_pfm(path)
        if not (np.isfinite(values) & (values >= 0)).all():
            raise InputError(f"{name}: has values that are negative or not finite")
    if values.shape != size:
        raise InputError(f"{name}: shape is {values.shape}, its left view has {size}")


def _check_runtime(folder: Path, name: str, label: str) -> None:
    text = (folder / name).read_text().strip()
    number = re.fullmatch(re.escape(label) + r"(\d+\.?\d*([eE][+-]?\d+)?)", text)
    if number is None or not 0 < float(number[1]) < math.inf:
        raise InputError(f"{name}: must hold '{label}SECONDS', got {text[:40]!r}")
