from dataclasses import replace

import numpy as np
import pytest
import torch

from mobilestereonet.data.augment import AugmentConfig, augment
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.errors import InputError

EVERYTHING = AugmentConfig(
    height=48,
    width=64,
    scale=(-0.3, 0.4),
    vertical_shift=1.0,
    rotation=0.5,
    exposure=(0.25, 0.55),
    brightness=0.2,
    contrast=0.3,
    saturation=0.5,
    hue=0.3,
    gamma=0.4,
    view_change=0.3,
    grey=0.3,
    vignette=0.2,
    blur=1.0,
    blur_probability=0.5,
    noise=0.05,
    patch_probability=0.5,
    patch=(5, 20),
)
PLAIN = AugmentConfig()


def _generators(*seeds: int) -> list[np.random.Generator]:
    return [np.random.default_rng(seed) for seed in seeds]


def _texture(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """A smooth texture, known at every real position: (3, ...) in 0..1."""
    waves = [(0.21, 0.13), (0.34, -0.22), (-0.13, 0.29)]
    return torch.stack([0.5 + 0.45 * torch.sin(a * x + b * y + a) for a, b in waves])


def _plane(height: int = 96, width: int = 160) -> StereoSample:
    """A slanted plane, exact at every pixel."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x, y = x.double(), y.double()
    disparity = 12 + 0.05 * x + 0.2 * y
    return StereoSample(
        left=_texture(x - disparity, y).float(),
        right=_texture(x, y).float(),
        disparity=disparity.float(),
        valid=torch.ones(height, width, dtype=torch.bool),
        occluded=x < disparity,
        name="plane",
    )


def _random(seed: int, height: int = 64, width: int = 96) -> StereoSample:
    generator = torch.Generator().manual_seed(seed)
    images = torch.rand(2, 3, height, width, generator=generator)
    valid = torch.rand(height, width, generator=generator) > 0.2
    disparity = torch.rand(height, width, generator=generator) * 40 * valid
    return StereoSample(images[0], images[1], disparity, valid, name=f"pair {seed}")


def _sample_columns(image: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Values of (C, H, W) at real columns x (H, W) of each row."""
    left = x.floor().long().clamp(0, image.shape[-1] - 2)
    share = (x - left)[None]
    index = left[None].expand(len(image), -1, -1)
    return image.gather(2, index) * (1 - share) + image.gather(2, index + 1) * share


def test_default_changes_nothing():
    pairs = [_random(1), _random(2)]
    sample = collate(pairs)
    result = augment(pairs, PLAIN, _generators(1, 2))
    for name in ("left", "right", "disparity", "valid"):
        assert torch.equal(getattr(result, name), getattr(sample, name)), name


def test_crop_is_joint_and_anywhere():
    height, width = 10, 14
    place = torch.arange(height * width, dtype=torch.float32).view(height, width)
    image = (place / place.max()).expand(3, -1, -1)
    sample = StereoSample(image, image, place, place % 3 == 0, place % 5 == 0)
    seen = set()
    for seed in range(200):
        crop = augment([sample], replace(PLAIN, height=9, width=12), _generators(seed))
        maps = crop.disparity[0]
        assert maps.shape == (9, 12)
        corner = int(maps[0, 0])
        seen.add((corner // width, corner % width))
        assert torch.equal(maps, place[corner // width :, corner % width :][:9, :12])
        assert torch.allclose(crop.left[0, 0] * place.max(), maps)
        assert torch.equal(crop.left, crop.right)
        assert torch.equal(crop.valid[0], maps % 3 == 0)
        assert torch.equal(crop.occluded[0], maps % 5 == 0)
    assert seen == {(top, start) for top in (0, 1) for start in (0, 1, 2)}


def test_crop_larger_than_the_image():
    with pytest.raises(InputError, match="crop 65 x 96 is larger than the image 64 x 96"):
        augment([_random(1)], replace(PLAIN, height=65), _generators(1))


@pytest.mark.parametrize("octaves", [-0.5, 0.5])
def test_scale_keeps_matches(octaves):
    sample = _plane()
    config = replace(PLAIN, height=64, width=100, scale=(octaves, octaves))
    result = augment([sample], config, _generators(3))
    error = (_matched(result) - result.left[0]).abs().mean(0)
    inside = _inside(result)
    assert inside.float().mean() > 0.5
    assert error[inside].max() < 0.03  # half a pixel's shift makes 0.05 on average
    wrong = replace(result, disparity=sample.disparity[None, :64, :100])
    assert (_matched(wrong) - result.left[0]).abs()[:, inside].mean() > 0.1


def _matched(sample: StereoSample) -> torch.Tensor:
    """The right view, seen from the left."""
    x = torch.arange(sample.right.shape[-1]) - sample.disparity[0]
    return _sample_columns(sample.right[0], x)


def _inside(sample: StereoSample) -> torch.Tensor:
    return torch.arange(sample.right.shape[-1]) - sample.disparity[0] > 1


def test_scaled_disparity_is_exact_on_a_plane():
    sample = _plane()
    result = augment([sample], replace(PLAIN, scale=(0.37, 0.37)), _generators(3))
    height, width = result.disparity.shape[-2:]
    assert (height, width) == (round(96 * 2**0.37), round(160 * 2**0.37))
    y = (torch.arange(height) + 0.5) * 96 / height - 0.5
    x = (torch.arange(width) + 0.5) * 160 / width - 0.5
    expected = (12 + 0.05 * x + 0.2 * y[:, None]) * width / 160
    error = (result.disparity[0] - expected)[2:-2, 2:-2].abs()
    assert error.max() < 1e-3


@pytest.mark.parametrize("octaves", [-0.4, 0.4])
def test_stretch_keeps_matches_and_scales_disparity(octaves, monkeypatch):
    sample = _plane()

    class Fixed(np.random.Generator):
        def uniform(self, low=0.0, high=1.0, size=None):
            return octaves if (low, high) == (-0.5, 0.5) else super().uniform(low, high, size)

    config = replace(PLAIN, stretch=0.5, stretch_probability=1.0)
    result = augment([sample], config, [Fixed(np.random.PCG64(1))])
    height, width = result.left.shape[-2:]
    assert width / height / (160 / 96) == pytest.approx(2**octaves, rel=0.02)
    assert width * height == pytest.approx(96 * 160, rel=0.02)
    inside = _inside(result)
    assert (_matched(result) - result.left[0]).abs().mean(0)[inside].max() < 0.03
    # A plane's disparity at a point of the pair, in pixels of the stretched view.
    y = (torch.arange(height) + 0.5) * 96 / height - 0.5
    x = (torch.arange(width) + 0.5) * 160 / width - 0.5
    expected = (12 + 0.05 * x + 0.2 * y[:, None]) * width / 160
    assert (result.disparity[0] - expected)[2:-2, 2:-2].abs().max() < 1e-3


def test_stretch_has_its_range_and_probability():
    place = torch.arange(60 * 90, dtype=torch.float32).view(60, 90)
    pair = StereoSample(place.expand(3, -1, -1) / 5400, torch.zeros(3, 60, 90), name="ramp")
    config = replace(PLAIN, height=30, width=45, stretch=0.2)
    shapes = []
    for seed in range(200):
        view = augment([pair], config, _generators(seed)).left[0, 0] * 5400
        across, down = float(view[15, 30] - view[15, 10]) / 20, float(view[20, 9] - view[10, 9])
        shapes.append(np.log2(down / 10 / 90 / across))
    assert (np.abs(shapes) < 0.02).mean() < 0.45 and np.abs(shapes).max() < 0.26
    assert min(shapes) < -0.1 and max(shapes) > 0.1


def test_scale_mixes_no_surfaces_and_keeps_gaps():
    disparity = torch.full((40, 60), 5.0)
    disparity[:, 30:] = 25.0
    valid = torch.ones(40, 60, dtype=torch.bool)
    valid[10:20, 5:15] = False
    disparity = disparity * valid
    image = torch.rand(3, 40, 60)
    sample = StereoSample(image, image, disparity, valid)
    result = augment([sample], replace(PLAIN, scale=(0.4, 0.4)), _generators(1))
    factor = result.left.shape[-1] / 60
    values = (result.disparity / factor).unique()
    assert torch.allclose(values, torch.tensor([0.0, 5.0, 25.0]), atol=1e-4)
    assert torch.equal(result.disparity > 0, result.valid)
    assert (~result.valid).float().mean().item() == pytest.approx(100 / 2400, rel=0.1)


def test_scale_never_falls_below_the_crop():
    config = replace(PLAIN, height=64, width=80, scale=(-2.0, -2.0))
    result = augment([_random(1)], config, _generators(1))
    assert result.left.shape == (1, 3, 64, 80)


def test_different_scales_need_a_crop():
    pairs = [_random(1), _random(2)]
    with pytest.raises(InputError, match="images of one size"):
        augment(pairs, replace(PLAIN, scale=(-0.5, 0.5)), _generators(1, 2))


@pytest.mark.parametrize(("shift", "rotation"), [(0.0, 3.0), (4.0, 0.0), (3.0, 2.0)])
def test_misaligned_disparity_is_exact(shift, rotation):
    """The right view's colours say which point they show: matches are looked up by them."""
    sample = _plane()
    height, width = sample.left.shape[-2:]
    x = torch.arange(width, dtype=torch.float32).expand(height, -1)
    y = torch.arange(height, dtype=torch.float32)[:, None].expand(-1, width)
    right = torch.stack((x / width, y / height, torch.zeros_like(x)))
    config = replace(PLAIN, vertical_shift=shift, rotation=rotation)
    result = augment([replace(sample, right=right)], config, _generators(5))
    assert torch.equal(result.left[0], sample.left)
    moved = (result.right[0] - right).abs().amax(0) * width
    assert moved[40:60, 60:100].max() > 0.5
    if rotation == 0:
        assert torch.allclose(result.disparity[0], sample.disparity, atol=1e-4)
    seen_x, seen_y = result.right[0, 0] * width, result.right[0, 1] * height
    for row, column in [(30, 60), (40, 90), (48, 130), (60, 80), (66, 120)]:
        before = float(sample.disparity[row, column])
        at = column - float(result.disparity[0, row, column])
        columns = torch.full((height, 1), at)
        points = _sample_columns(torch.stack((seen_x, seen_y)), columns)[..., 0]
        # In this column, the row that shows the match's row must show its column as well.
        below = int((points[1] < row).sum()) - 1
        share = (row - points[1, below]) / (points[1, below + 1] - points[1, below])
        found = points[0, below] + share * (points[0, below + 1] - points[0, below])
        assert found.item() == pytest.approx(column - before, abs=0.01)


def test_pairs_do_not_depend_on_the_batch():
    samples = [_random(seed) for seed in range(6)]
    together = augment(samples, EVERYTHING, _generators(*range(6)))
    for index, sample in enumerate(samples):
        alone = augment([sample], EVERYTHING, _generators(index))
        for name in ("left", "right", "disparity"):
            ours, theirs = getattr(together, name)[index], getattr(alone, name)[0]
            assert torch.allclose(ours, theirs, atol=1e-5), (index, name)
        assert torch.equal(together.valid[index], alone.valid[0])
    again = augment(samples, EVERYTHING, _generators(*range(6)))
    assert torch.equal(again.right, together.right)
    other = augment(samples, EVERYTHING, _generators(*range(1, 7)))
    assert not torch.allclose(other.right, together.right, atol=0.05)


def test_images_stay_images():
    wild = replace(
        EVERYTHING,
        exposure=(0.1, 0.9),
        brightness=0.9,
        contrast=0.9,
        saturation=0.9,
        hue=3.0,
        gamma=1.0,
        noise=0.3,
        view_change=1.0,
    )
    for seed in range(10):
        sample = _random(seed)
        if seed == 0:
            sample = replace(sample, left=torch.zeros_like(sample.left))
        if seed == 1:
            sample = replace(sample, left=torch.ones_like(sample.left))
        result = augment([sample], wild, _generators(seed))
        for view in (result.left, result.right):
            assert view.shape == (1, 3, 48, 64) and view.dtype == torch.float32
            assert view.isfinite().all() and view.min() >= 0 and view.max() <= 1
        assert result.disparity.shape == result.valid.shape == (1, 48, 64)
        assert (result.disparity[~result.valid] == 0).all()


def test_grey():
    result = augment([_random(1)], replace(EVERYTHING, grey=1.0), _generators(1))
    for view in (result.left, result.right):
        assert torch.allclose(view[:, 0], view[:, 1]) and torch.allclose(view[:, 0], view[:, 2])
    plain = augment([_random(1)], replace(PLAIN, grey=1.0), _generators(1))
    weights = torch.tensor([0.299, 0.587, 0.114])[:, None, None]
    expected = (_random(1).left * weights).sum(0)
    assert torch.allclose(plain.left[0, 0], expected, atol=1e-6)


def test_grey_has_its_probability():
    pairs = [_random(1, 16, 16)] * 400
    result = augment(pairs, replace(PLAIN, grey=0.25), _generators(*range(400)))
    share = (result.left[:, 0] == result.left[:, 1]).all(-1).all(-1).float().mean()
    assert 0.18 < share < 0.32  # 4 standard deviations


def test_colour_is_joint_unless_told_otherwise():
    sample = _random(1)
    sample = replace(sample, right=sample.left)
    joint = replace(
        PLAIN, brightness=0.3, contrast=0.3, saturation=0.5, hue=0.5, gamma=0.3, exposure=(0.4, 0.6)
    )
    result = augment([sample], joint, _generators(7))
    assert torch.equal(result.left, result.right)
    assert (result.left[0] - sample.left).abs().mean() > 0.02
    result = augment([sample], replace(joint, view_change=0.5), _generators(7))
    assert (result.left - result.right).abs().mean() > 0.01


def test_one_view_may_have_colours_of_its_own():
    pair = _random(1, 16, 24)
    pair = replace(pair, right=pair.left)
    config = replace(PLAIN, brightness=0.3, gamma=0.3, one_sided=0.5)
    result = augment([pair] * 200, config, _generators(*range(200)))
    joint = augment([pair] * 200, replace(config, one_sided=0.0), _generators(*range(200)))
    assert torch.equal(joint.left, joint.right)
    changed = [
        (now != before).flatten(1).any(1)
        for now, before in ((result.left, joint.left), (result.right, joint.right))
    ]
    assert not (changed[0] & changed[1]).any()
    for side in changed:  # each in a quarter of the pairs, by 4 standard deviations
        assert 0.13 < side.float().mean() < 0.37
    assert torch.equal(result.disparity, torch.stack([pair.disparity] * 200))


def test_exposure_sets_the_mean():
    sample = _random(1)
    dark = replace(sample, left=sample.left / 3, right=sample.right / 3)
    result = augment([dark], replace(PLAIN, exposure=(0.3, 0.3)), _generators(1))
    mean = torch.stack((result.left, result.right)).mean().item()
    assert mean == pytest.approx(0.3, abs=1e-3)


def test_blur_and_noise():
    image = torch.zeros(3, 41, 41)
    image[:, 20, 20] = 1
    sample = StereoSample(image, image)
    # With probability 0 the view stays sharp.
    sharp = augment([sample], replace(PLAIN, blur=2.0), _generators(1))
    assert torch.allclose(sharp.left[0], sample.left, atol=1e-5)
    peaks = []
    for seed in range(20):
        blurred = augment(
            [sample], replace(PLAIN, blur=2.0, blur_probability=1.0), _generators(seed)
        )
        assert blurred.left.sum().item() == pytest.approx(3, rel=0.01)
        assert not torch.allclose(blurred.left, blurred.right, atol=1e-4)
        peaks.append(float(blurred.left.max()))
    # A Gaussian of deviation s has its peak near 1 / (2 pi s^2): 0.04 at s = 2, 0.15 at s = 1.
    assert min(peaks) < 0.06 and 0.1 < np.median(peaks) < 0.25
    flat = StereoSample(torch.full((3, 64, 64), 0.5), torch.full((3, 64, 64), 0.5))
    deviations = []
    for seed in range(30):
        noisy = augment([flat], replace(PLAIN, noise=0.1), _generators(seed))
        deviations += [float(noisy.left.std()), float(noisy.right.std())]
        assert abs(float(noisy.left.mean()) - 0.5) < 0.01
    assert 0.03 < np.mean(deviations) < 0.07 and max(deviations) < 0.105


def test_vignette_darkens_corners():
    flat = StereoSample(torch.full((3, 33, 65), 0.8), torch.full((3, 33, 65), 0.8))
    result = augment([flat], replace(PLAIN, vignette=0.5), _generators(1))
    for view in (result.left[0], result.right[0]):
        assert torch.allclose(view[:, 16, 32], torch.tensor(0.8))
        corners = view[0, [0, 0, -1, -1], [0, -1, 0, -1]]
        assert corners.min() >= 0.4 and corners.max() < 0.8
        assert torch.allclose(corners, corners[:1])


def test_patch_hides_part_of_the_right_view():
    sample = _random(1)
    config = replace(PLAIN, patch_probability=1.0, patch=(10, 20))
    result = augment([sample], config, _generators(2))
    assert torch.equal(result.left[0], sample.left)
    changed = (result.right[0] != sample.right).any(0)
    rows, columns = changed.any(1).nonzero(), changed.any(0).nonzero()
    height = int(rows.max() - rows.min()) + 1
    width = int(columns.max() - columns.min()) + 1
    assert changed.sum() == height * width and height <= 20 and width <= 20
    painted = result.right[0][:, changed]
    assert torch.allclose(painted, sample.right.mean((1, 2))[:, None].expand_as(painted))
    result = augment([sample], replace(config, patch_probability=0.0), _generators(2))
    assert torch.equal(result.right[0], sample.right)
