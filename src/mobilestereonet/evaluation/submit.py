"""Submission archives for the benchmarks' servers: writing and checking."""

from __future__ import annotations

import math
import re
import shutil
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.disparity_files import write_disparity_png
from mobilestereonet.data.files import read_pfm, visible, write_pfm
from mobilestereonet.data.image_files import decode_image
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation.benchmarks import Submission
from mobilestereonet.evaluation.matching import DisparityFn, timed_match


def write_submission(
    plan: Submission, match: DisparityFn, data: Iterable[StereoSample], archive: Path
) -> None:
    """Match every scene of a benchmark and write the archive for its server, checked.

    Args:
        plan: File names that the server takes.
        match: Matcher to submit. It is called once more in the beginning, so that no scene's time
            includes what only the first call does.
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
            for path in sorted(path for path in visible(folder, "**/*") if path.is_file()):
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
        plan: File names that the server takes.
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
