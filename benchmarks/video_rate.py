"""Frames per second of ``msnet video`` on a bag of 640 x 400, with each quality level.

    python benchmarks/video_rate.py [--frames 30] [--qualities fast balanced best] [-o rates.json]
        [--bag run.mcap] [OPTION OF MSNET VIDEO ...]

The bag (ROS 2, rectified, calibrated) has the demo pair at the size of an OAK camera, of which
each frame is a part that moves by 2 px. Each level runs ``msnet video`` once in a process of its
own, which writes disparities and depths to a folder; the rate is the one that it prints: from the
first frame to the last file, without the start of the program. Further options, such as
``--precision fp32 --threads 1 --runtime openvino``, go to the command. ``--bag`` keeps the bag.
Needs the extras bags and demo.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from mobilestereonet.data.images import to_picture
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.data.sample import Calibration
from mobilestereonet.inference import QUALITIES
from mobilestereonet.streams.bag_file import RectifiedBag
from mobilestereonet.streams.stereo_bag import BagPair

WIDTH, HEIGHT = 640, 400
STEP_PX = 2
FRAMES_PER_SECOND = 10
TOPICS = ("/stereo/left/image_rect", "/stereo/right/image_rect")


def write_bag(path: Path, frames: int) -> None:
    """Write a bag whose frames are parts of the demo pair, each further to the right."""
    views, calibration = demo_pair(WIDTH + STEP_PX * (frames - 1))
    with RectifiedBag(path, TOPICS) as bag:
        for index in range(frames):
            first = STEP_PX * index
            parts = [np.ascontiguousarray(view[:, first : first + WIDTH]) for view in views]
            stamp = 10**18 + index * 10**9 // FRAMES_PER_SECOND
            pair = BagPair(index, stamp / 1e9, (stamp, stamp), ("left", "right"), None)
            bag.write(pair, parts, calibration)


def demo_pair(width: int) -> tuple[list[NDArray[Any]], Calibration]:
    """The demo pair, at least as wide and cut to the height, and the first part's geometry."""
    sample = motorcycle()
    assert sample.calibration is not None
    pictures = [to_picture(view) for view in (sample.left, sample.right)]
    height, given = pictures[0].shape[:2]
    scale = max(width / given, HEIGHT / height)
    size = (round(scale * given), round(scale * height))
    views = [cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in pictures]
    known = replace(sample.calibration, size=(given, height)).resized(size)
    top = (size[1] - HEIGHT) // 2
    _, row = known.principal_point(*size)
    part = replace(known, cy=row - top, size=(WIDTH, HEIGHT))
    return [view[top : top + HEIGHT] for view in views], part


def measure(bag: Path, quality: str, options: list[str]) -> dict[str, Any]:
    """Run the command once; gives what it prints."""
    command = [sys.executable, "-m", "mobilestereonet", "video", str(bag), *options]
    command += ["--left", TOPICS[0], "--right", TOPICS[1], "--quality", quality]
    with TemporaryDirectory() as folder:
        started = time.perf_counter()
        done = subprocess.run(
            [*command, "--frames", folder], capture_output=True, text=True, check=False
        )
        wall = time.perf_counter() - started
    told = re.search(r"(\d+) frames, ([\d.]+) per second, (.*)", done.stdout)
    if done.returncode or told is None:
        raise SystemExit(f"{' '.join(command)}: {done.stdout}{done.stderr}")
    return {
        "quality": quality,
        "frames": int(told[1]),
        "frames_per_second": float(told[2]),
        "matcher": told[3],
        "seconds_with_start": round(wall, 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--qualities", nargs="+", default=list(QUALITIES), choices=QUALITIES)
    parser.add_argument("--bag", type=Path, help="file to keep the bag in (.mcap or .bag)")
    parser.add_argument("-o", "--output", type=Path, help="file for the figures (JSON)")
    arguments, options = parser.parse_known_args()

    with TemporaryDirectory() as folder:
        bag = arguments.bag or Path(folder) / "run.mcap"
        write_bag(bag, arguments.frames)
        rows = [measure(bag, quality, options) for quality in arguments.qualities]

    table = Table("quality", "frames per second", "frames", "matcher")
    for row in rows:
        rate = f"{row['frames_per_second']:.2f}"
        table.add_row(row["quality"], rate, str(row["frames"]), row["matcher"])
    Console(width=120).print(table)
    if arguments.output:
        machine = {"machine": platform.machine(), "cores": os.cpu_count(), "options": options}
        record = {"size": [WIDTH, HEIGHT], **machine, "rows": rows}
        arguments.output.write_text(json.dumps(record, indent=1), "utf-8")


if __name__ == "__main__":
    main()
