import numpy as np
import pytest
import torch
import torch.nn.functional as F
from fake_engines import FakeEngine

from mobilestereonet import InputError, StereoMatcher
from mobilestereonet.inference import predict
from mobilestereonet.inference.tiling import BLEND_PX, CONTEXT_PX
from mobilestereonet.nets.model import Prediction

RANGE = 40


class Field(FakeEngine):
    """An engine that looks exactly as far as the margins allow, on a grid of 16 px.

    Each block of 16 x 16 px gets the mean of the left view over the blocks up to `CONTEXT_PX` px
    around, and the right view's block that lies 48 px, the range on the grid, beyond that to the
    left.
    """

    size_multiple = 16
    max_disparity = RANGE

    def __init__(self):
        self.sizes = []

    def __call__(self, left, right, confidence=False):
        assert left.shape == right.shape
        self.sizes.append(tuple(left.shape[-2:]))
        left, right = (F.avg_pool2d(view.mean(1, keepdim=True), 16) for view in (left, right))
        around = CONTEXT_PX // 16
        left = F.avg_pool2d(F.pad(left, [around] * 4), 2 * around + 1, stride=1)
        shift = around + 48 // 16
        right = F.pad(right, (shift, 0))[..., : right.shape[-1]]
        blocks = (left + right).squeeze(1)
        return Prediction(blocks.repeat_interleave(16, dim=1).repeat_interleave(16, dim=2))


class Constants(FakeEngine):
    """An engine that gives another constant at each call."""

    size_multiple = 16
    max_disparity = RANGE

    def __init__(self):
        self.calls = 0

    def __call__(self, left, right, confidence=False):
        self.calls += 1
        return Prediction(torch.full((len(left), *left.shape[-2:]), float(self.calls % 2)))


def random_views(height, width, batch=1):
    return torch.rand(2, batch, 3, height, width, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("size", "tile"),
    [
        ((900, 1200), (448, 528)),
        ((901, 1203), (448, 528)),  # padded above and on the right
        ((907, 450), (458, 538)),  # one column of tiles; a tile off the grid is rounded down
        ((100, 1203), (448, 528)),  # one row of tiles
        ((100, 120), (448, 528)),  # a single tile
    ],
)
def test_tiles_give_what_the_whole_gives_if_the_engine_sees_no_farther(size, tile):
    left, right = random_views(*size, batch=2)
    whole, tiled = Field(), Field()
    expected = StereoMatcher(whole, tile=None).disparity(left, right)
    result = StereoMatcher(tiled, tile=tile).disparity(left, right)
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-6)
    assert len(whole.sizes) == 1
    # One size that never exceeds the tile: what an engine of fixed size and bounded memory needs.
    assert len(set(tiled.sizes)) == 1
    height, width = tiled.sizes[0]
    assert height <= tile[0] // 16 * 16 and width <= tile[1] // 16 * 16


def test_a_smaller_margin_would_be_seen():
    left, right = random_views(900, 1200)
    engine = Field()
    expected = StereoMatcher(engine, tile=None).disparity(left, right)
    engine.max_disparity = 1  # the truth is 48
    result = StereoMatcher(engine, tile=(448, 528)).disparity(left, right)
    assert (result - expected).abs().max() > 1e-3


def test_a_disagreement_fades_over_the_blend():
    left, right = random_views(900, 1200)
    result = StereoMatcher(Constants(), tile=(448, 528)).disparity(left, right)[0]
    assert result.min() == 0
    assert result.max() == 1
    # A smooth step over n px is nowhere steeper than 1.5 / n; rows and columns of tiles meet.
    for steps in (result.diff(dim=0), result.diff(dim=1)):
        assert steps.abs().max() < 2 * 1.5 / BLEND_PX


def test_large_pairs_are_tiled_by_default(monkeypatch):
    monkeypatch.setattr(predict, "MAX_UNTILED_PIXELS", 600 * 640)
    monkeypatch.setattr(predict, "TILE_SIZE", (448, 608))
    engine = Field()
    StereoMatcher(engine).disparity(*random_views(600, 640))
    assert engine.sizes == [(608, 640)]
    result = StereoMatcher(engine)(*np.zeros((2, 601, 640), np.uint8))
    assert engine.sizes[1:] == [(448, 608)] * len(engine.sizes[1:])
    assert len(engine.sizes) > 3
    assert result.disparity.shape == (601, 640)
    engine.sizes.clear()
    StereoMatcher(engine, tile=None).disparity(*random_views(601, 640))
    StereoMatcher(engine, padding=(640, 656)).disparity(*random_views(601, 640))
    assert engine.sizes == [(608, 640), (640, 656)]


def test_refused():
    views = random_views(900, 1200)
    with pytest.raises(InputError, match="height 384 are too small: the margins need 384 px"):
        StereoMatcher(Field(), tile=(384, 608)).disparity(*views)
    with pytest.raises(InputError, match="width 432 are too small: the margins need 432 px"):
        StereoMatcher(Field(), tile=(448, 438)).disparity(*views)
    with pytest.raises(InputError, match=r"tiles of \(448, 528\) and padding to \(640, 960\)"):
        StereoMatcher(Field(), tile=(448, 528), padding=(640, 960))
