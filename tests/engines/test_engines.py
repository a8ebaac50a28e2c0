"""Engines with the paper's networks: PyTorch's result, at any size, from a cache when converted."""

import hashlib
import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from small_networks import make_msnet
from torch.fx.node import map_arg

from mobilestereonet import InputError
from mobilestereonet.accelerate import accelerate
from mobilestereonet.engines import converted
from mobilestereonet.engines.choose import CONVERTED, ENGINES, open_engine
from mobilestereonet.engines.converted import _checksum, _forget_old
from mobilestereonet.engines.onnxruntime import OnnxRuntimeEngine
from mobilestereonet.engines.openvino import OpenVinoEngine
from mobilestereonet.engines.torch import has_bfloat16
from mobilestereonet.engines.tracing import example_pair

CPU = torch.device("cpu")
CONVERTED_ENGINES = [
    pytest.param(
        engine,
        id=engine.name,
        marks=pytest.mark.skipif(not engine.installed(), reason="not installed"),
    )
    for engine in CONVERTED.values()
]
ONE_ENGINE = [
    CONVERTED_ENGINES[0],
    *(
        pytest.param(*one.values, id=one.id, marks=[*one.marks, pytest.mark.exhaustive])
        for one in CONVERTED_ENGINES[1:]
    ),
]
"""For what the engines have from one class: one of them in each run of the tests."""


def views(height, width, batch=1):
    return torch.randn(2, batch, 3, height, width)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


NETWORKS = {
    "msnet2d": ("msnet2d", {"estimator": "mode"}, ENGINES),
    "msnet3d": ("msnet3d", {}, ("torch", "openvino")),
    "coarse_pass": (
        "msnet3d",
        {"coarse_pass": True, "coarse_levels": 2, "max_disparity": 64},
        ("torch", "openvino"),
    ),
    "cascade": ("msnet3d-cascade", {"max_disparity": 64, "band": 8}, ("torch", "onnxruntime")),
}
"""Networks, their options, and the engines that run them in each run of the tests."""


@pytest.mark.parametrize(
    ("name", "network", "options"),
    [
        pytest.param(
            *(name, network, options),
            id=f"{case}-{name}",
            marks=[] if name in engines else pytest.mark.exhaustive,
        )
        for case, (network, options, engines) in NETWORKS.items()
        for name in ENGINES
    ],
)
def test_every_size_gives_what_the_network_gives(name, network, options, cache):
    if name in CONVERTED and not CONVERTED[name].installed():
        pytest.skip("not installed")
    net = make_msnet(network, **options)
    engine = open_engine(name, net, threads=1, cache=cache)
    # The last one is narrower than the converted graph takes.
    unit = net.size_multiple
    for batch, height, width in ((1, 2, 4), (2, 3, 7), (1, 1, 1)):
        left, right = views(height * unit, width * unit, batch)
        with torch.no_grad():
            expected = net(left, right)
        found = engine(left, right, confidence=True)
        assert found.disparity.dtype == found.confidence.dtype == torch.float32
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-3)


def test_any_type_of_views_and_any_number_of_threads_leave_no_trace():
    threads = torch.get_num_threads()
    engine = open_engine("torch", make_msnet(), threads=threads + 1)
    disparity = engine(*torch.randn(2, 1, 3, 16, 32, dtype=torch.float64)).disparity
    assert disparity.dtype == torch.float32
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize("engine", ONE_ENGINE)
def test_conversions_are_kept_and_made_again_when_one_is_corrupted_or_not_to_be_had(
    engine, tmp_path, monkeypatch
):
    net, pair = make_msnet(), views(32, 64)
    expected = engine(net, cache=tmp_path)(*pair).disparity
    (cached,) = tmp_path.iterdir()
    model = cached.read_bytes()[converted._CHECKSUM_SIZE :]
    conversions = []

    def convert(self, network, size):
        conversions.append(network)
        return model

    monkeypatch.setattr(engine, "_convert", convert)

    def check(count, folder=tmp_path):
        torch.testing.assert_close(engine(net, cache=folder)(*pair).disparity, expected)
        assert len(conversions) == count

    check(0)
    kept = cached.read_bytes()
    flipped = bytearray(kept)
    flipped[len(kept) // 2] ^= 1
    for count, corrupted in enumerate((kept[: len(kept) // 2], bytes(flipped), b""), start=1):
        cached.write_bytes(corrupted)
        check(count)
        assert cached.read_bytes() == _checksum(model) + model
        check(count)
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    check(4, blocked / "cache")


@pytest.mark.parametrize("engine", CONVERTED_ENGINES)
def test_the_cache_s_key_names_all_that_a_conversion_depends_on(engine, tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "_convert", lambda self, network, size: b"")
    monkeypatch.setattr(engine, "_load", lambda self, model: None)

    def key(net=None, precision="fp32", size=None):
        net = make_msnet() if net is None else net
        return engine(net, precision=precision, cache=tmp_path)._key(size)

    plain = key()
    assert key() == plain
    heavier = make_msnet()
    with torch.no_grad():
        next(heavier.parameters()).mul_(2)
    other_config = make_msnet()
    other_config.config = replace(other_config.config, estimator="mode")
    keys = [plain, key(heavier), key(other_config), key(size=(32, 64))]
    keys += [key(precision=name) for name in engine.precisions("CPU")[1:]]
    with monkeypatch.context() as patch:
        patch.setattr(converted, "CONVERSION_VERSION", converted.CONVERSION_VERSION + 1)
        keys.append(key())
    with monkeypatch.context() as patch:
        patch.setattr(engine, "_machine", lambda self: "another")
        keys.append(key())
    for package in ("torch", *engine.packages):
        with monkeypatch.context() as patch:
            patch.setattr(sys.modules[package], "__version__", "99")
            keys.append(key())
    assert len(set(keys)) == len(keys)


RECORDED_GRAPHS = {"2.13": (5, "bab6b528206056af")}
"""By PyTorch's version: `CONVERSION_VERSION`, and a digest of the graphs that it stands for."""


def test_a_changed_conversion_has_another_version():
    """If this fails: raise `CONVERSION_VERSION`, then record it with the digest found here."""
    torch_version = ".".join(torch.__version__.split(".")[:2])
    if torch_version not in RECORDED_GRAPHS:
        pytest.skip(f"no graphs recorded with PyTorch {torch_version}")
    digest = hashlib.sha256()
    for name, options in (
        ("msnet2d", {}),
        ("msnet3d", {"coarse_pass": True}),
        ("msnet3d-cascade", {"max_disparity": 64, "band": 8}),
    ):
        network = accelerate(make_msnet(name, **options), "export", scores=True)
        program = torch.export.export(network, example_pair(network))
        for node in program.graph.nodes:  # operators, their constants and shapes, but no names
            target = node.target if node.op == "call_function" else node.op
            constants = map_arg((node.args, node.kwargs), lambda _: None)
            shape = getattr(node.meta.get("val"), "shape", None)
            digest.update(f"{target} {constants} {shape}\n".encode())
    found = (converted.CONVERSION_VERSION, digest.hexdigest()[:16])
    assert found == RECORDED_GRAPHS[torch_version]


def test_the_key_does_not_depend_on_source_files(tmp_path, monkeypatch):
    if not OpenVinoEngine.installed():
        pytest.skip("not installed")
    read = []
    monkeypatch.setattr(converted.Path, "read_bytes", lambda path: read.append(path) or b"")
    monkeypatch.setattr(OpenVinoEngine, "_convert", lambda self, network, size: b"")
    monkeypatch.setattr(OpenVinoEngine, "_load", lambda self, model: None)
    OpenVinoEngine(make_msnet(), cache=tmp_path)
    assert all(path.parent == tmp_path for path in read)


@pytest.mark.parametrize("engine", CONVERTED_ENGINES)
def test_threads_may_share_an_engine(engine, cache):
    shared = engine(make_msnet(), cache=cache, threads=1)
    pairs = [views(32, 64) for _ in range(4)]
    expected = [shared(*pair).disparity for pair in pairs]
    found = {}

    def match(index):
        for _ in range(5):
            found[index] = shared(*pairs[index]).disparity

    workers = [threading.Thread(target=match, args=(index,)) for index in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for index in range(4):
        torch.testing.assert_close(found[index], expected[index])


@pytest.mark.skipif(not OpenVinoEngine.installed(), reason="not installed")
def test_openvino_computes_in_the_precision_that_is_asked_for(cache):
    net = make_msnet()
    left, right = views(32, 64)
    full, half = (
        OpenVinoEngine(net, precision=precision, cache=cache)(left, right).disparity
        for precision in ("fp32", "bf16")
    )
    with torch.no_grad():
        assert (full - net(left, right).disparity).abs().max() < 1e-3
    assert (full - half).abs().mean() < 1
    if has_bfloat16(CPU):
        assert (full - half).abs().max() > 1e-4


@pytest.mark.skipif(not OpenVinoEngine.installed(), reason="not installed")
def test_openvino_tells_its_makers_nothing(cache, tmp_path, monkeypatch):
    telemetry = pytest.importorskip("openvino_telemetry")

    def send(*_, **__):
        raise AssertionError("telemetry")

    monkeypatch.setattr(telemetry, "Telemetry", send)
    OpenVinoEngine(make_msnet(), cache=tmp_path)
    assert list(tmp_path.iterdir())
    assert telemetry.Telemetry is send


@pytest.mark.skipif(not OnnxRuntimeEngine.installed(), reason="not installed")
def test_a_conversion_leaves_the_logging_as_it_was(tmp_path):
    import logging

    logger = logging.getLogger("torch.onnx")
    logger.setLevel(logging.INFO)
    OnnxRuntimeEngine(make_msnet(), cache=tmp_path)
    assert logger.level == logging.INFO


def test_a_missing_engine_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(OnnxRuntimeEngine, "installed", classmethod(lambda _: False))
    for precision in ("fp32", "auto"):
        with pytest.raises(
            InputError, match=r'onnxruntime is not installed: pip install ".*\[onnx\]"'
        ):
            open_engine("onnxruntime", make_msnet(), precision=precision)


def test_only_some_conversions_are_kept(tmp_path):
    for index in range(10):
        file = tmp_path / f"openvino-{index}"
        file.write_bytes(b"")
        os.utime(file, (index, index))
    _forget_old(tmp_path, "openvino")
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        f"openvino-{i}" for i in range(2, 10)
    ]


MEMORY = """
import sys, torch
sys.path.insert(0, {tests!r})
from small_networks import Direct, make
from mobilestereonet.engines.choose import open_engine
def resident():
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024
engine = open_engine({name!r}, make(Direct))
engine(*torch.zeros(2, 1, 3, 16, 32))
block = torch.ones(2**26)  # 256 MiB
before = resident()
del block
print(before - resident())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("name", ENGINES)
def test_the_host_process_gives_memory_back(name):
    if name in CONVERTED and not CONVERTED[name].installed():
        pytest.skip("not installed")
    program = MEMORY.format(tests=str(Path(__file__).parent), name=name)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, check=True, text=True
    )
    assert float(done.stdout.splitlines()[-1]) > 200


_SIGNAL_AFTER_ENGINES = """
import faulthandler, os, signal, sys
from mobilestereonet import create_model
from mobilestereonet.engines.choose import open_engine

faulthandler.enable()  # on a signal stack of its own, as pytest and servers have it
seen = []
signal.signal(signal.SIGUSR1, lambda *_: seen.append("handled"))
net = create_model("msnet2d", pretrained=False, max_disparity=64)
first = open_engine("openvino", net, device="cpu", cache=sys.argv[1])
second = open_engine("openvino", net, device="cpu", cache=sys.argv[1])
del first
del second
os.kill(os.getpid(), signal.SIGUSR1)
print(*seen)
"""


@pytest.mark.skipif(not OpenVinoEngine.installed(), reason="not installed")
def test_signals_reach_python_after_openvino_engines(tmp_path):
    command = [sys.executable, "-c", _SIGNAL_AFTER_ENGINES, str(tmp_path)]
    assert subprocess.run(command, stdout=subprocess.PIPE, text=True).stdout == "handled\n"
