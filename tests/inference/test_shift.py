"""Disparities beyond the range that is searched, and negative ones."""

import re

import cv2
import numpy as np
import pytest
import torch

from mobilestereonet import InputError, StereoMatcher
from mobilestereonet.inference import checks
from mobilestereonet.inference.predict import shifted

SCENE = cv2.GaussianBlur(
    np.random.default_rng(0).integers(0, 256, (40, 300, 3), dtype=np.uint8), (3, 3), 0
)


def views(disparity, width=160):
    """Views of a plane: left pixel x matches right pixel x - disparity."""
    left = SCENE[:, 70 : 70 + width]
    return left, SCENE[:, 70 + disparity : 70 + disparity + width]


def middle(map_):
    return map_[8:-8, 70:-40]


@pytest.mark.parametrize(
    ("disparity", "shift"), [(9, 0), (50, 44), (50, 50), (-20, -28), (3, -5), (-6, -6)]
)
@pytest.mark.parametrize("left_right", [False, True])
def test_the_search_begins_at_the_shift(disparity, shift, left_right):
    matcher = StereoMatcher.from_pretrained(
        "sgbm", max_disparity=16, shift=shift, left_right=left_right
    )
    result = matcher(*views(disparity))
    assert np.median(middle(result.disparity)) == pytest.approx(disparity, abs=0.1)
    assert matcher.max_disparity == 16 + shift
    assert result.info.shift == shift
    assert ("shifted" in matcher.summary, "shifted" in str(result.info)) == (bool(shift),) * 2
    if left_right:
        assert np.median(middle(result.right_disparity)) == pytest.approx(disparity, abs=0.1)
        assert middle(result.occluded).mean() < 0.05


def test_tensors_are_shifted_too():
    matcher = StereoMatcher.from_pretrained("sgbm", max_disparity=16, shift=40, scale=0.5)
    tensors = [torch.from_numpy(view.copy()).permute(2, 0, 1)[None] / 255 for view in views(50)]
    found = matcher.infer(*tensors).disparity[0].numpy()
    assert np.median(middle(found)) == pytest.approx(50, abs=0.5)


def test_borders_are_repeated():
    view = torch.arange(5.0)[None, None]
    assert shifted(view, 2).tolist() == [[[0, 0, 0, 1, 2]]]
    assert shifted(view, -2).tolist() == [[[2, 3, 4, 4, 4]]]
    assert shifted(view, 0).tolist() == view.tolist()


@pytest.mark.parametrize("shift", [1.5, True, "3"])
def test_what_is_no_shift(shift):
    with pytest.raises(InputError, match="shift must be a whole number"):
        StereoMatcher.from_pretrained("sgbm", shift=shift)


def test_a_shift_wider_than_the_views():
    with pytest.raises(InputError, match="moves views of 160 px width out of sight"):
        StereoMatcher.from_pretrained("sgbm", max_disparity=16, shift=-160)(*views(0))


def test_the_command_line(msnet, tmp_path):
    for name, view in zip(("left", "right"), views(50), strict=True):
        assert cv2.imwrite(str(tmp_path / f"{name}.png"), view)
    pair = tmp_path / "left.png", tmp_path / "right.png"
    options = "--model", "sgbm", "--max-disparity", 16, "--shift", 44
    code, out, _ = msnet("predict", *pair, "-o", tmp_path / "out", *options)
    assert code == 0
    assert out.startswith("sgbm shifted by 44 px on sgbm int16, 160x40")
    found = middle(cv2.imread(str(tmp_path / "out/left_disparity.png"), -1)) / 256
    assert np.median(found) == pytest.approx(50, abs=0.1)
    scaled = "--model", "sgbm", "--max-disparity", 32, "--scale", 0.5
    code, out, _ = msnet("predict", *pair, "-o", tmp_path / "out", *scaled)
    assert out.startswith("sgbm at 0.5 of the size on sgbm")
    found = middle(cv2.imread(str(tmp_path / "out/left_disparity.png"), -1)) / 256
    assert np.median(found) == pytest.approx(50, abs=0.5)


@pytest.mark.parametrize(
    ("low", "high", "options"),
    [(20, 300, "--scale 0.58"), (150, 300, "--scale 0.58 --shift 143"), (9, 900, "")],
)
def test_doctor_tells_the_number_to_use(low, high, options):
    disparity = np.linspace(low, high, 1001)
    advice = checks._range(disparity, checks.Search(192)).advice
    assert " ".join(re.findall(r"--\w+ [\d.]+\d", advice)) == options
    assert ("make both views smaller" in advice) == (not options)


def test_doctor_tells_where_converging_cameras_begin():
    disparity = np.concatenate((np.linspace(-20, -1, 50), np.linspace(0, 60, 200)))
    finding = checks._order(disparity, lowest=0)
    assert (finding.check, finding.level) == ("order", "problem")
    assert "--shift -28" in finding.advice
