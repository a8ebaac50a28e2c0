import math

import pytest
import torch

from mobilestereonet.training.losses import cross_entropy_sum


def _coarse(value: float, mask: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
    """Ground truth of a 4 x 4 image, one coarse pixel."""
    return torch.full((1, 4, 4), value), torch.full((1, 4, 4), mask)


def test_cross_entropy_by_hand():
    scores = torch.tensor([1.0, 2.0, 0.5]).view(1, 3, 1, 1)
    total = math.exp(1.0) + math.exp(2.0) + math.exp(0.5)
    log_p = [1.0 - math.log(total), 2.0 - math.log(total), 0.5 - math.log(total)]
    # Coarse plane k is the fine disparities 4k .. 4k + 3, centre 4k + 1.5.
    for disparity, shares in [
        (1.5, (1, 0, 0)),
        (5.5, (0, 1, 0)),
        (2.5, (0.75, 0.25, 0)),
        (8.5, (0, 0.25, 0.75)),
        (0.2, (1, 0, 0)),
        (11.0, (0, 0, 1)),
    ]:
        expected = -16 * sum(share * log for share, log in zip(shares, log_p, strict=True))
        loss = cross_entropy_sum([scores], [1.0], *_coarse(disparity))
        assert loss.item() == pytest.approx(expected, rel=1e-5), disparity


def test_cross_entropy_looks_at_every_fourth_pixel():
    scores = torch.randn(2, 8, 2, 3)
    target, mask = torch.rand(2, 8, 12) * 30, torch.zeros(2, 8, 12, dtype=torch.bool)
    mask[0, 6, 10] = True
    one = cross_entropy_sum([scores], [1.0], target, mask)
    alone = cross_entropy_sum([scores[:1, :, 1:, 2:]], [1.0], *_coarse(float(target[0, 6, 10])))
    assert one.item() == pytest.approx(alone.item(), rel=1e-5)
    mask[0, 6, 10], mask[0, 7, 10] = False, True
    assert cross_entropy_sum([scores], [1.0], target, mask) == 0


def test_other_scales_sample_the_middle_of_their_pixels():
    """Scores at an eighth: plane k is the fine disparities 8 k .. 8 k + 7, centre 8 k + 3.5."""
    scores = torch.tensor([1.0, 2.0]).view(1, 2, 1, 1)
    target = torch.zeros(1, 8, 8)
    target[0, 4, 4] = 8 + 3.5
    loss = cross_entropy_sum([scores], [0.5], target, target > 0, scale=8)
    expected = -0.5 * 64 * torch.log_softmax(scores.flatten(), dim=0)[1]
    assert loss.item() == pytest.approx(expected.item(), rel=1e-5)


def test_sums_add_up_over_batches_and_heads():
    scores = [torch.randn(3, 8, 4, 4) for _ in range(2)]
    target = torch.rand(3, 16, 16) * 30
    mask = torch.rand(3, 16, 16) > 0.3
    weights = [0.7, 1.0]
    whole = cross_entropy_sum(scores, weights, target, mask)
    parts = [
        cross_entropy_sum(
            [head[i : i + 1] for head in scores], weights, target[i : i + 1], mask[i : i + 1]
        )
        for i in range(3)
    ]
    assert whole.item() == pytest.approx(sum(part.item() for part in parts), rel=1e-5)
    single = [cross_entropy_sum([head], [1.0], target, mask) for head in scores]
    assert whole.item() == pytest.approx((0.7 * single[0] + single[1]).item(), rel=1e-5)


def test_masked_pixels_have_no_gradient():
    scores = torch.randn(1, 8, 2, 2, requires_grad=True)
    target, mask = torch.rand(1, 8, 8) * 30, torch.ones(1, 8, 8, dtype=torch.bool)
    mask[:, :, :4] = False
    cross_entropy_sum([scores], [1.0], target, mask).backward()
    assert scores.grad[..., 0].abs().max() == 0 and scores.grad[..., 1].abs().min() > 0
