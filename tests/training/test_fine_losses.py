"""Cross entropy over all disparities, against its plain definition."""

import pytest
import torch
import torch.nn.functional as F

from mobilestereonet.accelerate.cross_entropy import LAPLACE_PX
from mobilestereonet.nets.soft_argmax import SoftArgmax
from mobilestereonet.training.losses import (
    cross_entropy_sum,
    fine_cross_entropy_sum,
    own_surface,
    surfaces,
)

PLANES = 6


def laplacian(disparity: torch.Tensor, count: int) -> torch.Tensor:
    """Laplacian around disparities (B, H, W), over whole disparities: (B, count, H, W)."""
    whole = torch.arange(count, dtype=disparity.dtype)[:, None, None]
    below, last = disparity.floor(), count - 1
    around = [
        (-(whole - centre.clamp(max=last).unsqueeze(1)).abs() / LAPLACE_PX).softmax(dim=1)
        for centre in (below, below + 1)
    ]
    return torch.lerp(*around, (disparity - below).unsqueeze(1))


def plain(scores, weights, centres, shares, *, full_heads):
    """The definition: upsampled scores, log-softmax, all disparities of the target."""
    total = 0
    for index, (weight, score) in enumerate(zip(weights, scores, strict=True)):
        full = index >= len(scores) - full_heads
        factors = (4.0, 4.0, 4.0) if full else (4.0, 1.0, 1.0)
        fine = F.interpolate(score[:, None], scale_factor=factors, mode="trilinear")[:, 0]
        step = slice(None) if full else slice(2, None, 4)
        target = sum(
            share[:, None] * laplacian(centre, fine.shape[1])
            for centre, share in zip(
                centres[..., step, step].unbind(1), shares[..., step, step].unbind(1), strict=True
            )
        )
        loss = -(target * fine.log_softmax(dim=1)).sum()
        total = total + weight * (1 if full else 16) * loss
    return total


def example(dtype, seed=0):
    """Scores of two heads, ground truth with steps in it, and a mask with holes."""
    generator = torch.Generator().manual_seed(seed)
    scores = [
        (4 * torch.randn(2, PLANES, 2, 5, generator=generator)).to(dtype).requires_grad_()
        for _ in range(2)
    ]
    steps = torch.rand(2, 8, 5, generator=generator).repeat_interleave(4, dim=2)
    disparity = (4 * PLANES - 1) * steps + 0.5 * torch.rand(2, 8, 20, generator=generator)
    mask = torch.rand(2, 8, 20, generator=generator) > 0.2
    return scores, torch.where(mask, disparity, torch.nan).to(dtype), mask


@pytest.mark.parametrize("modes", [own_surface, surfaces])
@pytest.mark.parametrize("full_heads", [0, 1, 2])
def test_closed_form_is_the_plain_definition(dtype, modes, full_heads):
    scores, disparity, mask = example(dtype)
    target = modes(disparity, mask)
    losses, gradients = [], []
    for function in (plain, fine_cross_entropy_sum):
        loss = function(scores, [0.5, 1.0], *target, full_heads=full_heads)
        losses.append(loss.detach())
        gradients.append(torch.autograd.grad(loss, scores))
    tolerance = {"rtol": 1e-10, "atol": 1e-10} if dtype == torch.float64 else {}
    torch.testing.assert_close(losses[1], losses[0], **tolerance)
    tolerance = tolerance or {"rtol": 1e-4, "atol": 1e-4}
    torch.testing.assert_close(gradients[1], gradients[0], **tolerance)


def test_pixels_that_do_not_count_have_no_gradient():
    scores, disparity, mask = example(torch.float64)
    mask[:, :, 8:] = False
    loss = fine_cross_entropy_sum(scores, [1.0, 1.0], *surfaces(disparity, mask), full_heads=1)
    for gradient in torch.autograd.grad(loss, scores):
        assert gradient[..., 3:].abs().max() == 0 and gradient[..., 0].abs().max() > 0


def answers(loss, steps: int = 300):
    """Expected disparity of free scores that were trained on one, over a range of phases."""
    truth = torch.linspace(14, 22, 65)
    # One picture of one coarse pixel for each disparity, so that the pixels do not mix.
    disparity = truth[:, None, None].expand(-1, 4, 4).contiguous()
    scores = torch.zeros(len(truth), 10, 1, 1, requires_grad=True)
    optimizer = torch.optim.Adam([scores], lr=0.1)
    for _ in range(steps):
        optimizer.zero_grad()
        loss(scores, disparity, disparity > 0).backward()
        optimizer.step()
    with torch.no_grad():
        return SoftArgmax().expectation(scores)[:, 2, 2] - truth


def test_no_fraction_of_a_pixel_is_preferred_any_more():
    def planes(scores, disparity, mask):
        return cross_entropy_sum([scores], [1.0], disparity, mask)

    def fine(scores, disparity, mask):
        return fine_cross_entropy_sum([scores], [1.0], *own_surface(disparity, mask), full_heads=1)

    assert answers(planes).abs().max() > 0.6
    assert answers(fine).abs().max() < 0.05


def test_surfaces_by_hand():
    disparity = torch.tensor([10.0, 10, 10, 11, 11, 11, 40, 41, 42, 42, 5, 5, 5]).view(1, 1, -1)
    mask = torch.ones(1, 1, 13, dtype=torch.bool)
    mask[..., 9] = False
    centres, shares = (map_[0, :, 0] for map_ in surfaces(disparity, mask))
    # Pixel 5 has 2 .. 5 of its own, 6 .. 8 nearer, 1 .. 4 to its left; pixel 9 does not count.
    assert centres[:, 5].tolist() == [11, 0, 41]
    assert shares[:, 5].tolist() == pytest.approx([1 - 3 * 0.025, 0, 3 * 0.025])
    # Pixel 8: 4, 5 and 10 .. 12 are farther, 6 and 7 its own.
    assert centres[:2, 8].tolist() == pytest.approx([42, (11 + 11 + 5 + 5 + 5) / 5])
    assert shares[:, 8].tolist() == pytest.approx([1 - 5 * 0.025, 5 * 0.025, 0])
    assert shares[:, 9].tolist() == [0, 0, 0]
    assert shares[:, 0].tolist() == [1, 0, 0]
