import math

import pytest
import torch
import torch.nn.functional as F

from mobilestereonet import InputError, NetConfig, StereoNet, create_model, list_models
from mobilestereonet.nets.coarse_pass import guidance
from mobilestereonet.nets.config import FEATURE_CHANNELS
from mobilestereonet.nets.cost_volumes import build_cost_volume
from mobilestereonet.nets.disparity import regress_disparity, soft_argmax

LEARNED = [f"interlaced-{i}" for i in (1, 2, 4, 8, 16)] + ["concatenation"]


@pytest.mark.parametrize("name", list_models())
def test_every_named_network(name):
    torch.manual_seed(0)
    net = create_model(name, max_disparity=32)
    left, right = torch.randn(2, 2, 3, 32, 64)
    outputs = net(left, right)
    assert len(outputs) == net.config.hourglasses + 1
    assert all(output.shape == (2, 32, 64) for output in outputs)
    sum(output.mean() for output in outputs).backward()
    for key, parameter in net.named_parameters():
        assert parameter.grad is not None, key
        assert parameter.grad.isfinite().all(), key
        assert parameter.grad.any(), key
    with torch.no_grad():
        disparity = net.eval()(left, right)
    assert disparity.shape == (2, 32, 64)
    assert disparity.isfinite().all()
    assert 0 <= disparity.min() <= disparity.max() <= 31


def test_the_papers_networks_have_four_outputs_and_reach_192_px():
    for name in ("msnet2d", "msnet3d"):
        net = create_model(name)
        assert net.config.hourglasses + 1 == len(net.heads) == 4
        assert net.config.max_disparity == 192


def test_models_differ_by_the_fields_that_the_paper_varies():
    def differing(one, other):
        configs = [vars(create_model(name).config) for name in (one, other)]
        return {field for field in configs[0] if configs[0][field] != configs[1][field]}

    assert differing("msnet3d", "msnet3d-authors") == {"v2_skip"}
    assert differing("table3a-conv-conv", "table3a-v1-v2") == {"features", "hourglass"}
    assert differing("baseline2d", "table2-correlation") == {"cost_volume"}
    assert differing("appendix3d-conv-conv", "appendix3d-v2-conv") == {"first_conv"}


@pytest.mark.parametrize("max_disparity", [32, 208, 512])
@pytest.mark.parametrize("name", ["msnet2d", "msnet3d"])
def test_any_maximum_disparity(name, max_disparity):
    net = create_model(name, max_disparity=max_disparity, hourglasses=1).eval()
    with torch.no_grad():
        disparity = net(*torch.randn(2, 1, 3, 16, 32))
    assert 0 <= disparity.min() <= disparity.max() <= max_disparity - 1


def volume_of(kind, planes=12):
    """A cost volume in float64 with random statistics and weights in its norms."""
    torch.manual_seed(0)
    config = NetConfig(dims=2, cost_volume=kind, groups=8, max_disparity=4 * planes)
    volume = build_cost_volume(config).double()
    for key, value in volume.state_dict().items():
        if key.endswith("running_mean"):
            value.normal_(std=0.1)
        elif value.ndim == 1 or key == "squeeze.0.weight":  # positive: the last ReLU lives
            value.uniform_(0.5, 1.5)
    return volume


def cropped(left, right, i):
    """The columns of plane i with a partner, of either view."""
    return left[..., i:], right[..., : right.shape[-1] - i]


def first_volume(kind, left, right):
    """(B, 32, H, W) twice -> (B, 1, 64, H, W)."""
    if kind == "concatenation":
        return torch.cat((left, right), dim=1)[:, None]
    return torch.stack((left, right), dim=2).flatten(1, 2)[:, None]


def plane(volume, kind, left, right):
    """One plane, from cropped features, as the paper writes it: (B, groups or 1, H, W - i)."""
    if kind == "correlation":
        return (left * right).mean(dim=1, keepdim=True)
    if kind == "groupwise":
        channels = left.shape[1] // 8
        return torch.stack(
            [(left * right)[:, g * channels : (g + 1) * channels].mean(dim=1) for g in range(8)],
            dim=1,
        )
    x = first_volume(kind, left, right)
    for conv, norm in zip(volume.conv, volume.norm, strict=True):
        x = F.relu(norm(conv(x)))
    return volume.squeeze(x.squeeze(2))


@pytest.mark.parametrize("width", [20, 12, 5, 1])
@pytest.mark.parametrize("kind", [*LEARNED, "correlation", "groupwise"])
def test_cost_volume_equals_a_loop_over_disparities(kind, width):
    planes = 12
    volume = volume_of(kind, planes).eval()
    left, right = torch.randn(2, 2, 32, 4, width, dtype=torch.float64)
    with torch.no_grad():
        result = volume(left, right, planes)
        channels = 8 if kind == "groupwise" else 1
        expected = torch.zeros(2, channels, planes, 4, width, dtype=torch.float64)
        for i in range(min(planes, width)):
            expected[:, :, i, :, i:] = plane(volume, kind, *cropped(left, right, i))
    assert expected[:, :, 0].abs().mean() > 0.01
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("width", [20, 5])
@pytest.mark.parametrize("kind", ["interlaced-4", "interlaced-1", "concatenation"])
def test_training_takes_statistics_over_the_columns_with_a_partner(kind, width):
    planes = 12
    volume = volume_of(kind, planes).train()
    norms = [*volume.norm, volume.squeeze[1]]
    for norm in norms:
        norm.momentum = 1.0  # the running statistics are those of this batch
    left, right = torch.randn(2, 2, 32, 4, width, dtype=torch.float64)
    with torch.no_grad():
        result = volume(left, right, planes)
    # Layer by layer: every plane apart, statistics over the columns of all of them.
    xs = [first_volume(kind, *cropped(left, right, i)) for i in range(min(planes, width))]
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
    volume = volume_of(kind, planes=8).train()
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
        volume = volume_of(kind).train().to(dtype)
        views = [view.to(dtype).requires_grad_() for view in (left, right)]
        loss = (volume(*views, 12) * probe.to(dtype)).sum()
        found.append(torch.autograd.grad(loss, views))
    for single, double in zip(*found, strict=True):
        error = torch.linalg.vector_norm(single.double() - double)
        assert error < 0.02 * torch.linalg.vector_norm(double)


def by_definition(scores, estimator="mean"):
    """Trilinear upsampling, softmax over the disparity, expectation."""
    planes, height, width = scores.shape[1:]
    size = (4 * planes, 4 * height, 4 * width)
    fine = F.interpolate(scores[:, None], size=size, mode="trilinear", align_corners=False)[:, 0]
    probability = fine.softmax(dim=1)
    if estimator == "mode":
        probability = probability * likely_bins(probability.detach())
    disparities = torch.arange(4 * planes, dtype=scores.dtype)[:, None, None]
    return (probability * disparities).sum(dim=1) / probability.sum(dim=1)


def likely_bins(probability):
    """1 in the 12 bins (8 at either end) with the highest probability, if it is 0.3 or more."""
    bins = probability.shape[1]
    keep = torch.ones_like(probability)
    for b, y, x in torch.cartesian_prod(*map(torch.arange, probability[:, 0].shape)).tolist():
        p = probability[b, :, y, x]
        windows = [(max(first, 0), min(first + 12, bins)) for first in range(-2, bins - 8, 4)]
        low, high = max(windows, key=lambda window: p[slice(*window)].sum())
        if p[low:high].sum() >= 0.3:
            keep[b, :low, y, x] = keep[b, high:, y, x] = 0
    return keep


@pytest.mark.parametrize("estimator", ["mean", "mode"])
@pytest.mark.parametrize("scale", [0.1, 3, 300])
def test_head_equals_upsampling_softmax_and_expectation(scale, estimator):
    torch.manual_seed(0)
    scores = (scale * torch.randn(2, 8, 5, 9, dtype=torch.float64)).requires_grad_()
    probe = torch.randn(2, 20, 36, dtype=torch.float64)
    results = []
    for head in (regress_disparity, by_definition):
        disparity = head(scores, estimator)
        results.append((disparity, torch.autograd.grad((disparity * probe).sum(), scores)[0]))
    (disparity, gradient), (expected, expected_gradient) = results
    torch.testing.assert_close(disparity, expected, rtol=0, atol=1e-9)
    torch.testing.assert_close(gradient, expected_gradient, rtol=0, atol=1e-9)
    with torch.no_grad():
        found = regress_disparity(scores, estimator)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


def test_mode_keeps_to_one_of_two_surfaces_and_to_the_mean_without_a_clue():
    scores = torch.zeros(1, 48, 1, 2)
    scores[0, 10, 0, 0] = 30  # 41.5 px
    scores[0, 30, 0, 0] = 29  # 121.5 px, less likely
    torn, clueless = soft_argmax(scores, "mode")[0, 0]
    assert torn == pytest.approx(41.5, abs=0.1)
    assert clueless == pytest.approx(95.5)
    assert 50 < soft_argmax(scores)[0, 0, 0] < 80


def test_soft_argmax_at_its_limits():
    even = torch.zeros(1, 8, 1, 1)
    assert soft_argmax(even).item() == pytest.approx(15.5)
    # A peak at the coarse disparity 3 lies between the fine disparities 13 and 14.
    peak = even.clone()
    peak[:, 3] = 1000
    assert soft_argmax(peak).item() == pytest.approx(13.5, abs=1e-3)
    for scores in (peak.half(), peak.bfloat16(), -peak, 100 * peak):
        disparity = regress_disparity(scores)
        assert disparity.dtype == torch.float32
        assert disparity.isfinite().all()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"dims": 4}, "dims must be one of 2, 3, got 4"),
        ({"first_conv": "v1"}, "first_conv must be one of conv, v2, got 'v1'"),
        ({"features": "v3"}, "features must be one of conv, v1, v2"),
        ({"hourglass": ""}, "hourglass must be one of"),
        ({"cost_volume": "interlaced-3"}, "cost_volume must be one of interlaced-1"),
        ({"hourglasses": 0}, "hourglasses must be at least 1, got 0"),
        ({"width": -8}, "width must be at least 1"),
        ({"max_disparity": 100}, "multiple of 16 in 32..512, got 100"),
        ({"max_disparity": 16}, "got 16"),
        ({"max_disparity": 528}, "got 528"),
        ({"coarse_pass": True}, "coarse_pass needs dims=3 .* got dims=2"),
        ({"dims": 3, "coarse_pass": True, "max_disparity": 48}, "multiple of 32, got .* 48"),
        ({"cost_volume": "groupwise", "groups": 7}, "groups must divide the 32 channels"),
        ({"channel_reduction": False}, "set channel_reduction=True"),
    ],
)
def test_refused_configs(fields, message):
    with pytest.raises(InputError, match=message):
        NetConfig(**{"dims": 2, **fields})


def test_guidance_is_the_coarse_distribution_upsampled():
    torch.manual_seed(0)
    scores = 4 * torch.randn(2, 6, 3, 5, dtype=torch.float64)
    likely = scores.log_softmax(dim=1).clamp(min=-8) / 8 + 1
    expected = F.interpolate(likely[:, None], scale_factor=2, mode="trilinear")[:, 0]
    assert (likely == 0).any() and likely.max() > 0.9
    torch.testing.assert_close(guidance(scores), expected, rtol=0, atol=1e-12)
    assert guidance(scores.bfloat16()).dtype == torch.bfloat16


def test_coarse_pass():
    torch.manual_seed(0)
    net = create_model("msnet3d", max_disparity=64, hourglasses=1, coarse_pass=True).eval()
    plain = create_model("msnet3d", max_disparity=64, hourglasses=1).eval()
    state = net.state_dict()
    weight = state.pop("guide.weight")
    plain.load_state_dict(state)
    views = torch.randn(2, 1, 3, 64, 128)
    with torch.no_grad():
        # Zero at first: the network is what it was without.
        torch.testing.assert_close(net(*views), plain(*views), rtol=0, atol=0)
        weight.normal_()
        halves = [F.avg_pool2d(view, 2) for view in views]
        half = create_model("msnet3d", max_disparity=32, hourglasses=1).eval()
        half.load_state_dict(state)
        told = guidance(half.scores(*halves)[-1])
        torch.testing.assert_close(net.guidance(*views), told, rtol=0, atol=1e-5)
        expected = net.aggregate(net.cost_volume(*views), told)[-1]
        torch.testing.assert_close(net.scores(*views)[-1], expected, rtol=0, atol=1e-4)
        assert (expected - plain.scores(*views)[-1]).abs().max() > 0.1
    net.train().guidance(*views)
    assert net.training and net.features.training
    with pytest.raises(InputError, match="multiples of 32, got 48 x 128"):
        net(*views[..., :48, :])


def test_refused_names_and_overrides():
    with pytest.raises(InputError, match=r"unknown model 'msnet-2d'.*msnet2d"):
        create_model("msnet-2d")
    with pytest.raises(InputError, match=r"msnet2d: .*colour"):
        create_model("msnet2d", colour="red")


def test_refused_inputs():
    net = create_model("msnet2d", max_disparity=32, hourglasses=1)
    with pytest.raises(InputError, match="multiples of 16, got 30 x 64"):
        net(*torch.randn(2, 1, 3, 30, 64))
    with pytest.raises(InputError, match=r"\(1, 3, 32, 64\) and \(1, 3, 32, 48\)"):
        net(torch.randn(1, 3, 32, 64), torch.randn(1, 3, 32, 48))
    with pytest.raises(InputError, match=r"\(1, 1, 32, 64\)"):
        net(*torch.randn(2, 1, 1, 32, 64))


def test_fresh_weights_are_drawn_as_the_authors_draw_them():
    torch.manual_seed(0)
    net = StereoNet(NetConfig(dims=2))
    conv = net.reduction[0][0]  # 1x1, 320 -> 256 channels
    assert conv.weight.shape == (256, FEATURE_CHANNELS, 1, 1)
    assert conv.weight.std().item() == pytest.approx(math.sqrt(2 / 256), rel=0.02)
    assert abs(conv.weight.mean().item()) < 0.001
    depthwise = net.features.stage2[3].conv1[0]  # 3x3 of 64 groups
    assert depthwise.weight.std().item() == pytest.approx(math.sqrt(2 / (9 * 64)), rel=0.1)
