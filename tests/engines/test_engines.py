"""Engines of converted networks: PyTorch's result, at any size, from a cache the second time."""

import os
import threading

import pytest
import torch
from torch import nn

from mobilestereonet import InputError, create_model
from mobilestereonet.engines.base import ConfidentRuntime
from mobilestereonet.engines.choose import (
    RUNTIMES,
    choose_engine,
    open_runtime,
    remember_fastest,
)
from mobilestereonet.engines.converted import _checksum, _forget_old
from mobilestereonet.engines.onnxruntime import ONNXRuntime
from mobilestereonet.engines.openvino import OpenVINORuntime
from mobilestereonet.engines.torch import TorchRuntime, has_bfloat16
from mobilestereonet.nets import model_config

SMALL = {"max_disparity": 32, "hourglasses": 1, "width": 8}
ENGINES = [
    pytest.param(
        engine,
        id=engine.name,
        marks=pytest.mark.skipif(not engine.installed(), reason="not installed"),
    )
    for engine in (ONNXRuntime, OpenVINORuntime)
]


def small(name="msnet2d", **options):
    torch.manual_seed(0)
    net = create_model(name, **SMALL, **options).eval()
    net.zero_residuals()  # fresh weights would amplify rounding
    with torch.no_grad():
        for module in net.modules():
            if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
                module.bias.normal_(0, 0.1)
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.5, 1.5)
        if net.config.coarse_pass:
            net.guide.weight.normal_()
    return net


def views(height, width, batch=1):
    return torch.randn(2, batch, 3, height, width)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("msnet2d", {"estimator": "mode"}),
        ("msnet3d", {}),
        ("msnet3d", {"coarse_pass": True}),
    ],
)
def test_every_size_gives_what_the_network_gives(engine, name, options, cache):
    net = small(name, **options)
    runtime = engine(net, threads=1, cache=cache)
    assert isinstance(runtime, ConfidentRuntime)
    # The last one is narrower than the converted graph takes.
    unit = net.config.size_multiple
    for batch, height, width in ((1, 2, 4), (2, 3, 7), (1, 1, 1)):
        left, right = views(height * unit, width * unit, batch)
        with torch.no_grad():
            expected = net(left, right)
        found = runtime(left, right)
        assert found.dtype == torch.float32
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("estimator", ["mean", "mode"])
def test_confidence_is_that_of_the_torch_engine(engine, estimator, cache):
    net = small(estimator=estimator)
    left, right = views(32, 64)
    expected = TorchRuntime(net).with_confidence(left, right)
    found = engine(net, cache=cache).with_confidence(left, right)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("engine", ENGINES)
def test_conversions_are_kept_and_made_again_when_one_is_damaged_or_not_to_be_had(
    engine, tmp_path, monkeypatch
):
    net, pair = small(), views(32, 64)
    expected = engine(net, cache=tmp_path)(*pair)
    (cached,) = tmp_path.iterdir()
    model = engine(net, cache=tmp_path)._convert(net)
    conversions = []

    def convert(self, net):
        conversions.append(net)
        return model

    monkeypatch.setattr(engine, "_convert", convert)

    def check(count, folder=tmp_path):
        torch.testing.assert_close(engine(net, cache=folder)(*pair), expected)
        assert len(conversions) == count

    check(0)
    kept = cached.read_bytes()
    flipped = bytearray(kept)
    flipped[len(kept) // 2] ^= 1
    for count, damaged in enumerate((kept[: len(kept) // 2], bytes(flipped), b""), start=1):
        cached.write_bytes(damaged)
        check(count)
        assert cached.read_bytes() == _checksum(model) + model
        check(count)
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    check(4, blocked / "cache")
    # Other weights, another file.
    with torch.no_grad():
        next(net.parameters()).mul_(2)
    engine(net, cache=tmp_path)
    assert len(conversions) == 5


@pytest.mark.parametrize("engine", ENGINES)
def test_threads_may_share_an_engine(engine, cache):
    runtime = engine(small(), cache=cache)
    pairs = [views(32, 64) for _ in range(4)]
    expected = [runtime(*pair) for pair in pairs]
    found = {}

    def match(index):
        for _ in range(5):
            found[index] = runtime(*pairs[index])

    workers = [threading.Thread(target=match, args=(index,)) for index in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for index in range(4):
        torch.testing.assert_close(found[index], expected[index])


@pytest.mark.skipif(not OpenVINORuntime.installed(), reason="not installed")
def test_openvino_computes_in_the_precision_that_is_asked_for(cache):
    net = small()
    left, right = views(32, 64)
    full, half = (
        OpenVINORuntime(net, precision=precision, cache=cache)(left, right)
        for precision in ("fp32", "bf16")
    )
    with torch.no_grad():
        assert (full - net(left, right)).abs().max() < 1e-3
    assert (full - half).abs().mean() < 1
    if has_bfloat16():
        assert (full - half).abs().max() > 1e-4


@pytest.mark.parametrize("engine", ENGINES)
def test_bad_options_are_named(engine, cache):
    with pytest.raises(InputError, match=f"{engine.name} computes in .*, not in 'int4'"):
        engine(small(), precision="int4", cache=cache)
    with pytest.raises(InputError, match="threads must be at least 1, got 0"):
        engine(small(), threads=0, cache=cache)
    left, right = views(20, 64)
    with pytest.raises(InputError, match="multiples of 16, got 20 x 64"):
        engine(small(), cache=cache)(left, right)


def test_a_missing_engine_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(ONNXRuntime, "installed", classmethod(lambda _: False))
    with pytest.raises(InputError, match=r'onnxruntime is not installed: pip install ".*\[onnx\]"'):
        open_runtime("onnxruntime", small())


@pytest.fixture
def empty_cache(monkeypatch, tmp_path):
    monkeypatch.setattr("mobilestereonet.engines.choose.user_cache", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize("installed", [False, True])
def test_auto_is_what_was_fastest_with_this_network(installed, empty_cache, monkeypatch):
    config, other = model_config("msnet2d"), model_config("msnet3d")
    assert choose_engine("auto", config, "fp32", "cpu") == ("torch", "fp32", "cpu")
    remember_fastest(other, {"fp32": "torch"})
    remember_fastest(config, {"fp32": "onnxruntime", "bf16": "openvino"})
    monkeypatch.setattr("mobilestereonet.engines.choose.has_bfloat16", lambda: True)
    for engine in (ONNXRuntime, OpenVINORuntime):
        monkeypatch.setattr(engine, "installed", classmethod(lambda _: installed))
    fp32, bf16 = ("onnxruntime", "openvino") if installed else ("torch", "torch")
    assert choose_engine("auto", config, "fp32", "cpu") == (fp32, "fp32", "cpu")
    assert choose_engine("auto", config, "auto", "cpu") == (bf16, "bf16", "cpu")
    for precision in ("fp32", "bf16"):
        assert choose_engine("auto", other, precision, "cpu")[0] == "torch"
    monkeypatch.setattr("torch.cuda.device_count", lambda: 1)
    monkeypatch.setattr("mobilestereonet.engines.choose._has_bfloat16", lambda device: True)
    assert choose_engine("auto", config, "fp32", "cuda")[0] == "torch"


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"%s": 1}', '{"%s": {"fp32": "tpu"}}'])
def test_auto_is_torch_where_nothing_useful_is_remembered(content, empty_cache):
    config = model_config("msnet2d")
    (empty_cache / "fastest.json").write_text(content.replace("%s", str(config)))
    assert choose_engine("auto", config, "fp32", "cpu") == ("torch", "fp32", "cpu")


@pytest.mark.parametrize("has", [False, True])
def test_auto_precision_is_bf16_where_the_processor_has_it(has, monkeypatch):
    monkeypatch.setattr("mobilestereonet.engines.choose.has_bfloat16", lambda: has)
    assert open_runtime("torch", small(), device="cpu").precision == ("bf16" if has else "fp32")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "tpu"}, f"unknown runtime 'tpu': there are {', '.join(RUNTIMES)}"),
        ({"name": "torch", "device": "toaster"}, "unknown device 'toaster'"),
        ({"name": "torch", "precision": "fp16", "device": "cpu"}, "precision must be one of"),
        ({"name": "torch", "device": "cuda:0"}, "PyTorch finds no GPU here: use cpu"),
        ({"name": "torch", "device": "meta"}, "unknown device 'meta'"),
    ],
)
def test_a_choice_that_cannot_be_had_is_refused(options, message, monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    with pytest.raises(InputError, match=message):
        open_runtime(net=small(), **options)


def test_engines_keep_the_network_as_it_was(cache):
    net = small()
    engine = ONNXRuntime(net, cache=cache) if ONNXRuntime.installed() else TorchRuntime(net)
    pair = views(16, 32)  # through PyTorch
    before = engine(*pair)
    with torch.no_grad():
        for weight in net.parameters():
            weight.mul_(2)
    assert engine(*pair).equal(before)


def test_only_some_conversions_are_kept(tmp_path):
    for index in range(10):
        file = tmp_path / f"openvino-{index}"
        file.write_bytes(b"")
        os.utime(file, (index, index))
    _forget_old(tmp_path, "openvino")
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        f"openvino-{i}" for i in range(2, 10)
    ]
