"""`msnet bench` and what it is made of."""

import math

import pytest
import torch

from mobilestereonet import create_model, save_weights
from mobilestereonet.engines import compare
from mobilestereonet.engines.onnxruntime import ONNXRuntime
from mobilestereonet.engines.openvino import OpenVINORuntime

SMALL = {"max_disparity": 32, "hourglasses": 1, "width": 8}


def small():
    torch.manual_seed(0)
    net = create_model("msnet2d", **SMALL).eval()
    net.zero_residuals()
    return net


def test_engines_are_timed_against_the_plain_network():
    left, right = torch.randn(2, 1, 3, 32, 64)
    engines = [("torch", "fp32"), ("torch", "bf16")]
    plain, *others = compare.compare_engines(small(), left, right, engines, repeats=2)
    assert (plain.engine, plain.precision) == ("eager", "fp32")
    assert (plain.ratio, plain.difference) == (1, 0)
    assert [(row.engine, row.precision) for row in others] == engines
    for row in others:
        assert row.seconds > 0
        assert row.ratio == pytest.approx(plain.seconds / row.seconds)
    assert others[0].difference < 1e-4 < others[1].difference < 1


def test_the_fastest_of_each_precision():
    rows = [("eager", "fp32", 1, 0), ("torch", "fp32", 3, 0), ("openvino", "fp32", 2, 0.1)]
    rows += [("wrong", "fp32", 1, 7.0), ("broken", "fp32", 1, math.nan), ("a", "bf16", 4, 0)]
    times = [compare.EngineTime(*row[:3], ratio=1.0, difference=row[3]) for row in rows]
    assert compare.fastest(times) == {"fp32": "openvino", "bf16": "a"}


def test_only_installed_engines_are_named(monkeypatch):
    monkeypatch.setattr(ONNXRuntime, "installed", classmethod(lambda _: False))
    monkeypatch.setattr(OpenVINORuntime, "installed", classmethod(lambda _: True))
    engines = compare.installed_engines("cpu")
    assert {name for name, _ in engines} == {"torch", "openvino"}
    assert compare.installed_engines("cuda:0")[-1] == ("torch", "fp16")


def test_command(msnet, tmp_path, monkeypatch):
    weights = tmp_path / "small.safetensors"
    save_weights(small(), weights)
    monkeypatch.setattr(compare, "installed_engines", lambda device: [("torch", "fp32")])
    arguments = ("bench", "--weights", weights, "--device", "cpu", "--repeats", 1)
    monkeypatch.setattr("mobilestereonet.engines.choose.user_cache", lambda: tmp_path / "cache")
    code, out, err = msnet(*arguments, "--size", 32, 64)
    assert code == 0
    assert err == "making ready: torch fp32\n"
    lines = out.splitlines()
    assert any("eager" in line and "1.00" in line for line in lines)
    assert any("torch" in line and "fp32" in line for line in lines)
    assert lines[-2] == "--runtime auto on cpu: torch in fp32"
    kept = tmp_path / "cache" / "fastest.json"
    assert (
        lines[-1]
        == f"kept in {kept}, with those of other networks: delete it and auto is torch again"
    )
    assert kept.is_file()
    code, _, err = msnet(*arguments, "--size", 30, 64)
    assert code == 2
    assert "height must be a multiple of 16, got 30" in err


def test_auto_takes_what_the_command_found_fastest(msnet, tmp_path, monkeypatch):
    weights = tmp_path / "small.safetensors"
    save_weights(small(), weights)
    rows = [compare.EngineTime(name, "fp32", 1.0, 1.0, 0.0) for name in ("eager", "openvino")]
    monkeypatch.setattr(compare, "compare_engines", lambda *_, **__: rows)
    monkeypatch.setattr(compare, "installed_engines", lambda device: [])
    monkeypatch.setattr(OpenVINORuntime, "installed", classmethod(lambda _: True))
    monkeypatch.setattr("mobilestereonet.engines.choose.user_cache", lambda: tmp_path)
    code, out, _ = msnet("bench", "--weights", weights, "--device", "cpu", "--size", 32, 64)
    assert code == 0
    assert "--runtime auto on cpu: openvino in fp32" in out.splitlines()
    assert "openvino" in (tmp_path / "fastest.json").read_text()
