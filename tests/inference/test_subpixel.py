"""Sub-pixel refinement, on textures whose disparity is known to any fraction."""

import numpy as np
import pytest
import torch
from fake_engines import FakeEngine

from mobilestereonet.inference import StereoMatcher
from mobilestereonet.inference.subpixel import MAX_SHIFT_PX, WINDOW_PX, fit_subpixel
from mobilestereonet.nets.model import Prediction

HEIGHT, WIDTH = 60, 120


def texture(column, seed=0):
    """RGB (3, H, W) in 0..1 at any columns (H, W), each row's own: waves of 5 to 40 px."""
    rng = np.random.default_rng(seed)
    row = torch.arange(column.shape[0])[:, None]
    waves = zip(
        2 * np.pi / rng.uniform(5, 40, 12),
        rng.uniform(-0.5, 0.5, 12),
        rng.uniform(0, 2 * np.pi, 12),
        strict=True,
    )
    grey = sum(torch.sin(x * column + y * row + phase) for x, y, phase in waves) / 24 + 0.5
    return grey.float().expand(3, *column.shape)


def pair(truth, **options):
    """Views (1, 3, H, W) of a surface; its right view's columns are x - d, d linear along rows."""
    column = torch.arange(truth.shape[1], dtype=torch.float64).expand(truth.shape)
    slope = (truth[:, -1:] - truth[:, :1]) / (truth.shape[1] - 1)
    left_column = (column + truth[:, :1]) / (1 - slope)  # the left pixel of each right one
    return texture(column, **options)[None], texture(left_column, **options)[None]


def surface(first, last=None):
    last = first if last is None else last
    return torch.linspace(first, last, WIDTH, dtype=torch.float64).expand(HEIGHT, WIDTH)


def errors(found, truth):
    """Absolute errors where the whole window has its match."""
    return (found[0] - truth)[:, int(truth.max()) + WINDOW_PX : -WINDOW_PX].abs()


@pytest.mark.parametrize("offset", [-0.7, -0.2, 0.3, 0.7])
@pytest.mark.parametrize("truth", [surface(10.0), surface(7.3), surface(8.0, 14.0)])
def test_a_shift_is_found_to_a_few_hundredths_of_a_pixel(truth, offset):
    found = fit_subpixel((truth + offset).float()[None], *pair(truth))
    assert errors(found, truth).mean() < 0.03
    assert errors(found, truth).max() < 0.1


def test_brightness_and_contrast_of_one_view_do_not_matter():
    truth = surface(9.6)
    left, right = pair(truth)
    found = fit_subpixel((truth + 0.4).float()[None], left, 0.4 * right + 0.3)
    assert errors(found, truth).mean() < 0.03


def test_disparities_drawn_towards_planes_come_free_of_them():
    truth = surface(8.0, 20.0)
    locked = truth + 0.3 * torch.sin(2 * np.pi * truth / 4)
    found = fit_subpixel(locked.float()[None], *pair(truth))
    assert errors(found, truth).mean() < errors(locked[None], truth).mean() / 3


def test_what_has_no_texture_stays():
    disparity = 20 * torch.rand(1, HEIGHT, WIDTH)
    left, right = torch.full((1, 3, HEIGHT, WIDTH), 0.6), torch.full((1, 3, HEIGHT, WIDTH), 0.4)
    assert torch.allclose(fit_subpixel(disparity, left, right), disparity, atol=1e-4)


def test_pixels_that_do_not_match_hardly_count():
    truth = surface(10.0)
    left, right = pair(truth)
    post = (torch.arange(WIDTH) - 61).abs() < 2  # the right view lacks it
    left = torch.where(post, pair(truth, seed=1)[0], left)
    found = fit_subpixel((truth + 0.4).float()[None], left, right)
    assert errors(found, truth).mean() < 0.05


def test_no_disparity_changes_by_more_than_the_largest_shift():
    truth = surface(10.0)
    (left, _), (_, other) = pair(truth), pair(truth, seed=1)
    moved = fit_subpixel(truth.float()[None], left, other) - truth
    assert 0.5 < moved.abs().max() <= MAX_SHIFT_PX + 1e-5


def test_what_lies_beyond_the_right_views_border_says_nothing():
    truth = surface(50.0)
    disparity = (truth + 0.4).float()[None]
    found = fit_subpixel(disparity, *pair(truth))
    assert torch.equal(found[..., :32], disparity[..., :32])
    assert errors(found, truth).mean() < 0.03


def test_unknown_disparities_stay_and_spoil_no_others():
    truth = surface(10.0)
    disparity = (truth + 0.4).float()[None]
    disparity[0, 30, 60] = torch.nan
    found = fit_subpixel(disparity, *pair(truth))
    assert found[0, 30, 60].isnan() and found.isnan().sum() == 1
    assert errors(found, truth)[10].max() < 0.15


@pytest.mark.parametrize("size", [(2, 2), (3, 5), (13, 30)])
def test_small_and_odd_sizes(size):
    found = fit_subpixel(torch.ones(2, *size), torch.rand(2, 3, *size), torch.rand(2, 3, *size))
    assert found.shape == (2, *size) and found.isfinite().all()


def test_batches_are_pairs_one_by_one(device):
    torch.manual_seed(0)
    maps = [torch.rand(2, *size, 30, 80, device=device) for size in ((), (3,), (3,))]
    both = fit_subpixel(*maps)
    for index in range(2):
        alone = fit_subpixel(*(map_[index : index + 1] for map_ in maps))
        assert torch.allclose(both[index], alone[0], atol=1e-5)
    assert not torch.equal(both, maps[0])


def test_nothing_leaves_the_device():
    maps = (torch.rand(2, *size, 24, 80, device="meta") for size in ((), (3,), (3,)))
    assert fit_subpixel(*maps).shape == (2, 24, 80)


class Nearly(FakeEngine):
    """Disparity 10.4 px everywhere, and sure of it."""

    has_confidence = True

    def __call__(self, left, right, confidence):
        disparity = torch.full_like(left[:, 0], 10.4)
        return Prediction(disparity, torch.ones_like(disparity) if confidence else None)


def test_a_refining_matcher_fits():
    left, right = pair(surface(10.0))
    refined = StereoMatcher(Nearly(), refine=True).disparity(left, right)
    assert errors(refined, surface(10.0)).mean() < 0.03
    plain = StereoMatcher(Nearly(), refine=False).disparity(left, right)
    assert (plain == 10.4).all()


def test_nothing_is_farther_than_infinity():
    truth = surface(0.0)
    left, right = pair(surface(-0.8))  # rectified with an error of a pixel
    found = fit_subpixel((truth + 0.2).float()[None], left, right)
    assert (found >= 0).all()
    assert found.median() == 0
