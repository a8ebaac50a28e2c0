import numpy as np
import pytest
import torch

from mobilestereonet.training.fading import fade


def _pair(batch: int = 6, height: int = 64, width: int = 128) -> tuple[torch.Tensor, ...]:
    """Noise that lies 8 pixels further left in the right view."""
    generator = torch.Generator().manual_seed(0)
    scene = torch.rand(batch, 3, height, width + 8, generator=generator)
    disparity = torch.full((batch, height, width), 8.0)
    return scene[..., :-8], scene[..., 8:], disparity, disparity > 0


def _fade(share: float, seed: int = 0) -> tuple[torch.Tensor, ...]:
    return fade(*_pair(), share, np.random.default_rng(seed))


def test_a_place_loses_its_contrast():
    left, _, *_ = _pair()
    changed = (_fade(1.0)[0] - left).abs().amax(1) > 0.3
    # Sides of a quarter to three quarters, around a middle anywhere, with a ramp around them.
    shares = changed.flatten(1).float().mean(1)
    assert all(0.01 < share < 0.9 for share in shares)
    flat = _fade(1.0)[0].unfold(2, 4, 4).unfold(3, 4, 4).std((1, 4, 5))
    assert (flat.flatten(1).amin(1) < 0.04).all()  # a tenth of 0.29 at most
    assert (flat.flatten(1).amax(1) > 0.2).all()


def test_matches_fade_alike():
    left, right = _fade(1.0)
    # But for the places' colours, of which the rims' columns are a part.
    assert float((left[..., 8:] - right[..., :-8]).abs().max()) < 0.1


def test_the_share_of_pairs():
    left, right, *_ = _pair()
    for seed in range(3):
        faded_left, faded_right = _fade(0.5, seed)
        touched = [not torch.equal(a, b) for a, b in zip(faded_left, left, strict=True)]
        assert touched == [not torch.equal(a, b) for a, b in zip(faded_right, right, strict=True)]
        drawn = np.random.default_rng(seed).random((6, 6, 1, 1), dtype=np.float32)[0] < 0.5
        assert touched == drawn.flatten().tolist()


def test_nothing_known_in_a_place():
    left, right, disparity, known = _pair()
    nan = torch.full_like(disparity, torch.nan)
    views = fade(left, right, nan, torch.zeros_like(known), 1.0, np.random.default_rng(0))
    assert all(view.isfinite().all() for view in views)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_same_draws_give_the_same_places(share):
    assert all(map(torch.equal, _fade(share), _fade(share)))
