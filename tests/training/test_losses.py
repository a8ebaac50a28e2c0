import math

import pytest
import torch

from mobilestereonet.training.losses import (
    cross_entropy_sum,
    smooth_l1_sum,
    trained_pixels,
)


def test_trained_pixels():
    disparity = torch.tensor([[0.0, 0.5, 191.9, 192.0, 5.0]])
    valid = torch.tensor([[True, True, True, True, False]])
    assert trained_pixels(disparity, valid, 192).tolist() == [[False, True, True, False, False]]


def test_smooth_l1_by_hand():
    target = torch.tensor([[[10.0, 20.0, 30.0, 40.0]]])
    mask = torch.tensor([[[True, True, True, False]]])
    # Errors 0.5, 3 and 0: 0.5 * 0.5^2, 3 - 0.5 and 0. The last pixel does not count.
    prediction = torch.tensor([[[10.5, 17.0, 30.0, 99.0]]])
    assert smooth_l1_sum([prediction], target, mask).item() == pytest.approx(2.625)
    exact = target.clone()
    weighted = [
        ([prediction, exact, exact, exact], 0.5),
        ([exact, prediction, exact, exact], 0.5),
        ([exact, exact, prediction, exact], 0.7),
        ([exact, exact, exact, prediction], 1.0),
        ([exact, prediction], 1.0),
        ([prediction, exact], 0.7),
        ([prediction, exact, exact, exact, exact], 0.5),
    ]
    for heads, weight in weighted:
        assert smooth_l1_sum(heads, target, mask).item() == pytest.approx(2.625 * weight)


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
        loss = cross_entropy_sum([scores], *_coarse(disparity))
        assert loss.item() == pytest.approx(expected, rel=1e-5), disparity


def test_cross_entropy_looks_at_every_fourth_pixel():
    scores = torch.randn(2, 8, 2, 3)
    target, mask = torch.rand(2, 8, 12) * 30, torch.zeros(2, 8, 12, dtype=torch.bool)
    mask[0, 6, 10] = True
    one = cross_entropy_sum([scores], target, mask)
    alone = cross_entropy_sum([scores[:1, :, 1:, 2:]], *_coarse(float(target[0, 6, 10])))
    assert one.item() == pytest.approx(alone.item(), rel=1e-5)
    mask[0, 6, 10], mask[0, 7, 10] = False, True
    assert cross_entropy_sum([scores], target, mask) == 0


def test_sums_add_up_over_batches_and_heads():
    scores = [torch.randn(3, 8, 4, 4) for _ in range(2)]
    target = torch.rand(3, 16, 16) * 30
    mask = torch.rand(3, 16, 16) > 0.3
    for loss, heads in (
        (cross_entropy_sum, scores),
        (smooth_l1_sum, [torch.rand(3, 16, 16) * 30 for _ in range(2)]),
    ):
        whole = loss(heads, target, mask)
        parts = [
            loss([head[i : i + 1] for head in heads], target[i : i + 1], mask[i : i + 1])
            for i in range(3)
        ]
        assert whole.item() == pytest.approx(sum(part.item() for part in parts), rel=1e-5)
        single = 0.7 * loss([heads[0]], target, mask) + loss([heads[1]], target, mask)
        assert whole.item() == pytest.approx(single.item(), rel=1e-5)


def test_masked_pixels_have_no_gradient():
    scores = torch.randn(1, 8, 2, 2, requires_grad=True)
    prediction = torch.rand(1, 8, 8, requires_grad=True)
    target, mask = torch.rand(1, 8, 8) * 30, torch.ones(1, 8, 8, dtype=torch.bool)
    mask[:, :, :4] = False
    (
        cross_entropy_sum([scores], target, mask) + smooth_l1_sum([prediction], target, mask)
    ).backward()
    assert scores.grad[..., 0].abs().max() == 0 and scores.grad[..., 1].abs().min() > 0
    assert prediction.grad[..., :4].abs().max() == 0 and prediction.grad[..., 4:].abs().min() > 0
