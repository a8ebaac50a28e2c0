import copy

import pytest
import torch
import torch.nn.functional as F

from mobilestereonet.accelerate import accelerate
from mobilestereonet.accelerate.batched import BatchedLearnedVolume
from mobilestereonet.accelerate.group_correlation import BatchedCorrelation
from mobilestereonet.accelerate.soft_argmax import ClosedFormSoftArgmax
from mobilestereonet.nets import build_model
from mobilestereonet.nets.cost_volumes import Correlation, LearnedVolume
from mobilestereonet.nets.soft_argmax import SoftArgmax

LEARNED = [f"interlaced-{i}" for i in (1, 2, 4, 8, 16)] + ["concatenation"]


def volumes_of(kind):
    """A plain cost volume in float64 with random statistics and norms, and its batched form."""
    torch.manual_seed(0)
    if kind in LEARNED:
        volume = LearnedVolume(kind).double()
        batched = BatchedLearnedVolume(volume)
    else:
        volume = Correlation(8 if kind == "groupwise" else 1).double()
        batched = BatchedCorrelation(volume)
    for key, value in volume.state_dict().items():
        if key.endswith("running_mean"):
            value.normal_(std=0.1)
        elif value.ndim == 1 or key == "squeeze.0.weight":  # positive: the last ReLU lives
            value.uniform_(0.5, 1.5)
    return volume, batched


@pytest.mark.parametrize("width", [20, 12, 5, 1])
@pytest.mark.parametrize("kind", [*LEARNED, "correlation", "groupwise"])
def test_batched_volumes_equal_the_loop(kind, width):
    plain, batched = volumes_of(kind)
    left, right = torch.randn(2, 2, 32, 4, width, dtype=torch.float64)
    with torch.no_grad():
        expected = plain.eval()(left, right, 12)
        assert expected[:, :, 0].abs().mean() > 0.01
        found = batched.eval()(left, right, 12)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("width", [20, 5])
@pytest.mark.parametrize("kind", ["interlaced-4", "interlaced-1", "concatenation"])
def test_gradients_of_batched_volumes_equal_those_of_the_loop(kind, width):
    plain, batched = volumes_of(kind)
    plain.eval(), batched.eval()
    views = torch.randn(2, 2, 32, 4, width, dtype=torch.float64, requires_grad=True)
    inputs = (views, *(p for p in plain.parameters()))
    probe = torch.randn(2, 1, 12, 4, width, dtype=torch.float64)
    grads = [
        torch.autograd.grad((volume(*views, 12) * probe).sum(), inputs)
        for volume in (batched, plain)
    ]
    for found, expected in zip(*grads, strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


def first_volume(kind, left, right):
    """(B, 32, H, W) twice -> (B, 1, 64, H, W)."""
    if kind == "concatenation":
        return torch.cat((left, right), dim=1)[:, None]
    return torch.stack((left, right), dim=2).flatten(1, 2)[:, None]


@pytest.mark.parametrize("width", [20, 5])
@pytest.mark.parametrize("kind", ["interlaced-4", "interlaced-1", "concatenation"])
def test_training_takes_statistics_over_the_columns_with_a_partner(kind, width):
    planes = 12
    plain, volume = volumes_of(kind)
    plain.train(), volume.train()
    norms = [*volume.norm, volume.squeeze[1]]
    for norm in norms:
        norm.momentum = 1.0  # the running statistics are those of this batch
    left, right = torch.randn(2, 2, 32, 4, width, dtype=torch.float64)
    with torch.no_grad():
        result = volume(left, right, planes)
    # Layer by layer: every plane apart, statistics over the columns of all of them.
    xs = [
        first_volume(kind, left[..., i:], right[..., : width - i])
        for i in range(min(planes, width))
    ]
    layers = [*zip(volume.conv, volume.norm, strict=True), (volume.squeeze[0], norms[-1])]
    with torch.no_grad():
        for conv, norm in layers:
            xs = [conv(x.squeeze(2) if norm is norms[-1] else x) for x in xs]
            values = torch.cat([x.transpose(0, 1).flatten(1) for x in xs], dim=1)
            mean, variance = values.mean(dim=1), values.var(dim=1, correction=0)
            torch.testing.assert_close(norm.running_mean, mean, rtol=0, atol=1e-9)
            unbiased = values.var(dim=1, correction=1)
            torch.testing.assert_close(norm.running_var, unbiased, rtol=1e-9, atol=0)
            shape = (-1,) + (1,) * (xs[0].ndim - 2)
            scale = norm.weight / (variance + norm.eps).sqrt()
            shift = norm.bias - scale * mean
            xs = [F.relu(x * scale.view(shape) + shift.view(shape)) for x in xs]
    expected = torch.zeros(2, 1, planes, 4, width, dtype=torch.float64)
    for i, x in enumerate(xs):
        expected[:, :, i, :, i:] = x
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("width", [7, 3])
@pytest.mark.parametrize("kind", ["interlaced-4", "concatenation", "groupwise"])
def test_gradient_of_the_volume_in_training(kind, width):
    volume = volumes_of(kind)[1].train()
    views = torch.randn(2, 1, 32, 2, width, dtype=torch.float64, requires_grad=True)
    probe = torch.randn(1, 8 if kind == "groupwise" else 1, 8, 2, width, dtype=torch.float64)

    def value(pair):
        return (volume(pair[0], pair[1], 8) * probe).sum()

    (gradient,) = torch.autograd.grad(value(views), views)
    direction = torch.randn_like(views)
    with torch.no_grad():
        step = 1e-6
        slope = (value(views + step * direction) - value(views - step * direction)) / (2 * step)
    assert (gradient * direction).sum().item() == pytest.approx(slope.item(), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("kind", ["interlaced-4", "correlation", "groupwise"])
def test_gradient_of_the_volume_in_float32(kind):
    left, right = torch.randn(2, 2, 32, 4, 20, dtype=torch.float64)
    probe = torch.randn(2, 8 if kind == "groupwise" else 1, 12, 4, 20, dtype=torch.float64)
    found = []
    for dtype in (torch.float32, torch.float64):
        volume = volumes_of(kind)[1].train().to(dtype)
        views = [view.to(dtype).requires_grad_() for view in (left, right)]
        loss = (volume(*views, 12) * probe.to(dtype)).sum()
        found.append(torch.autograd.grad(loss, views))
    for single, double in zip(*found, strict=True):
        error = torch.linalg.vector_norm(single.double() - double)
        assert error < 0.02 * torch.linalg.vector_norm(double)


@pytest.mark.parametrize("estimator", ["mean", "mode"])
@pytest.mark.parametrize("scale", [0.1, 3, 300])
def test_closed_form_equals_upsampling_softmax_and_expectation(scale, estimator):
    torch.manual_seed(0)
    scores = scale * torch.randn(2, 8, 5, 9, dtype=torch.float64)
    probe = torch.randn(2, 20, 36, dtype=torch.float64)
    plain = SoftArgmax(4, estimator)
    closed = ClosedFormSoftArgmax(plain)
    results = []
    for head in (plain, closed):
        inputs = scores.clone().requires_grad_()
        disparity = head(inputs)
        results.append((disparity, torch.autograd.grad((disparity * probe).sum(), inputs)[0]))
    for expected, found in zip(*results, strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)
    with torch.no_grad():  # by tiles
        torch.testing.assert_close(closed(scores), results[0][0], rtol=0, atol=1e-9)
        torch.testing.assert_close(
            closed.confidence(scores), plain.confidence(scores), rtol=0, atol=1e-9
        )


def test_closed_form_at_its_limits():
    head = ClosedFormSoftArgmax(SoftArgmax(4))
    peak = torch.zeros(1, 8, 1, 1)
    peak[:, 3] = 1000
    # A peak at the coarse plane 3 lies between the disparities 13 and 14.
    assert head(peak)[0, 0, 0].item() == pytest.approx(13.5, abs=1e-3)
    for scores in (peak.half(), peak.bfloat16(), -peak, 100 * peak):
        disparity = head(scores)
        assert disparity.dtype == torch.float32
        assert disparity.isfinite().all()


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("msnet2d", {}),
        ("msnet3d", {"coarse_pass": True, "coarse_levels": 2, "max_disparity": 64}),
        ("msnet3d-cascade", {"max_disparity": 64, "band": 8}),
        ("baseline3d", {}),
        ("table2-concatenation", {}),
    ],
)
def test_form_for_training_shares_the_parameters_and_their_gradients(name, fields):
    torch.manual_seed(0)
    plain = build_model(name, **{"max_disparity": 32, **fields}).double()
    plain.zero_residuals()  # fresh weights amplify rounding
    views = torch.randn(2, 1, 3, 32, 64, dtype=torch.float64)
    with torch.no_grad():
        for _ in range(2):  # statistics that eval mode can take
            plain(*views)
    fast = accelerate(plain, "training")
    assert {id(p) for p in fast.parameters()} == {id(p) for p in plain.parameters()}
    assert fast.state_dict().keys() == plain.state_dict().keys()
    gradients = []
    for net in (plain.eval(), fast.eval()):
        prediction = net(*views).disparity
        gradients.append(
            torch.autograd.grad(prediction.square().mean(), plain.parameters(), allow_unused=True)
        )
    assert sum(gradient is not None for gradient in gradients[0]) > 100
    for (key, _), expected, found in zip(plain.named_parameters(), *gradients, strict=True):
        if expected is None:
            assert found is None, key
            continue
        error = torch.linalg.vector_norm(found - expected)
        assert error <= 1e-7 * torch.linalg.vector_norm(expected) + 1e-10, key


def test_form_for_training_takes_statistics_once_and_the_plain_network_has_them():
    plain = build_model("msnet2d", max_disparity=32, hourglasses=1)
    before = copy.deepcopy(plain.state_dict())
    accelerate(plain, "training")(*torch.randn(2, 1, 3, 32, 64))
    norm = plain.features.first[0][0].conv[1]
    assert norm.num_batches_tracked == plain.volume.norm[0].num_batches_tracked == 1
    assert not norm.running_mean.equal(before["features.first.0.0.conv.1.running_mean"])
