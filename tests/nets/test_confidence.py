import torch
import torch.nn.functional as F

from mobilestereonet.nets.confidence import match_confidence


def test_is_the_mass_near_the_mean_of_the_upsampled_distribution():
    scores = 3 * torch.randn(2, 8, 3, 5, generator=torch.Generator().manual_seed(0))
    fine = F.interpolate(scores[:, None], scale_factor=(4, 1, 1), mode="trilinear")[:, 0]
    expected = torch.zeros(2, 3, 5)
    for place in torch.cartesian_prod(torch.arange(2), torch.arange(3), torch.arange(5)).tolist():
        mass = fine[place[0], :, place[1], place[2]].softmax(0)
        mean = sum(d * float(p) for d, p in enumerate(mass))
        for d, p in enumerate(mass):
            # Whole within 1.5 px; the bin at the border counts in part, so that nothing jumps.
            expected[tuple(place)] += p * min(max(2.5 - abs(d - mean), 0), 1)
    result = match_confidence(scores)
    assert result.shape == (2, 12, 20)
    upsampled = F.interpolate(expected[:, None], scale_factor=4, mode="bilinear")[:, 0]
    torch.testing.assert_close(result, upsampled, rtol=0, atol=1e-5)


def test_sure_torn_and_without_a_clue():
    scores = torch.zeros(1, 48, 1, 3)
    scores[0, 20, 0, 0] = 1000  # one peak: the fine bins near 4 * 20 + 1.5
    scores[0, 10, 0, 1] = scores[0, 30, 0, 1] = 1000  # two equal peaks: the mean is between them
    sure, torn, clueless = match_confidence(scores)[0, 0, 1::4]
    assert sure > 0.8
    assert torn < 0.25 * float(sure)
    assert clueless < 0.25
    assert match_confidence(scores.bfloat16()).dtype == torch.float32
