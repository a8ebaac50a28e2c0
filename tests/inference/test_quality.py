"""Quality levels: what they choose, and what is refused beside them."""

import time

import numpy as np
import pytest

from mobilestereonet import InputError, StereoMatcher
from mobilestereonet.cli.early import QUALITIES as NAMES
from mobilestereonet.data import write_png
from mobilestereonet.engines.scaled import ScaledEngine
from mobilestereonet.inference import DEFAULT_QUALITY, QUALITIES, Quality
from mobilestereonet.inference.rate import choose_quality


def test_the_command_line_knows_the_names():
    assert tuple(QUALITIES) == NAMES


@pytest.mark.parametrize("name", QUALITIES)
def test_a_level_is_a_network_with_its_settings(name):
    matcher = StereoMatcher.from_pretrained(quality=name)
    level = QUALITIES[name]
    assert matcher.quality == name and matcher.model == level.model
    for key, value in level.config.items():
        assert getattr(matcher._net.config, key) == value
    assert isinstance(matcher.engine, ScaledEngine) == (level.scale != 1)
    views = np.random.default_rng(0).integers(0, 255, (2, 40, 70, 3), np.uint8)
    result = matcher(*views)
    assert result.disparity.shape == (40, 70)
    size = "" if level.scale == 1 else f"at {level.scale:g} of the size "
    assert str(result.info).startswith(f"{name} ({level.model}) {size}on torch fp32")


def test_levels_that_are_the_same_are_measured_once():
    opened = []

    def open_level(*choice):
        opened.append(choice)
        return Paced(0.001)

    choose_quality(None, 1e6, open_level)
    assert len({QUALITIES[name] for name, scale in opened if scale is None}) == len(opened) - 2


def test_a_level_with_other_settings_is_none():
    matcher = StereoMatcher.from_pretrained(quality="best", max_disparity=64)
    assert matcher.quality is None
    smaller = StereoMatcher.from_pretrained(quality="best", scale=0.5)
    views = np.random.default_rng(0).integers(0, 255, (2, 40, 70, 3), np.uint8)
    assert str(smaller(*views).info).startswith("msnet3d at 0.5 of the size on torch fp32")
    assert smaller.summary == "msnet3d at 0.5 of the size on torch fp32"


@pytest.mark.parametrize("scale", [0.1, "0.5", True])
def test_refused_scales(scale):
    with pytest.raises(InputError, match=r"scale must be .*in 0\.25\.\.1, got"):
        StereoMatcher.from_pretrained("msnet2d", scale=scale)
    with pytest.raises(InputError, match=r"padding to .* and a scale of 0\.5: choose one"):
        StereoMatcher.from_pretrained("msnet2d", scale=0.5, padding=(64, 96))
    with pytest.raises(InputError, match=r"a scale of 0\.75: .* \(the quality fast has a scale\)"):
        StereoMatcher.from_pretrained(quality="fast", padding=(64, 96))


def test_the_default_is_balanced_and_a_source_has_no_quality():
    assert StereoMatcher.from_pretrained().quality == DEFAULT_QUALITY == "balanced"
    assert StereoMatcher.from_pretrained("msnet2d").quality is None


def test_refused():
    with pytest.raises(InputError, match="quality must be one of fast, balanced, best, got 'good'"):
        StereoMatcher.from_pretrained(quality="good")
    with pytest.raises(InputError, match=r"quality='best' chooses a network .* so does msnet2d"):
        StereoMatcher.from_pretrained("msnet2d", quality="best")


def test_the_command_refuses_both(msnet):
    for option in (("--model", "msnet2d"), ("--weights", "tests/conftest.py")):
        code, _, error = msnet("demo", "--quality", "fast", *option)
        assert code == 2
        assert f"--quality fast chooses a network and its weights, and so does {option[0]}" in error
    code, _, error = msnet("demo", "--quality", "fats")
    assert code == 2 and "did you mean fast?" in error


def test_the_range_of_disparities_is_chosen_when_it_runs(msnet, tmp_path):
    pair = [tmp_path / "left.png", tmp_path / "right.png"]
    views = np.random.default_rng(0).integers(0, 255, (2, 32, 64, 3), np.uint8)
    for path, view in zip(pair, views, strict=True):
        write_png(path, view)
    arguments = ("predict", *pair, "-o", tmp_path / "out")
    for options in (("--quality", "best"), ("--model", "sgbm")):
        code, _, error = msnet(*arguments, *options, "--max-disparity", 64)
        assert code == 0, error
    code, _, error = msnet(*arguments, "--model", "msnet2d", "--max-disparity", 64)
    assert code == 2 and "with max_disparity=64: leave out what these weights" in error


class Paced:
    """A matcher that takes a given time."""

    def __init__(self, seconds):
        self.seconds = seconds

    def match(self, pair):
        time.sleep(self.seconds)


@pytest.mark.parametrize(
    ("hz", "expected"),
    [(1, ("best", None)), (30, ("balanced", None)), (300, ("fast", 0.5)), (1e6, ("fast", 0.35))],
)
def test_the_best_level_that_keeps_up_with_a_rate(hz, expected, monkeypatch):
    levels = {name: Quality(f"network-{name}") for name in QUALITIES}
    monkeypatch.setattr("mobilestereonet.inference.rate.QUALITIES", levels)
    times = {("best", None): 0.1, ("balanced", None): 0.01, ("fast", None): 0.02}
    opened = []

    def open_level(*choice):
        opened.append(choice)
        return Paced(times.get(choice, 0.0005))

    seconds = choose_quality(None, hz, open_level)[1]
    assert opened[-1] == expected
    assert seconds >= times.get(expected, 0.0005)
