"""MC-CNN and its stereo method against the authors' kernels, step by step, in float64."""

from pathlib import Path

import numpy as np
import pytest
import torch

from mobilestereonet.accelerate import accelerate
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model, model_name
from mobilestereonet.nets.cross_based import aggregate, cross_arms, semi_global_matching
from mobilestereonet.nets.disparity_refinement import (
    bilateral,
    fill_mismatched,
    fill_occluded,
    median,
    outliers,
    subpixel,
)
from mobilestereonet.nets.mccnn import intensities
from mobilestereonet.weights.shapes import count_parameters
from parity import fill

# Of volumes, (12, 20, 36), every third row and column; maps whole.
STEPS = np.load(Path(__file__).parents[1] / "data/mccnn_steps.npz")
LEFT, RIGHT = (torch.from_numpy(STEPS[view]) for view in ("left", "right"))
PARAMETERS = {
    "fast": {"p1": 4.0, "p2": 55.72, "q2": 2.5, "alpha": 1.5, "step": 0.02, "blur": 7.74},  # 2012
    "slow": {},
}


def released_key(key):
    return key.replace("convs.", "conv.").replace("compare.", "fc.")


@pytest.fixture(scope="module", params=PARAMETERS)
def released(request):
    net = build_model(f"mccnn-{request.param}", max_disparity=12, **PARAMETERS[request.param])
    own = net.state_dict()
    state = fill({released_key(key): value.shape for key, value in own.items()})
    net.load_state_dict({key: state[released_key(key)] for key in own})
    return request.param, net.double().eval()


@torch.inference_mode()
def test_every_step(released):
    name, net = released
    config = net.config

    def check(step, found):
        expected = STEPS[f"{name}-{step}"]
        found = torch.where(found == torch.inf, torch.nan, found.double()).numpy()
        found = found[:, ::3, ::3] if len(found) == 12 else found
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6, err_msg=step)

    arms = [cross_arms(view, config.arm, config.arm_intensity) for view in (LEFT, RIGHT)]
    check("cross_left", torch.stack(arms[0]))
    check("cross_right", torch.stack(arms[1]))
    features = [net.features(view[None, None])[0] for view in (LEFT, RIGHT)]
    compared = net.volume(*features)
    best = {}
    for view, side in (("right", 1), ("left", -1)):
        volume = net.for_right(compared) if side == 1 else net.at_border(compared, -1)
        check(f"volume_{view}", volume)
        for _ in range(config.rounds_before):
            volume = aggregate(volume, *arms, side)
        check(f"{view}_cbca1", volume)
        volume = semi_global_matching(volume, LEFT, RIGHT, side, config.penalties)
        check(f"{view}_sgm", volume)
        for _ in range(config.rounds_after):
            volume = aggregate(volume, *arms, side)
        check(f"{view}_cbca2", volume)
        best[view] = volume.argmin(dim=0)
        check(f"{view}_argmin", best[view])
    classes = outliers(best["left"], best["right"], 12)
    check("outlier", classes)
    check("occlusion", occlusion := fill_occluded(best["left"].double(), classes))
    check("mismatch", mismatch := fill_mismatched(occlusion, classes))
    check("subpixel", fine := subpixel(mismatch, volume))
    check("median", smooth := median(fine))
    check("bilateral", bilateral(smooth, config.blur, config.blur_threshold))
    check("bilateral", net.match(*features, LEFT, RIGHT))


@pytest.mark.parametrize(("name", "params"), [("fast", 111_424), ("slow", 870_449)])
def test_parameters(name, params):
    assert count_parameters(f"mccnn-{name}") == params


@torch.inference_mode()
def test_intensities():
    view = torch.rand(2, 3, 8, 9, dtype=torch.float64)
    grey = intensities(view)
    assert grey.shape == (2, 1, 8, 9)
    flat = grey.flatten(1)
    torch.testing.assert_close(flat.mean(dim=1), torch.zeros(2).double())
    torch.testing.assert_close(flat.std(dim=1), torch.ones(2).double())
    shares = torch.tensor([0.299, 0.587, 0.114]).double()
    expected = torch.corrcoef(torch.stack((torch.tensordot(shares, view[0], 1).flatten(), flat[0])))
    assert expected[0, 1] == pytest.approx(1)
    assert intensities(torch.full_like(view, 0.5)).abs().max() < 1


@pytest.mark.parametrize("name", ["mccnn-fast", "mccnn-slow"])
def test_training_lowers_the_loss_on_a_batch(name):
    torch.manual_seed(0)
    net = build_model(name, max_disparity=16, width=8, hidden_width=16)
    left = torch.rand(1, 3, 24, 64)
    right = left.roll(-5, dims=-1)
    truth, valid = torch.full((1, 24, 64), 5.0), torch.ones(1, 24, 64, dtype=torch.bool)
    truth[0, 0, 0], valid[0, 0, 0] = torch.nan, False
    optimizer = torch.optim.Adam(net.parameters(), lr=0.01)
    losses = []
    for _ in range(5):
        torch.manual_seed(1)
        loss = net.training_loss(net(left, right), truth, valid)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]
    assert net.training_loss(net(left, right), truth, valid & False) == 0


@torch.inference_mode()
def test_a_shift_is_found():
    net = build_model("mccnn-fast", max_disparity=16).eval()
    texture = torch.rand(1, 3, 40, 86)
    disparity = net(texture[..., :80], texture[..., 6:]).disparity
    assert (disparity[0, :, 16:] - 6).abs().median() < 0.1


def test_no_graph_is_made_of_it():
    net = build_model("mccnn-fast", max_disparity=16)
    with pytest.raises(InputError, match=r"MCCNN cannot be exported: .* use the engine torch"):
        accelerate(net, "export")


def test_parameters_of_the_method_do_not_change_the_name():
    assert model_name(build_model("mccnn-fast", p1=4.0).config) == "mccnn-fast"
    assert model_name(build_model("mccnn-slow", max_disparity=64).config) == "mccnn-slow"


def test_views_narrower_than_the_range_have_no_nan():
    net = build_model("mccnn-slow", max_disparity=64).eval()
    with torch.no_grad():
        disparity = net(*torch.randn(2, 1, 3, 20, 40)).disparity
    assert disparity.isfinite().all()
    assert 0 <= disparity.min() <= disparity.max() < 64
