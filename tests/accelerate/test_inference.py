import copy
import math

import pytest
import torch
from torch import nn
from torch.utils._python_dispatch import TorchDispatchMode

from mobilestereonet.accelerate import accelerate, onednn, rows
from mobilestereonet.accelerate.export_volumes import (
    cut_to,
    fill_without_sizes,
    guidance_in_four_dimensions,
)
from mobilestereonet.accelerate.fused import fuse_convolutions
from mobilestereonet.accelerate.inference import (
    columns_first,
    drop_training_heads,
    few_images_at_a_time,
    volume_by_planes,
)
from mobilestereonet.accelerate.norms import fold_norms
from mobilestereonet.accelerate.rows import process_by_rows
from mobilestereonet.accelerate.soft_argmax import (
    ClosedFormSoftArgmax,
    flat_ends,
    use_closed_form,
)
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model, list_models, msnet
from mobilestereonet.nets.blocks import V2Block
from mobilestereonet.nets.coarse_pass import fill, guidance_from_scores, spread_band
from mobilestereonet.nets.soft_argmax import SoftArgmax
from mobilestereonet.weights import load_model
from parity import OUTPUTS, authors_state, largest_error

STEPS = (
    fold_norms,
    use_closed_form,
    few_images_at_a_time,
    drop_training_heads,
    volume_by_planes,
    columns_first,
    process_by_rows,
    fuse_convolutions,
)
NAMES = ["msnet2d", "msnet3d", "msnet3d-authors", "baseline2d", "baseline3d"]
NAMES += [name for name in list_models() if name.startswith("table2-")]
NAMES += ["table3a-v1-v1", "table3a-v2-v2", "table3b-v1-v1", "table3b-v2-v2"]


def network(name, **fields):
    """In eval mode, with weights and statistics that leave the soft-argmax soft."""
    torch.manual_seed(0)
    net = build_model(name, **{"max_disparity": 32, **fields}).eval()
    for key, value in net.state_dict().items():
        if key.endswith("running_mean"):
            value.normal_(std=0.1)
        elif value.ndim == 1 and value.is_floating_point():
            value.uniform_(0.7, 1.3) if not key.endswith("bias") else value.normal_(std=0.1)
        elif key == "guide.weight":
            value.normal_()
    left, right = torch.randn(2, 2, 3, 32, 64)
    with torch.no_grad():
        scores = net.scores(left, right)
        net.heads[-1].score.weight /= scores.std()
    return net, left, right


def slices_of(monkeypatch, size):
    """Cut blocks into slices of about ``size`` bytes: at these sizes one would hold them whole."""
    monkeypatch.setattr(rows, "SLICE_BYTES", size)
    monkeypatch.setattr(rows, "MIN_ROWS", 1)


COARSE = ("msnet3d", {"max_disparity": 64, "coarse_pass": True, "coarse_levels": 2})
CASCADE = ("msnet3d-cascade", {"max_disparity": 64, "band": 8})


@pytest.mark.parametrize(
    ("name", "fields"),
    [*((name, {}) for name in NAMES), COARSE, CASCADE],
)
def test_every_step_keeps_the_result(name, fields, monkeypatch):
    slices_of(monkeypatch, 10000)
    net, left, right = network(name, **fields)
    net, left, right = net.double(), left.double(), right.double()
    with torch.inference_mode():
        expected = net(left, right)
        # Neither one value nor the ends of the range everywhere.
        assert 0.5 < expected.disparity.std() < 0.4 * net.max_disparity
        for step in STEPS:
            step(net)
            # One by one in the final networks alone: it takes long.
            if name in ("msnet2d", "msnet3d") or step is STEPS[-1]:
                torch.testing.assert_close(net(left, right), expected, rtol=0, atol=1e-6)
    assert not any(isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d) for module in net.modules())


def test_small_views_go_through_the_features_together(monkeypatch):
    net, left, right = network("msnet2d")
    net, left, right = net.double(), left.double(), right.double()
    fast = accelerate(net, "inference")
    batches = []
    fast.features.register_forward_hook(lambda _, inputs, __: batches.append(len(inputs[0])))
    with torch.inference_mode():
        together = fast(left, right).disparity
        monkeypatch.setattr(msnet, "SMALL_VIEW_PIXELS", 1)
        torch.testing.assert_close(fast(left, right).disparity, together, rtol=0, atol=1e-9)
    assert batches == [2 * len(left), len(left), len(left)]


@pytest.mark.parametrize("name", ["msnet2d", "msnet3d"])
def test_equals_the_authors_networks(name, tmp_path):
    torch.save(authors_state(name), tmp_path / "checkpoint.ckpt")
    net = accelerate(load_model(tmp_path / "checkpoint.ckpt").double(), "inference")
    assert largest_error(net, torch.float64, OUTPUTS[name], seed=7) < 1e-6


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-4), (torch.bfloat16, 0.5)])
@pytest.mark.parametrize("name", ["msnet2d", "msnet3d", "table3a-v1-v1", "table3b-v2-v2"])
def test_fused_operators_round_and_no_more(name, dtype, tolerance, monkeypatch):
    slices_of(monkeypatch, 10000)
    net, left, right = network(name)
    with torch.inference_mode():
        expected = copy.deepcopy(net).double()(left.double(), right.double()).disparity
        views = (view.to(dtype, memory_format=torch.channels_last) for view in (left, right))
        disparity = accelerate(net, "inference").to(dtype)(*views).disparity
    assert disparity.dtype == torch.float32
    assert (disparity - expected).abs().mean() < tolerance


@pytest.mark.parametrize("size", [1, 5600, 24000])
@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize(
    ("outputs", "stride", "dilation"), [(4, 1, 1), (6, 1, 1), (4, 1, 2), (6, 2, 1)]
)
def test_a_block_in_slices(dims, outputs, stride, dilation, size, monkeypatch):
    slices_of(monkeypatch, size)
    torch.manual_seed(0)
    block = V2Block(dims, 4, outputs, expansion=3, stride=stride, dilation=dilation)
    layers = nn.Sequential(block, nn.ReLU()).double().eval()
    for module in layers.modules():
        if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
            module.running_mean.normal_()
            module.bias.data.normal_(std=3)  # so that padding differs from the value around it
    for height in (1, 2, 11):
        x = torch.randn(2, 4, height, *[5] * (dims - 2), 7, dtype=torch.float64)
        sliced = copy.deepcopy(layers)
        with torch.inference_mode():
            expected = layers(x)
            for step in (fold_norms, process_by_rows, fuse_convolutions):
                step(sliced)
            torch.testing.assert_close(sliced(x), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-4)])
@pytest.mark.parametrize("size", [1, 24000])
@pytest.mark.parametrize("relu", [False, True])
def test_a_block_adds_its_rows_to_another_tensor(relu, size, dtype, tolerance, monkeypatch):
    slices_of(monkeypatch, size)
    torch.manual_seed(0)
    x, onto = torch.randn(2, 2, 4, 11, 5, 7).to(dtype)
    before = x.clone()
    layers = nn.Sequential(V2Block(3, 4, 4, expansion=3)).to(dtype).eval()
    with torch.inference_mode():
        expected = onto + layers(x)
        for step in (fold_norms, process_by_rows, fuse_convolutions):
            step(layers)
        found = layers[0](x, onto, relu=relu)
    assert found is onto and x.equal(before)
    expected = expected.relu() if relu else expected
    torch.testing.assert_close(found, expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize("estimator", ["mean", "mode"])
@pytest.mark.parametrize("spread", [0.3, 3, 12])
def test_planes_outside_of_bands_are_one_term_of_the_closed_form(estimator, spread, monkeypatch):
    torch.manual_seed(0)
    band = torch.randn(1, 16, 12, 150, dtype=torch.float64) * spread
    start = 8 * torch.randint(1, 4, (1, 3, 3)).repeat_interleave(4, 1).repeat_interleave(50, 2)
    scores = spread_band(band, start, 48)
    left_out = []

    def recorded(tile):
        left_out.append(flat_ends(tile))
        return left_out[-1]

    monkeypatch.setattr("mobilestereonet.accelerate.soft_argmax.flat_ends", recorded)
    plain = SoftArgmax(4, estimator)
    found = ClosedFormSoftArgmax(plain)(scores)
    torch.testing.assert_close(found, plain(scores), rtol=0, atol=1e-9)
    assert len(left_out) == 9 and all(min(ends) > 0 for ends in left_out)


@pytest.mark.parametrize(
    ("score", "pixels", "left_out"),
    [(2, slice(None), (4, 3)), (0, slice(None), (0, 0)), (-2, slice(None), (0, 0)), (2, 3, (0, 0))],
)
def test_flat_ends_that_may_be_likeliest_are_kept(score, pixels, left_out):
    scores = torch.zeros(1, 12, 5, 70, dtype=torch.float64)
    scores[:, 6, pixels] = score
    assert flat_ends(scores) == left_out
    plain = SoftArgmax(4, "mode" if any(left_out) else "mean")
    found = ClosedFormSoftArgmax(plain)(scores)
    torch.testing.assert_close(found, plain(scores), rtol=0, atol=1e-9)


@pytest.mark.parametrize(("planes", "score"), [(8, 0.6), (10, 0.1), (11, 0.1), (48, 0.1), (48, 9)])
def test_a_flat_end_beside_a_likelier_plane_at_the_other_one(planes, score):
    scores = torch.zeros(1, planes, 3, 3, dtype=torch.float64)
    scores[:, -1] = score
    plain = SoftArgmax(4, "mode")
    found = ClosedFormSoftArgmax(plain)(scores)
    torch.testing.assert_close(found, plain(scores), rtol=0, atol=1e-9)


@pytest.mark.parametrize("conv3d_as_2d", [False, True])
@pytest.mark.parametrize(
    ("name", "fields"),
    [(name, {}) for name in NAMES] + [COARSE, ("msnet2d", {"estimator": "mode"}), CASCADE],
)
def test_form_for_export(name, fields, conv3d_as_2d):
    net, left, right = network(name, **fields)
    net, left, right = net.double(), left[:1].double(), right[:1].double()
    with torch.inference_mode():
        prediction, scores = net(left, right), net.scores(left, right)
        graph = accelerate(net, "export", conv3d_as_2d=conv3d_as_2d)
        for name, found in zip(graph.outputs, graph(left, right), strict=True):
            torch.testing.assert_close(found, getattr(prediction, name), rtol=0, atol=1e-9)
        graph = accelerate(net, "export", scores=True, conv3d_as_2d=conv3d_as_2d)
        torch.testing.assert_close(graph(left, right), scores, rtol=0, atol=1e-9)


def test_guidance_in_four_dimensions():
    torch.manual_seed(0)
    scores = 4 * torch.randn(2, 6, 3, 5, dtype=torch.float64)
    found, expected = guidance_in_four_dimensions(scores), guidance_from_scores(scores)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("size", [(16, 48), (32, 16), (64, 96)])
def test_views_are_filled_without_their_size(size):
    views = torch.randn(2, 3, *size, dtype=torch.float64)
    filled = fill(views)
    assert filled.shape[2:] == tuple(32 * math.ceil(side / 32) for side in size)
    assert fill_without_sizes(views).equal(filled)
    assert cut_to(filled, views).equal(views)


def test_unknown_purposes():
    with pytest.raises(InputError, match="unknown purpose 'speed': choose one of inference, tr"):
        accelerate(build_model("msnet2d", max_disparity=32), "speed")


def test_norms_stay_in_training():
    with pytest.raises(InputError, match=r"eval mode: call net\.eval"):
        fold_norms(build_model("msnet2d", max_disparity=32))


def test_the_network_given_stays_as_it_is():
    net = network("msnet2d")[0]
    state = {key: value.clone() for key, value in net.train().state_dict().items()}
    accelerate(net, "inference")
    assert net.training
    assert net.state_dict().keys() == state.keys()
    assert all(value.equal(state[key]) for key, value in net.state_dict().items())


VIEWS = {"permute", "select", "slice", "split", "squeeze", "t", "transpose", "unsqueeze", "view"}


class Operators(TorchDispatchMode):
    """Counts operators by name, but for views; notes the largest tensor that one makes."""

    def __init__(self):
        super().__init__()
        self.counts = {}
        self.largest = 0

    def __torch_dispatch__(self, operator, types, args=(), kwargs=None):
        result = operator(*args, **(kwargs or {}))
        name = operator.overloadpacket.__name__
        if name not in VIEWS:
            self.counts[name] = self.counts.get(name, 0) + 1
        if isinstance(result, torch.Tensor):
            self.largest = max(self.largest, result.numel())
        return result


def operators(net):
    views = [torch.randn(1, 3, 64, 128).to(memory_format=torch.channels_last) for _ in range(2)]
    with torch.inference_mode(), Operators() as mode:
        net(*views)
    return mode


@pytest.mark.parametrize(("name", "calls"), [("msnet2d", 690), ("msnet3d", 700)])
def test_number_of_operators(name, calls, monkeypatch):
    monkeypatch.setattr(msnet, "SMALL_VIEW_PIXELS", 1)
    onednn.has_onednn_operators(torch.float32)  # at its first call it runs some itself
    net = build_model(name, max_disparity=32).eval()
    plain, fast = operators(net), operators(accelerate(net, "inference"))
    # Norms and all activations after convolutions are gone; the ReLU of a sum and of the cost
    # volume's first layer are left.
    assert plain.counts["batch_norm"] > 150 and plain.counts["hardtanh_"] > 100
    assert not {"batch_norm", "hardtanh_", "hardtanh"} & fast.counts.keys()
    assert fast.counts.get("relu", 0) + fast.counts.get("relu_", 0) <= 14
    assert sum(fast.counts.values()) < calls < 0.9 * sum(plain.counts.values())


@pytest.mark.parametrize("name", ["msnet2d", "msnet3d"])
def test_no_tensor_is_larger_than_a_views_features(name, monkeypatch):
    slices_of(monkeypatch, 1)
    monkeypatch.setattr(msnet, "SMALL_VIEW_PIXELS", 1)
    net = build_model(name, max_disparity=32).eval()
    features = 320 * 16 * 32
    assert operators(accelerate(net, "inference")).largest == features < operators(net).largest
