"""Which of ONNX Runtime's providers run on the devices that a user names."""

import pytest
import torch

from extras import need_extra
from mobilestereonet import InputError
from mobilestereonet.engines.onnxruntime import find_provider, open_session

onnxruntime = need_extra("onnxruntime")

CUDA, TENSORRT = "CUDAExecutionProvider", "TensorrtExecutionProvider"


class Session:
    """A session whose providers' libraries load, or do not."""

    loads = True

    def __init__(self, model, options, providers):
        self.names = [name for name, _ in providers[:-1]]
        self.numbers = [settings["device_id"] for _, settings in providers[:-1]]
        assert providers[-1] == "CPUExecutionProvider"

    def get_providers(self):
        return [*(self.names if self.loads else []), "CPUExecutionProvider"]


@pytest.fixture
def on_a_gpu(monkeypatch):
    available = [TENSORRT, CUDA, "CPUExecutionProvider"]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: available)
    monkeypatch.setattr(onnxruntime, "InferenceSession", Session)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)


@pytest.mark.parametrize(
    ("device", "target", "names"),
    [
        ("auto", "cuda:0", [CUDA]),
        ("cuda:1", "cuda:1", [CUDA]),
        ("tensorrt", "tensorrt:0", [TENSORRT, CUDA]),
        ("tensorrt:1", "tensorrt:1", [TENSORRT, CUDA]),
        ("cpu", "cpu", []),
    ],
)
def test_providers_of_a_device(device, target, names, on_a_gpu, monkeypatch):
    found, results = find_provider(device)
    number = target.partition(":")[2]
    assert found == target
    assert results == torch.device(f"cuda:{number}" if number else "cpu")
    session = open_session(b"", target, None)
    assert session.names == names
    assert set(session.numbers) <= {int(number or 0)}
    if names:
        monkeypatch.setattr(Session, "loads", False)
        with pytest.raises(InputError, match=f"could not start on {target}: its libraries of"):
            open_session(b"", target, None)


@pytest.mark.parametrize("device", ["cuda", "tensorrt", "cuda:x", "mps"])
def test_devices_without_a_provider(device, monkeypatch):
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CPUExecutionProvider"])
    with pytest.raises(InputError, match=f"has no device '{device}' here: its providers are CPU"):
        find_provider(device)
