"""Parity of the networks that regress disparity maps with their releases, in float64."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from extras import SHARED, needs_shared
from mobilestereonet.costs import count_costs
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from mobilestereonet.nets.regression import coarse_l1
from mobilestereonet.weights.caffe import caffe_key
from mobilestereonet.weights.files import WeightsFile
from mobilestereonet.weights.reversing import from_reversing, reversing_key
from parity import fill, pair

# Every third row and column of full-size outputs for views of 64 x 192; smaller ones whole.
OUTPUTS = np.load(Path(__file__).parents[1] / "data/regression_seed7_h64_w192.npz")

# Changes to the drawn weights by the released names, in this order: their factor and what is added
# to all elements of a bias, or to the first. They keep outputs from being flat or clipped.
CHANGES = {
    "crl": [(r"^Convolution13\.bias$", 1, -6)],
    "iresnet": [(r"^Convolution22\.bias$", 1, -6)],
    "iresnet_torch": [(r"^disparity_estimation\.disp0\.0\.0\.bias$", 1, 6)],
    "dispnet_c": [(r"^upper\.decoder\.refine_2\.predict\.conv\.bias$", 1, -8)],
    "dispnet_c_occ": [(r"^upper\.decoder\.refine_2\.predict\.conv\.bias$", 1, -8)],
    "autodispnet_c": [
        (r"\.weight$", 0.75, 0),
        (r"^predict\.[0-3]\.weight$", 2, 0),
        (r"^predict\.4\.weight$", 4, 0),
        (r"^predict\.[0-3]\.bias$", 1, -1),
        (r"^predict\.4\.bias$", 1, -6),
    ],
}

DISPNET_C = [
    (r"conv([123])\.0", r"features.conv\1"),
    (r"redirect\.0", r"upper.encoder.conv_redir"),
    (r"conv3_1\.0", r"upper.encoder.conv3_1"),
    (r"conv(\d)\.0\.0", r"upper.encoder.conv\1"),
    (r"conv(\d)\.1\.0", r"upper.encoder.conv\1_1"),
    (r"predictors\.0", r"upper.encoder.predict.conv"),
    (r"predictors\.(\d)", lambda m: f"upper.decoder.refine_{6 - int(m[1])}.predict.conv"),
    (r"ups\.(\d)\.0", lambda m: f"upper.decoder.refine_{5 - int(m[1])}.deconv"),
]


def dispnet_c_key(key):
    pattern, name = next(rule for rule in DISPNET_C if re.match(rule[0] + r"\.[wb]", key))
    return re.sub(pattern, name, key, count=1)


AUTODISPNET_C = [
    (r"^(stems\.\d|predictors\.\d)(\.0)?\.(?=[wb])", r"\1."),
    (r"^predictors", "predict"),
    (r"^feature_cell\.", "feature_cells.0."),
    (r"\.before\.0", ".preprocess0"),
    (r"\.last\.0", ".preprocess1"),
    (r"\.prediction\.0", ".preprocess_pred"),
    (r"\.skip\.0", ".preprocess_support"),
    (r"\.up\.(\d)\.0", r".upsample\1"),
    (r"\.cell\.operations\.", ".ops."),
    (r"(\.ops\.\d)\.0\.(?=[wb])", r"\1."),
]


def autodispnet_c_key(key):
    for pattern, name in AUTODISPNET_C:
        key = re.sub(pattern, name, key)
    return key


@dataclass
class Case:
    """A network of a release.

    Attributes:
        name: Our name of the network.
        key: The release's name for one of ours.
        outputs: What the fixture holds, from the network, its outputs and the views.
        fields: Values of the config.
    """

    name: str
    key: Callable
    outputs: Callable
    fields: dict = field(default_factory=dict)


def aligned(prediction):
    """A prediction at full size, corners aligned."""
    prediction = prediction.reshape(1, 1, *prediction.shape[-2:])
    return F.interpolate(prediction, size=(64, 192), mode="bilinear", align_corners=True)


def dispnet_c_outputs(_, outputs, *views):
    raw = {f"raw{6 - i}": -prediction for i, prediction in enumerate(outputs.predictions)}
    return raw | {"disparity": outputs.disparity}


CASES = {
    "dispnet_c": Case("dispnet-c", dispnet_c_key, dispnet_c_outputs),
    "dispnet_c_occ": Case(
        "dispnet-c",
        dispnet_c_key,
        lambda _, outputs, *views: {"disparity": outputs.disparity, "occ": outputs.occlusion},
        {"occlusion": True},
    ),
    "autodispnet_c": Case(
        "autodispnet-c",
        autodispnet_c_key,
        lambda _, outputs, *views: {
            "disparity": outputs.disparity,
            **{f"raw{6 - i}": raw.neg().clamp_max(0) for i, raw in enumerate(outputs.predictions)},
        },
    ),
    "crl": Case(
        "crl",
        lambda key: caffe_key(key, "crl"),
        lambda _, outputs, *views: {
            "disparity": outputs.disparity,
            "stage1": outputs.predictions[6].clamp_min(0),
        },
    ),
    "iresnet": Case(
        "iresnet",
        lambda key: caffe_key(key, "iresnet"),
        lambda _, outputs, *views: {
            "disparity": outputs.disparity,
            "initial": outputs.predictions[0],
            "iteration1": outputs.predictions[3].clamp_min(0),
        },
    ),
    "iresnet_torch": Case(
        "iresnet-reversing",
        reversing_key,
        lambda net, outputs, *views: {
            "disparity": outputs.predictions[-1],  # the release's tester clamps it
            "disp0": outputs.predictions[0],
            "res1": aligned(outputs.predictions[2]),
            "disp2": aligned(net.stage(*views).predictions[4]),
        },
    ),
}


def drawn(case, fixture, net):
    """A state dict of our names, drawn by the released ones."""
    own = {key: value.shape for key, value in net.state_dict().items() if key != "means"}
    state = fill({case.key(key): shape for key, shape in own.items()})
    for pattern, factor, added in CHANGES[fixture]:
        for key in filter(re.compile(pattern).search, state):
            state[key] *= factor
            state[key][:1] += added
    if case.key is reversing_key:
        return from_reversing(WeightsFile("drawn", state)).state
    return {key: state[case.key(key)] for key in own}


@pytest.fixture(scope="module", params=CASES)
def released(request):
    """Name of a fixture and the network of its weights, which takes what the fixture took."""
    case = CASES[request.param]
    with torch.device("meta"):
        net = build_model(case.name, **case.fields).eval()
    state = drawn(case, request.param, net)
    if "means" in net.state_dict():
        state["means"] = torch.zeros(2, 3)  # the views are without mean
    net.load_state_dict(state, assign=True)
    return request.param, net.double()


def views(fixture, seed=7, size=(64, 192)):
    views = pair(seed, *size).double()
    return views.flip(2) if fixture in ("crl", "iresnet") else views  # BGR


@torch.inference_mode()
def test_outputs(released):
    fixture, net = released
    pair = views(fixture)
    found = CASES[fixture].outputs(net, net.outputs(*pair), *pair)
    assert {f"{fixture}-{output}" for output in found} == {
        key for key in OUTPUTS if key.partition("-")[0] == fixture
    }
    for output, values in found.items():
        values = values.squeeze().numpy()
        if values.shape[-2:] == (64, 192):
            values = values[..., ::3, ::3]
        error = np.abs(values - OUTPUTS[f"{fixture}-{output}"].squeeze()).max()
        assert error < 1e-6, output


@needs_shared
@torch.inference_mode()
def test_outputs_at_another_size(released):
    fixture, net = released
    outputs = np.load(SHARED / "parity" / f"{fixture}.npz")
    key = next(key for key in outputs if key.startswith("seed8"))
    pair = views(fixture, 8, outputs[key].shape)
    found = CASES[fixture].outputs(net, net.outputs(*pair), *pair)["disparity"]
    assert np.abs(found[0].numpy() - outputs[key]).max() < 1e-6


@torch.inference_mode()
def test_dispnet_corr1d_is_the_first_stage_of_crl():
    torch.manual_seed(0)
    crl, net = (build_model(name, width=8).double() for name in ("crl", "dispnet-corr1d"))
    net.stage.load_state_dict(crl.stage1.state_dict())
    views = torch.rand(2, 1, 3, 64, 128, dtype=torch.float64)
    outputs, expected = net.outputs(*views), crl.outputs(*views).predictions[:6]
    for found, other in zip(outputs.predictions, expected, strict=True):
        assert found.equal(other)
    half = F.interpolate(expected[-1].clamp_min(0)[None], scale_factor=2, mode="bilinear")[0]
    torch.testing.assert_close(outputs.disparity, half)


@pytest.mark.parametrize(
    ("name", "params", "macs"),
    [
        ("dispnet-c", 38_307_785, 13.19),
        ("dispnet-corr1d", 42_430_107, None),
        ("autodispnet-c", 36_989_773, 9.67),
        ("crl", 78_765_599, 99.43),
        ("iresnet", 43_352_290, 54.14),
        ("iresnet-reversing", 42_756_290, None),
    ],
)
def test_parameters_and_macs(name, params, macs):
    total = count_costs(name)["total"]
    assert total.params == total.paper_params == params
    if macs:
        assert round(total.macs / 1e9, 2) == macs


def test_coarse_l1_is_that_of_the_mean_of_the_valid_pixels():
    disparity = torch.tensor([[[4.0, 6.0, 9.0, float("nan")], [2.0, 8.0, float("nan"), 7.0]]])
    valid = torch.tensor([[[1, 1, 1, 0], [0, 0, 0, 0]]], dtype=torch.bool)
    prediction = torch.tensor([[[6.0, 5.0]]], requires_grad=True)
    loss = coarse_l1(prediction, disparity, valid)
    assert loss == (1 + 4) / 2
    loss.backward()
    assert prediction.grad.tolist() == [[[0.5, -0.5]]]
    assert coarse_l1(prediction, disparity, valid & False) == 0


@pytest.mark.parametrize("name", ["dispnet-c", "dispnet-corr1d", "crl", "iresnet"])
def test_refused_widths(name):
    with pytest.raises(InputError, match="width must be a positive multiple of 8, got 12"):
        build_model(name, width=12)
