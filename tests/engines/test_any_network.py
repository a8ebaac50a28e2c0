"""Every engine runs any `StereoModel`: with scores or without, whatever its graph holds."""

import pytest
import torch
from small_networks import Direct, Scoring, make

from mobilestereonet.engines import choose
from mobilestereonet.engines.base import Engine
from mobilestereonet.engines.choose import CONVERTED, ENGINES, open_engine
from mobilestereonet.errors import InputError


@pytest.fixture(params=ENGINES)
def name(request):
    if request.param in CONVERTED and not CONVERTED[request.param].installed():
        pytest.skip("not installed")
    return request.param


@pytest.mark.parametrize("kind", [Scoring, Direct])
def test_what_the_network_predicts(name, kind):
    net = make(kind)
    engine = open_engine(name, net)
    assert isinstance(engine, Engine)
    assert (engine.name, engine.precision, engine.device) == (name, "fp32", torch.device("cpu"))
    assert engine.preprocessing == net.preprocessing
    assert (engine.size_multiple, engine.max_disparity) == (net.size_multiple, 32)
    assert engine.has_confidence == (kind is Scoring)
    for batch, height, width in ((2, 32, 64), (1, 48, 112)):
        left, right = torch.randn(2, batch, 3, height, width)
        with torch.no_grad():
            expected = net(left, right)
        found = engine(left, right, confidence=True)
        assert found.disparity.shape == (batch, height, width)
        torch.testing.assert_close(found.disparity, expected.disparity, rtol=0, atol=1e-3)
        if kind is Scoring:
            torch.testing.assert_close(found.confidence, expected.confidence, rtol=0, atol=1e-3)
            with torch.no_grad():
                scores = net.scores(left, right)
            torch.testing.assert_close(engine.scores(left, right), scores, rtol=0, atol=1e-3)
        else:
            assert found.confidence is None
        assert engine(left, right).confidence is None


def test_a_network_without_scores_says_so(name):
    engine = open_engine(name, make(Direct))
    with pytest.raises(InputError, match="it has no scores"):
        engine.scores(*torch.zeros(2, 1, 3, 16, 16))


def test_sizes_that_do_not_fit_are_refused(name):
    engine = open_engine(name, make(Direct))
    with pytest.raises(InputError, match="multiples of 8, got 20 x 64"):
        engine(*torch.zeros(2, 1, 3, 20, 64))


def test_the_network_stays_as_it_was(name):
    net = make(Direct).train()
    before = {key: value.clone() for key, value in net.state_dict().items()}
    pair = torch.randn(2, 1, 3, 16, 32)
    engine = open_engine(name, net)
    expected = engine(*pair).disparity
    assert net.training and all(weight.requires_grad for weight in net.parameters())
    assert all(net.state_dict()[key].equal(value) for key, value in before.items())
    with torch.no_grad():
        for weight in net.parameters():
            weight.mul_(2)
    assert engine(*pair).disparity.equal(expected)


class Unconvertible(Direct):
    def forward(self, left, right):
        if left.mean().item() > 1:
            left = right
        return super().forward(left, right)


@pytest.mark.parametrize("name", CONVERTED)
def test_a_network_that_cannot_be_converted_is_refused_in_one_line(name):
    if not CONVERTED[name].installed():
        pytest.skip("not installed")
    if name == "openvino":
        pytest.skip("its converter follows the example's branch")
    engine = open_engine(name, make(Unconvertible))
    with pytest.raises(
        InputError, match=f"{name} cannot convert this network: .*: use engine"
    ) as e:
        engine(*torch.zeros(2, 1, 3, 16, 32))
    assert "\n" not in str(e.value)


def test_code_from_outside_of_the_package_is_converted_anew(tmp_path):
    if not CONVERTED["openvino"].installed():
        pytest.skip("not installed")
    engine = open_engine("openvino", make(Direct), cache=tmp_path)
    engine(*torch.zeros(2, 1, 3, 16, 32))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "tpu"}, f"unknown engine 'tpu': there are {', '.join(ENGINES)}"),
        ({"device": "toaster"}, "unknown device 'toaster'"),
        ({"device": "meta"}, "unknown device 'meta'"),
        ({"device": "cuda:0"}, "PyTorch finds no cuda device here: use cpu"),
        ({"device": torch.device("cuda", 3)}, "device 'cuda:3': PyTorch finds no cuda device"),
        ({"device": "mps"}, "PyTorch finds no mps device here: use cpu"),
        ({"precision": "fp16"}, "precision must be one of fp32, bf16 on cpu, got 'fp16'"),
        ({"threads": 0}, "threads must be at least 1, got 0"),
        ({"name": "onnxruntime", "device": "cuda"}, "its providers are .*CPUExecutionProvider"),
        ({"name": "openvino", "device": "NPU"}, "openvino has no device 'NPU' here, only CPU"),
        ({"name": "onnxruntime", "precision": "int4"}, "computes in fp32 on cpu, not in 'int4'"),
        ({"name": "openvino", "precision": "fp16"}, "computes in fp32 or bf16 on CPU, not in"),
    ],
)
def test_a_choice_that_cannot_be_had_is_refused(options, message, monkeypatch):
    if options.get("name") in CONVERTED and not CONVERTED[options["name"]].installed():
        pytest.skip("not installed")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    with pytest.raises(InputError, match=message):
        open_engine(**{"name": "torch", "net": make(Direct), **options})


def test_the_defaults_are_torch_s_own_on_the_cpu_in_fp32(monkeypatch):
    monkeypatch.setattr("mobilestereonet.engines.choose.has_bfloat16", lambda device: True)
    assert open_engine("torch", make(Direct)).precision == "fp32"
    assert open_engine("torch", make(Scoring), precision="auto").precision == "bf16"
    # Regressed in the network's own precision, where bfloat16 has steps of 1 px from 128 px on.
    assert open_engine("torch", make(Direct), precision="auto").precision == "fp32"
    monkeypatch.setattr("mobilestereonet.engines.choose.has_bfloat16", lambda device: False)
    assert open_engine("torch", make(Scoring), precision="auto").precision == "fp32"


@pytest.mark.parametrize(
    ("cuda", "mps", "expected"), [(0, False, "cpu"), (0, True, "mps:0"), (2, True, "cuda:0")]
)
def test_auto_is_the_gpu_that_is_there(cuda, mps, expected, monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: cuda)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: mps)
    assert str(choose.torch_device("auto")) == expected
    if cuda:
        assert str(choose.torch_device(torch.device("cuda:1"))) == "cuda:1"


def test_only_installed_engines_that_have_the_device_are_listed(monkeypatch):
    monkeypatch.setattr(CONVERTED["onnxruntime"], "installed", classmethod(lambda _: False))
    assert "onnxruntime" not in {name for name, _ in choose.installed_engines("cpu")}
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr("mobilestereonet.engines.choose.has_bfloat16", lambda device: True)
    found = choose.installed_engines("cuda:0")
    assert found == [("torch", "fp32"), ("torch", "bf16"), ("torch", "fp16")]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("precision", ["fp32", "bf16", "fp16"])
def test_results_stay_on_the_engine_s_device(precision):
    net = make(Scoring).cuda()
    engine = open_engine("torch", net, device="cuda", precision=precision)
    left, right = torch.randn(2, 1, 3, 32, 64)
    found = engine(left, right, confidence=True)
    assert found.disparity.device == found.confidence.device == engine.device
    assert found.disparity.dtype == torch.float32
    with torch.no_grad():
        expected = net(left.cuda(), right.cuda())
    assert (found.disparity - expected.disparity).abs().mean() < 0.5
