import numpy as np
import pytest
import torch
from fake_engines import FakeEngine

from mobilestereonet import InputError, StereoMatcher, create_model
from mobilestereonet.inference.consistency import occluded_pixels
from mobilestereonet.nets.model import Prediction


def test_a_box_before_a_wall():
    # A wall at 2 px and before it, in left columns 10 to 14, a box at 6 px: in the right view it
    # covers columns 4 to 8. The wall's left columns 6 to 9 would lie there: hidden. The wall's
    # columns 0 and 1 lie beyond the right view's border.
    left = np.full((3, 24), 2, np.float32)
    left[:, 10:15] = 6
    right = np.full((3, 24), 2, np.float32)
    right[:, 4:9] = 6
    hidden = np.zeros((3, 24), bool)
    hidden[:, [0, 1, 6, 7, 8, 9]] = True
    maps = (torch.from_numpy(map_).expand(2, -1, -1) for map_ in (left, right))
    for found in occluded_pixels(*maps):
        np.testing.assert_array_equal(found, hidden)


def test_small_differences_agree_and_unknown_does_not():
    left, right = torch.zeros(2, 2, 8)
    right[:] = 0.9
    assert not occluded_pixels(left, right).any()
    right[:] = 1.1
    assert occluded_pixels(left, right).all()
    left[0, 3] = torch.inf
    left[0, 4] = torch.nan
    right[:] = 0
    assert occluded_pixels(left, right).nonzero().tolist() == [[0, 3], [0, 4]]


class Bright(FakeEngine):
    """An engine that knows the truth: a pixel's disparity is ten times its brightness."""

    name = "bright"

    def __call__(self, left, right, confidence=False):
        return Prediction((10 * left.mean(dim=1)).round())


def test_matcher_gives_the_right_view_and_the_check():
    right = np.full((4, 24), 0.2, np.float32)
    right[:, 4:9] = 0.6
    left = np.full((4, 24), 0.2, np.float32)
    left[:, 10:15] = 0.6
    result = StereoMatcher(Bright(), left_right=True)(left, right)
    np.testing.assert_array_equal(result.disparity, 10 * left)
    np.testing.assert_array_equal(result.right_disparity, 10 * right)
    assert result.occluded.any(axis=0).nonzero()[0].tolist() == [0, 1, 6, 7, 8, 9]
    plain = StereoMatcher(Bright())(left, right)
    assert plain.right_disparity is plain.occluded is plain.confidence is None


class Sure(Bright):
    """It is as sure as the right view is bright."""

    has_confidence = True

    def __call__(self, left, right, confidence=False):
        found = super().__call__(left, right)
        return Prediction(found.disparity, right.mean(dim=1)) if confidence else found


def test_matcher_gives_the_confidence_whole_and_in_tiles():
    left, right = np.random.default_rng(0).random((2, 460, 620), dtype=np.float32)
    for tile in (None, (400, 416)):
        result = StereoMatcher(Sure(), confidence=True, tile=tile)(left, right)
        np.testing.assert_allclose(result.confidence, right, atol=1e-6)
        np.testing.assert_allclose(result.disparity, (10 * left).round(), atol=1e-5)
    with pytest.raises(InputError, match="bright has no confidence"):
        StereoMatcher(Bright(), confidence=True)


def test_the_network_gives_both_at_once():
    torch.manual_seed(0)
    net = create_model("msnet2d", max_disparity=32)
    matcher = StereoMatcher(net, confidence=True, left_right=True)
    left, right = np.random.default_rng(0).random((2, 30, 50), dtype=np.float32)
    result = matcher(left, right)
    views = torch.from_numpy(left).expand(1, 3, -1, -1), torch.from_numpy(right)
    expected = matcher.disparity(views[0], views[1].expand(1, 3, -1, -1))[0].numpy()
    np.testing.assert_allclose(result.disparity, expected, rtol=0, atol=1e-4)
    assert result.confidence.shape == (30, 50)
    assert 0 <= result.confidence.min() < result.confidence.max() <= 1
