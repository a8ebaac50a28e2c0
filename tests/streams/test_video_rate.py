"""The script `benchmarks/video_rate.py`: its bag, and what it writes."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from extras import need_extra
from mobilestereonet.streams import open_stream

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def video_rate(monkeypatch):
    need_extra("rosbags")
    monkeypatch.syspath_prepend(BENCHMARKS)
    import video_rate

    return video_rate


def test_the_bag_and_the_figures(video_rate, monkeypatch, tmp_path):
    bag, figures = tmp_path / "run.mcap", tmp_path / "rates.json"
    given = []

    def measure(bag, quality, options):
        given.append((quality, options))
        matcher = {"matcher": f"{quality} on torch fp32", "frames": 3}
        return {"quality": quality, "frames_per_second": 2.5, **matcher}

    monkeypatch.setattr(video_rate, "measure", measure)
    words = "--frames", 3, "--bag", bag, "-o", figures, "--threads", 1
    monkeypatch.setattr(sys, "argv", ["video_rate", *map(str, words)])
    video_rate.main()
    left, right = video_rate.TOPICS
    stream = open_stream(str(bag), left_topic=left, right_topic=right)
    assert stream.calibration.size == (640, 400)
    frames = list(stream.frames)
    assert [frame.seconds for frame in frames] == pytest.approx([0, 0.1, 0.2])
    first, second = (frame.pair.right_image for frame in frames[:2])
    np.testing.assert_array_equal(first[:, 2:], second[:, :-2])
    assert given == [(name, ["--threads", "1"]) for name in ("fast", "balanced", "best")]
    record = json.loads(figures.read_text())
    assert [row["frames_per_second"] for row in record["rows"]] == [2.5] * 3
