"""False alarms of the first look at pairs that are right, and its time.

python benchmarks/first_look.py --shared shared/data --scenes 40
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from mobilestereonet.data import StereoSample, open_data_set
from mobilestereonet.data.images import to_picture
from mobilestereonet.inference import load_pair
from mobilestereonet.inference.first_look import first_look
from mobilestereonet.scenes import ProceduralScenes, SceneConfig

SETS = {
    "eth3d": ("eth3d", {}),
    "kitti2015": ("kitti2015", {}),
    "middeval3": ("middeval3", {}),
    "middlebury2003": ("middlebury2003", {}),
    "middlebury2005": ("middlebury2005", {}),
    "sceneflow": ("sceneflow", {"split": "test", "render": "cleanpass"}),
}
"""Folders below the shared data, their data sets and options."""


def pairs(shared: Path, scenes: int) -> Iterator[tuple[str, StereoSample]]:
    for folder, (name, options) in SETS.items():
        if (shared / folder).is_dir():
            data = open_data_set(name, shared / folder, **options)
            yield from ((folder, data[index]) for index in range(len(data)))
    procedural = ProceduralScenes(SceneConfig())
    yield from (("procedural", procedural[index]) for index in range(scenes))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shared", type=Path, default=Path("shared/data"))
    parser.add_argument("--scenes", type=int, default=40)
    options = parser.parse_args()
    seconds, alarms, count = [], Counter[str](), Counter[str]()
    for source, sample in pairs(options.shared, options.scenes):
        pair = load_pair(to_picture(sample.left), to_picture(sample.right))
        started = time.process_time()
        _, findings = first_look(pair)
        seconds.append(time.process_time() - started)
        count[source] += 1
        for finding in findings:
            if finding.level not in ("good", "unknown"):
                alarms[f"{source}: {finding.level} {finding.check}"] += 1
                print(f"{source} {sample.name}: {finding.level} {finding}")
            elif finding.level == "unknown":
                alarms[f"{source}: unknown"] += 1
    print(dict(count), dict(alarms))
    print(f"{median(seconds):.3f} s median, {max(seconds):.3f} s at most (processor time)")


if __name__ == "__main__":
    main()
