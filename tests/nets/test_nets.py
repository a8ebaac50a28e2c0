import itertools
import math
from dataclasses import dataclass, replace

import pytest
import torch
import torch.nn.functional as F

from mobilestereonet.errors import InputError
from mobilestereonet.nets import (
    StereoModel,
    VolumeModel,
    build_model,
    list_models,
    model_config,
    model_info,
    model_name,
    register_model,
    registry,
    trained_pixels,
)
from mobilestereonet.nets.coarse_pass import (
    band_start,
    cut_band,
    guidance_from_scores,
    spread_band,
)
from mobilestereonet.nets.cost_volumes import Correlation, LearnedVolume
from mobilestereonet.nets.msnet import MobileStereoNet
from mobilestereonet.nets.msnet_config import FEATURE_CHANNELS, NetConfig
from mobilestereonet.nets.soft_argmax import SoftArgmax
from mobilestereonet.nets.volume_model import Band, VolumeOutputs

LEARNED = [f"interlaced-{i}" for i in (1, 2, 4, 8, 16)] + ["concatenation"]


@pytest.mark.parametrize("name", list_models())
def test_every_named_network(name):
    torch.manual_seed(0)
    scored = issubclass(model_info(name).network, VolumeModel)
    narrow = {} if scored or not hasattr(model_config(name), "width") else {"width": 8}
    largest = 48 if name.startswith("ganet-") else 32  # GA-Net takes multiples of 12
    net = build_model(name, max_disparity=largest, **narrow)
    sides = [math.ceil(max(side, net.min_side) / net.size_multiple) for side in (32, 64)]
    shape = (2, *(side * net.size_multiple for side in sides))
    if net.min_side == 1:
        net = net.double()  # fresh weights saturate some softmaxes in float32
    left, right = torch.randn(2, shape[0], 3, *shape[1:], dtype=next(net.parameters()).dtype)
    outputs = net(left, right)
    # The accurate MC-CNN has none in training: it would take most of a step.
    assert (outputs.disparity is None) == (name == "mccnn-slow")
    assert outputs.disparity is None or outputs.disparity.shape == shape
    valid = torch.ones(shape, dtype=torch.bool)
    net.training_loss(outputs, torch.full(shape, 8.0, dtype=left.dtype), valid).backward()
    for key, parameter in net.named_parameters():
        assert parameter.grad is not None, key
        assert parameter.grad.isfinite().all(), key
        assert parameter.grad.any(), key
    with torch.no_grad():
        disparity, confidence = net.eval()(left, right)
    assert (confidence is not None) == scored
    bounds = [(disparity, largest - 1), (confidence, 1.001)] if scored else [(disparity, math.inf)]
    for values, bound in bounds:
        assert values.shape == shape
        assert values.isfinite().all()
        # The guided filter that ends GA-Net has weights of both signs.
        assert name.startswith("ganet-") or 0 <= values.min() <= values.max() <= bound
    assert model_name(model_config(name)) in list_models()
    if net.size_multiple > 1:
        with pytest.raises(InputError, match=f"multiples of {net.size_multiple}"):
            net(left[..., :-1], right[..., :-1])


def test_the_papers_networks_have_four_outputs_and_reach_192_px():
    for name in ("msnet2d", "msnet3d"):
        net = build_model(name)
        assert net.config.hourglasses + 1 == len(net.heads) == 4
        assert net.config.max_disparity == 192


def test_models_differ_by_the_fields_that_the_paper_varies():
    def differing(one, other):
        configs = [vars(build_model(name).config) for name in (one, other)]
        return {field for field in configs[0] if configs[0][field] != configs[1][field]}

    assert differing("msnet3d", "msnet3d-authors") == {"v2_skip"}
    assert differing("table3a-conv-conv", "table3a-v1-v2") == {"features", "hourglass"}
    assert differing("baseline2d", "table2-correlation") == {"cost_volume"}
    assert differing("appendix3d-conv-conv", "appendix3d-v2-conv") == {"first_conv"}


@pytest.mark.parametrize("max_disparity", [32, 208, 512])
@pytest.mark.parametrize("name", ["msnet2d", "msnet3d"])
def test_any_maximum_disparity(name, max_disparity):
    net = build_model(name, max_disparity=max_disparity, hourglasses=1).eval()
    with torch.no_grad():
        disparity = net(*torch.randn(2, 1, 3, 16, 32)).disparity
    assert 0 <= disparity.min() <= disparity.max() <= max_disparity - 1


def volume_of(kind):
    """A cost volume in float64 with random statistics and weights in its norms."""
    torch.manual_seed(0)
    learned = kind in LEARNED
    volume = LearnedVolume(kind) if learned else Correlation(8 if kind == "groupwise" else 1)
    for key, value in volume.double().state_dict().items():
        if key.endswith("running_mean"):
            value.normal_(std=0.1)
        elif value.ndim == 1 or key == "squeeze.0.weight":  # positive: the last ReLU lives
            value.uniform_(0.5, 1.5)
    return volume


def interlaced(kind, left, right):
    """Channels of a pair (B, 32, H, W) in the order in which the volume takes them."""
    if kind == "concatenation":
        order = [(view, c) for view in (left, right) for c in range(32)]
    else:
        order = [(view, c) for c in range(32) for view in (left, right)]
    return torch.stack([view[:, c] for view, c in order], dim=1)[:, None]


@pytest.mark.parametrize("width", [20, 12, 5, 1])
@pytest.mark.parametrize("kind", [*LEARNED, "correlation", "groupwise"])
def test_plane_i_compares_columns_i_apart(kind, width):
    planes = 12
    volume = volume_of(kind).eval()
    left, right = torch.randn(2, 2, 32, 4, width, dtype=torch.float64)
    with torch.no_grad():
        result = volume(left, right, planes)
    assert result.shape == (2, 8 if kind == "groupwise" else 1, planes, 4, width)
    assert result[:, :, 0].abs().mean() > 0.01
    for i in range(planes):
        assert not result[:, :, i, :, :i].any()  # no partner
        if i >= width:
            continue
        with torch.no_grad():
            if kind in ("correlation", "groupwise"):
                groups = (left[..., i:] * right[..., : width - i]).chunk(result.shape[1], dim=1)
                expected = torch.stack([group.mean(dim=1) for group in groups], dim=1)
            else:
                x = interlaced(kind, left[..., i:], right[..., : width - i])
                for conv, norm in zip(volume.conv, volume.norm, strict=True):
                    x = F.relu(norm(conv(x)))
                expected = volume.squeeze(x.squeeze(2))
        torch.testing.assert_close(result[:, :, i, :, i:], expected, rtol=0, atol=1e-9)


def test_training_updates_statistics_per_view_and_per_disparity_as_the_authors_do():
    net = build_model("msnet2d", max_disparity=32, hourglasses=1)
    net(*torch.randn(2, 1, 3, 32, 64))
    assert net.features.first[0][0].conv[1].num_batches_tracked == 2
    assert net.volume.norm[0].num_batches_tracked == 8


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
@pytest.mark.parametrize("planes", [8, 3])
def test_soft_argmax_is_the_expectation_over_the_likely_bins(planes, estimator):
    torch.manual_seed(0)
    scores = 3 * torch.randn(2, planes, 5, 9, dtype=torch.float64)
    fine = F.interpolate(
        scores[:, None], size=(4 * planes, 20, 36), mode="trilinear", align_corners=False
    )[:, 0]
    probability = fine.softmax(dim=1)
    if estimator == "mode":
        probability = probability * likely_bins(probability)
    bins = torch.arange(4 * planes, dtype=scores.dtype)[:, None, None]
    expected = (probability * bins).sum(dim=1) / probability.sum(dim=1)
    found = SoftArgmax(4, estimator)(scores)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


def test_mode_keeps_to_one_of_two_surfaces_and_to_the_mean_without_a_clue():
    scores = torch.zeros(1, 48, 1, 2)
    scores[0, 10, 0, 0] = 30  # 41.5 px
    scores[0, 30, 0, 0] = 29  # 121.5 px, less likely
    torn, clueless = SoftArgmax(4, "mode")(scores)[0, 1, [0, 7]]
    assert torn == pytest.approx(41.5, abs=0.1)
    assert clueless == pytest.approx(95.5)
    assert 50 < SoftArgmax(4)(scores)[0, 1, 1] < 80


def test_soft_argmax_at_its_limits():
    even = torch.zeros(1, 8, 1, 1)
    assert SoftArgmax(4)(even)[0, 0, 0].item() == pytest.approx(15.5)
    # A peak at the coarse disparity 3 lies between the fine disparities 13 and 14.
    peak = even.clone()
    peak[:, 3] = 1000
    assert SoftArgmax(4)(peak)[0, 0, 0].item() == pytest.approx(13.5, abs=1e-3)
    for scores in (peak.half(), peak.bfloat16(), -peak, 100 * peak):
        disparity = SoftArgmax(4)(scores)
        assert disparity.dtype == torch.float32
        assert disparity.isfinite().all()


def test_confidence_is_the_probability_near_the_estimate():
    scores = 3 * torch.randn(2, 8, 3, 5, generator=torch.Generator().manual_seed(0))
    fine = F.interpolate(scores[:, None], scale_factor=(4, 1, 1), mode="trilinear")[:, 0]
    expected = torch.zeros(2, 3, 5)
    for place in torch.cartesian_prod(torch.arange(2), torch.arange(3), torch.arange(5)).tolist():
        mass = fine[place[0], :, place[1], place[2]].softmax(0)
        mean = sum(d * float(p) for d, p in enumerate(mass))
        for d, p in enumerate(mass):
            # Whole within 1.5 px; the bin at the border counts in part, so that nothing jumps.
            expected[tuple(place)] += p * min(max(2.5 - abs(d - mean), 0), 1)
    result = SoftArgmax(4).confidence(scores)
    assert result.shape == (2, 12, 20)
    upsampled = F.interpolate(expected[:, None], scale_factor=4, mode="bilinear")[:, 0]
    torch.testing.assert_close(result, upsampled, rtol=0, atol=1e-5)


def test_confidence_of_one_peak_of_two_and_of_none():
    scores = torch.zeros(1, 48, 1, 3)
    scores[0, 20, 0, 0] = 1000  # one peak: the fine bins near 4 * 20 + 1.5
    scores[0, 10, 0, 1] = scores[0, 30, 0, 1] = 1000  # two equal peaks: the mean is between them
    sure, torn, clueless = SoftArgmax(4).confidence(scores)[0, 0, 1::4]
    assert sure > 0.8
    assert torn < 0.25 * float(sure)
    assert clueless < 0.25
    assert SoftArgmax(4).confidence(scores.bfloat16()).dtype == torch.float32


def test_the_papers_loss():
    net = build_model("msnet2d", max_disparity=32)
    outputs = net(*torch.randn(2, 1, 3, 32, 64))
    disparity = torch.full((1, 32, 64), 10.0)
    disparity[:, :, :9] = 40  # beyond the range
    valid = torch.ones_like(disparity, dtype=torch.bool)
    valid[:, :5] = False
    mask = trained_pixels(disparity, valid, 32)
    assert mask.sum() == 27 * 55
    heads = [F.smooth_l1_loss(d[mask], disparity[mask]) for d in outputs.disparities]
    expected = sum(w * loss for w, loss in zip((0.5, 0.5, 0.7, 1.0), heads, strict=True))
    torch.testing.assert_close(net.training_loss(outputs, disparity, mask), expected)
    last = net.training_loss(outputs.last(1), disparity, mask)
    torch.testing.assert_close(last, heads[-1])
    assert net.training_loss(outputs, disparity, mask & False) == 0


CASCADE = {
    "dims": 3,
    "cost_volume": "correlation",
    "coarse_pass": True,
    "coarse_hourglasses": 1,
    "band": 16,
}


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
        ({"coarse_levels": 0}, "coarse_levels must be at least 1, got 0"),
        ({"dims": 3, "coarse_levels": 2}, "coarse_levels=2 needs coarse_pass=true"),
        ({"dims": 3, "band": 16}, "band must be 0.* got 16 with interlaced-4 and 0"),
        ({**CASCADE, "band": 12}, "got 12 with correlation and 1"),
        ({**CASCADE, "coarse_hourglasses": 0}, "got 16 with correlation and 0"),
        ({**CASCADE, "cost_volume": "interlaced-4"}, "got 16 with interlaced-4 and 1"),
        ({"dims": 3, "coarse_hourglasses": 1}, "in a network with coarse_pass, got 1"),
        ({"cost_volume": "groupwise", "groups": 7}, "groups must divide the 32 channels"),
        ({"channel_reduction": False}, "set channel_reduction=True"),
    ],
)
def test_refused_configs(fields, message):
    with pytest.raises(InputError, match=message):
        NetConfig(**{"dims": 2, **fields})


def test_guidance_is_sure_where_the_coarse_pass_is():
    scores = torch.zeros(1, 6, 3, 5)
    scores[0, 2] = 100
    guidance = guidance_from_scores(scores)
    assert guidance.shape == (1, 12, 6, 10)
    # Planes 4 and 5 are nearest to the coarse plane 2; linear in between.
    levels = [0, 0, 0, 0.25, 0.75, 0.75, 0.25, 0, 0, 0, 0, 0]
    expected = torch.tensor(levels)[None, :, None, None].expand_as(guidance)
    torch.testing.assert_close(guidance, expected)
    even = guidance_from_scores(0 * scores)
    torch.testing.assert_close(even, torch.full_like(even, 1 - math.log(6) / 8))
    assert guidance_from_scores(scores.bfloat16()).dtype == torch.bfloat16


def test_coarse_pass():
    torch.manual_seed(0)
    net = build_model("msnet3d", max_disparity=64, hourglasses=1, coarse_pass=True).eval()
    plain = build_model("msnet3d", max_disparity=64, hourglasses=1).eval()
    state = net.state_dict()
    weight = state.pop("guide.weight")
    plain.load_state_dict(state)
    views = torch.randn(2, 1, 3, 64, 128)
    with torch.no_grad():
        # Zero at first: the network is what it was without.
        torch.testing.assert_close(net(*views), plain(*views), rtol=0, atol=0)
        weight.normal_()
        halves = [F.avg_pool2d(view, 2) for view in views]
        half = build_model("msnet3d", max_disparity=32, hourglasses=1).eval()
        half.load_state_dict(state)
        told = guidance_from_scores(half.scores(*halves))
        coarse = guidance_from_scores(net.coarse_scores(*views)[-1])
        torch.testing.assert_close(coarse, told, rtol=0, atol=1e-5)
        planes = net.config.planes
        expected = net.aggregate(net.cost_volume(*views, planes), told)[-1]
        torch.testing.assert_close(net.scores(*views), expected, rtol=0, atol=1e-4)
        assert (expected - plain.scores(*views)).abs().max() > 0.1
    net.train().features.eval()  # frozen for fine-tuning
    assert len(net.coarse_scores(*views)) == 1
    assert net.training and net.pre_hourglass.training and not net.features.training
    net.set_step(4)
    assert not net.coarse_scores(*views)
    with pytest.raises(InputError, match="multiples of 32, got 48 x 128"):
        net(*views[..., :48, :])


def test_each_coarse_pass_guides_the_next_finer_one():
    torch.manual_seed(0)
    fields = {"hourglasses": 1, "coarse_pass": True}
    net = build_model("msnet3d", max_disparity=128, coarse_levels=2, **fields).eval()
    torch.nn.init.normal_(net.guide.weight)
    half = build_model("msnet3d", max_disparity=64, **fields).eval()
    half.load_state_dict(net.state_dict())
    # Half of the size is 80 x 144, to be filled up to 96 x 160.
    views = torch.randn(2, 1, 3, 160, 288)
    with torch.no_grad():
        filled = [F.pad(F.avg_pool2d(view, 2), (0, 16, 0, 16), mode="replicate") for view in views]
        quarter = guidance_from_scores(half.coarse_scores(*filled)[-1])[..., :20, :36]
        halves = [F.avg_pool2d(view, 2) for view in views]
        volume = half.cost_volume(*halves, 16)
        expected = half.aggregate(volume, quarter)[-1]
        torch.testing.assert_close(net.coarse_scores(*views)[-1], expected, rtol=0, atol=1e-4)
        one = build_model("msnet3d", max_disparity=128, **fields).eval()
        one.load_state_dict(net.state_dict())
        assert (one.coarse_scores(*views)[-1] - expected).abs().max() > 0.1


@pytest.mark.parametrize(("disparities", "levels"), [(32, 1), (96, 1), (192, 2), (256, 3)])
def test_planes_limit_the_coarse_passes(disparities, levels):
    config = NetConfig(dims=3, coarse_pass=True, coarse_levels=3, max_disparity=disparities)
    assert config.levels == levels
    assert NetConfig(dims=3).levels == 0


def test_a_coarse_pass_with_weights_of_its_own_learns_with_coarser_ones_and_without():
    net = build_model("msnet3d-cascade", max_disparity=64)
    views = torch.randn(2, 1, 3, 64, 128)
    for step in (1, 4):
        net.set_step(step)
        net.zero_grad()
        scores = net.coarse_scores(*views)
        assert len(scores) == 2 and net.training
        scores[-1].square().sum().backward()
        assert net.coarse.heads[1].score.weight.grad.any()
        assert net.coarse.guide.weight.grad.any() == (step == 1)


def test_bands_lie_around_the_likeliest_disparities():
    scores = torch.zeros(1, 24, 6, 3)
    scores[0, 9, :3] = 100  # planes 18 and 19 of the fine pass
    scores[0, 0, 3:] = 100  # planes 0 and 1
    start = band_start(scores, 16)
    assert start.shape == (1, 12, 6) and start.dtype == torch.int64
    # Of 8..23 and 16..31 the first has them nearer to its middle.
    assert (start[:, :4] == 8).all()
    assert (start[:, 8:] == 0).all()
    scores[0, 9, :3], scores[0, 23, :3] = 0, 100  # planes 46 and 47, the last ones
    assert (band_start(scores, 16)[:, :4] == 48 - 16).all()
    # Of two modes with the same probability it can hold one.
    scores[0, 2, :3] = 100
    assert set(band_start(scores, 16)[0, 0].tolist()) <= {0, 32}
    # A pixel alone follows its neighbours.
    scores = torch.zeros(1, 24, 3, 3)
    scores[0, 9], scores[0, 9, 1, 1], scores[0, 0, 1, 1] = 100, 0, 100
    assert (band_start(scores, 16) == 8).all()


def test_bands_are_cut_from_all_planes_and_spread_to_them():
    volume = torch.randn(2, 24, 3, 5)
    start = 4 * torch.randint(0, 4, (2, 3, 5))
    band = cut_band(volume, start, 12)
    spread = spread_band(band.requires_grad_(), start, 24)
    outputs = VolumeOutputs([spread], None, SoftArgmax(4), Band(start, 12))
    searched = outputs.searched_planes
    assert (searched.sum(dim=1) == 12).all()
    assert not torch.autograd.grad(spread[~searched].sum(), band, retain_graph=True)[0].any()
    assert (torch.autograd.grad(spread[searched].sum(), band)[0] == 1).all()
    spread = spread.detach()
    for index in itertools.product(range(2), range(3), range(5)):
        b, y, x = index
        first = int(start[index])
        assert band[b, :, y, x].equal(volume[b, first : first + 12, y, x])
        outside = [*range(first), *range(first + 12, 24)]
        assert spread[b, first : first + 12, y, x].equal(band[b, :, y, x])
        assert (spread[b, outside, y, x] == band[b, :, y, x].min() - 2).all()


def test_the_volume_of_a_band_is_part_of_the_whole():
    volume = Correlation(groups=4)
    left, right = torch.randn(2, 2, 8, 3, 20)
    start = 4 * torch.randint(0, 3, (2, 3, 20))
    band = volume(left, right, 8, start)
    whole = volume(left, right, 16)
    for i in range(8):
        expected = whole.gather(2, (start + i)[:, None, None].expand(-1, 4, 1, -1, -1))[:, :, 0]
        torch.testing.assert_close(band[:, :, i], expected)
    assert not band[:, :, 1:, :, 0].any()  # the first column has no partner


def test_a_band_of_all_planes_changes_nothing():
    torch.manual_seed(0)
    config = {"max_disparity": 64, "hourglasses": 1, "coarse_pass": True}
    config["coarse_hourglasses"] = 1
    whole, cascade = (
        build_model("msnet3d", **config, band=band).double().eval() for band in (0, 16)
    )
    cascade.load_state_dict(whole.state_dict())
    views = torch.randn(2, 1, 3, 64, 128, dtype=torch.float64)
    with torch.no_grad():
        torch.testing.assert_close(cascade(*views), whole(*views), rtol=0, atol=1e-10)
        narrow = build_model("msnet3d", **config, band=8).double().eval()
        narrow.load_state_dict(whole.state_dict())
        scores = narrow.scores(*views)
    lowest = scores.amin(dim=1, keepdim=True)
    assert ((scores == lowest).sum(dim=1) == 8).all()  # the eight planes outside


def test_a_cascade_learns_both_of_its_passes():
    net = build_model("msnet3d-cascade", max_disparity=128)
    views = torch.randn(2, 1, 3, 32, 160)
    outputs = net.outputs(*views)
    assert outputs.volume.shape == (1, 40, 16, 8, 40)
    assert [scores.shape for scores in outputs.scores] == 4 * [(1, 32, 8, 40)]
    assert [scores.shape for scores in outputs.coarse.scores] == 2 * [(1, 32, 8, 40)]
    disparity = torch.zeros(1, 32, 160)
    start = outputs.band.start
    # Planes lie at 1.5 px, 5.5 px, and so on.
    for plane, inside in ((-1, False), (0, True), (15, True), (16, False)):
        disparity[:, 2::4, 2::4] = 4 * (start + plane) + 1.5
        assert (outputs.searched(disparity)[:, 2::4, 2::4] == inside).all()
    assert outputs.coarse.searched(disparity).all()
    # Only the coarse pass learns from a disparity that is not in the band.
    far = (4.0 * (start + 20)).repeat_interleave(4, 1).repeat_interleave(4, 2)
    net.training_loss(outputs, far, torch.ones_like(far, dtype=torch.bool)).backward()
    assert net.coarse.heads[1].score.weight.grad.any()
    assert not net.heads[3].score.weight.grad.any()


def test_the_coarse_pass_of_a_cascade_starts_as_the_fine_one():
    torch.manual_seed(0)
    whole = build_model("msnet3d", max_disparity=64, coarse_pass=True).eval()
    cascade = build_model("msnet3d-cascade", max_disparity=64).eval()
    state = cascade.state_of_config(cascade.config, whole.state_dict())
    cascade.load_state_dict(state)
    views = torch.randn(2, 1, 3, 64, 128)
    head = whole.heads[1]
    assert cascade.coarse.heads[1].score.weight.equal(head.score.weight)
    assert cascade.coarse.hourglasses[0].up6[0].weight.equal(whole.hourglasses[0].up6[0].weight)
    assert len(cascade.coarse_scores(*views)) == 1
    # Trained weights stay as they are.
    state["coarse.guide.weight"] = torch.ones_like(state["guide.weight"])
    kept = cascade.state_of_config(cascade.config, state)
    assert kept.keys() == state.keys() and kept["coarse.guide.weight"].eq(1).all()
    # A range that leaves room for one coarse pass alone, and weights that had but one.
    narrow = replace(cascade.config, max_disparity=96)
    assert "coarse.guide.weight" not in cascade.state_of_config(narrow, state)
    assert "coarse_levels" not in cascade.config_of_state(cascade.config, state)
    deeper = replace(cascade.config, coarse_hourglasses=2)  # it was trained with one
    names = cascade.state_of_config(deeper, state)
    assert not any(name.startswith("coarse.hourglasses.1") for name in names)
    del state["coarse.guide.weight"]
    assert cascade.config_of_state(cascade.config, state)["coarse_levels"] == 1
    shared = cascade.state_of_config(whole.config, state)
    assert not any(name.startswith("coarse.") for name in shared)


def test_a_network_cut_after_its_first_hourglass():
    torch.manual_seed(0)
    net = build_model("msnet3d", max_disparity=64)
    cut = build_model("msnet3d", max_disparity=64, hourglasses=1)
    cut.load_state_dict(cut.state_of_config(cut.config, net.state_dict()))
    net.train().apply(lambda layer: layer.eval() if not list(layer.children()) else None)
    views = torch.randn(2, 1, 3, 32, 80)
    with torch.no_grad():
        second_head = net.outputs(*views).scores[1]  # in training mode, with eval norms
        torch.testing.assert_close(cut.eval().scores(*views), second_head)


def test_refused_names_and_overrides():
    with pytest.raises(InputError, match=r"unknown model 'msnet-2d'.*msnet2d"):
        build_model("msnet-2d")
    with pytest.raises(InputError, match=r"msnet2d has no value .colour."):
        build_model("msnet2d", colour="red")


TINY = """
from dataclasses import dataclass
import torch
from mobilestereonet.nets import Prediction, StereoModel

@dataclass(frozen=True)
class TinyConfig:
    max_disparity: int = 64
    slope: float = 2.0

class Tiny(StereoModel):
    config: TinyConfig

    def __init__(self, config):
        super().__init__(config)
        self.scale = torch.nn.Parameter(torch.tensor(config.slope))

    def forward(self, left, right):
        return Prediction(self.scale * (left - right).abs().mean(dim=1))
"""


def test_networks_of_the_users_own(tmp_path):
    (tmp_path / "tiny.py").write_text(TINY)
    name = f"{tmp_path}/tiny.py:Tiny"
    net = build_model(name, slope=3.0)
    assert isinstance(net, StereoModel) and net.scale == 3 and net.max_disparity == 64
    prediction = net(torch.ones(1, 3, 16, 16), torch.zeros(1, 3, 16, 16))
    assert prediction.disparity.eq(3).all() and prediction.confidence is None
    assert model_name(build_model(name).config) == name
    with pytest.raises(InputError, match=r"no value 'slop' \(did you mean slope\?\)"):
        build_model(name, slop=1)
    with pytest.raises(InputError, match=r"Big is no subclass of mobilestereonet\.StereoModel"):
        build_model(f"{tmp_path}/tiny.py:Big")
    with pytest.raises(FileNotFoundError, match=r"absent\.py"):
        build_model(f"{tmp_path}/absent.py:Tiny")
    (tmp_path / "broken.py").write_text("1 / 0")
    with pytest.raises(InputError, match="cannot be imported: ZeroDivisionError"):
        build_model(f"{tmp_path}/broken.py:Tiny")


def test_register_model():
    @dataclass(frozen=True)
    class Config:
        max_disparity: int = 48

    @register_model("test-registered", paper="none")
    class Net(StereoModel):
        config: Config

    try:
        assert type(build_model("test-registered", max_disparity=32)) is Net
        assert list_models("test-*") == ["test-registered"]
    finally:
        del registry._MODELS["test-registered"]


def test_refused_inputs():
    net = build_model("msnet2d", max_disparity=32, hourglasses=1)
    with pytest.raises(InputError, match="multiples of 16, got 30 x 64"):
        net(*torch.randn(2, 1, 3, 30, 64))
    with pytest.raises(InputError, match=r"\(1, 3, 32, 64\) and \(1, 3, 32, 48\)"):
        net(torch.randn(1, 3, 32, 64), torch.randn(1, 3, 32, 48))
    with pytest.raises(InputError, match=r"\(1, 1, 32, 64\)"):
        net(*torch.randn(2, 1, 1, 32, 64))


def test_fresh_weights_are_drawn_as_the_authors_draw_them():
    torch.manual_seed(0)
    net = MobileStereoNet(NetConfig(dims=2))
    conv = net.reduction[0][0]  # 1x1, 320 -> 256 channels
    assert conv.weight.shape == (256, FEATURE_CHANNELS, 1, 1)
    assert conv.weight.std().item() == pytest.approx(math.sqrt(2 / 256), rel=0.02)
    assert abs(conv.weight.mean().item()) < 0.001
    depthwise = net.features.stage2[3].conv1[0]  # 3x3 of 64 groups
    assert depthwise.weight.std().item() == pytest.approx(math.sqrt(2 / (9 * 64)), rel=0.1)
