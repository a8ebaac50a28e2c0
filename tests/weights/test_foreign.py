"""Public checkpoints of the networks that regress disparity maps, written in their documented form.

None of the real files is at hand: these have the same names and layout, and fewer channels.
"""

from functools import partial

import numpy as np
import pytest
import torch

from mobilestereonet import InputError, load_model
from mobilestereonet.nets import build_model
from mobilestereonet.weights import caffe, reversing
from mobilestereonet.weights.caffe import caffe_key
from mobilestereonet.weights.reversing import reversing_key
from mobilestereonet.weights.shapes import registered_shapes


@pytest.fixture(autouse=True)
def narrow(monkeypatch):
    for module in (caffe, reversing):
        monkeypatch.setattr(module, "registered_shapes", partial(registered_shapes, width=8))


def varint(number):
    digits = []
    while number > 127:
        digits.append(number & 127 | 128)
        number >>= 7
    return bytes([*digits, number])


def message(field, content):
    return varint(field << 3 | 2) + varint(len(content)) + content


def caffe_layer(name, *blobs):
    """A layer of a Caffe model as protobuf has it: name, type, blobs with values and shape."""
    content = message(1, name.encode()) + message(2, b"Convolution")
    for blob in blobs:
        dims = b"".join(map(varint, blob.shape))
        values = np.asarray(blob, "<f4").tobytes()
        content += message(7, message(5, values) + message(7, message(1, dims)))
    return message(100, content)


MEANS = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], dtype=np.float32)
AUGMENTATION = [
    caffe_layer(f"img{i}s_aug", np.zeros(1), np.zeros((3, 2, 2)), MEANS[i].reshape(1, 1, 1, 3))
    for i in (0, 1)
]


def caffe_file(path, net, name, augmentation=AUGMENTATION):
    layers = {}
    for key, value in net.state_dict().items():
        if key != "means":
            layers.setdefault(caffe_key(key, name).rpartition(".")[0], []).append(value.numpy())
    content = [caffe_layer("input"), *augmentation]
    path.write_bytes(b"".join(content + [caffe_layer(*layer) for layer in flat(layers)]))
    return layers


def flat(layers):
    return [(name, *blobs) for name, blobs in layers.items()]


@pytest.mark.parametrize("name", ["dispnet-corr1d", "crl", "iresnet"])
def test_caffe_models(name, tmp_path):
    net = build_model(name, width=8)
    layers = caffe_file(tmp_path / "net.caffemodel", net, name)
    assert all(len(blobs) == 2 for blobs in layers.values())
    loaded = load_model(tmp_path / "net.caffemodel", width=8)
    assert type(loaded) is type(net)
    assert np.array_equal(loaded.means, MEANS)
    for key, value in net.state_dict().items():
        assert key == "means" or loaded.state_dict()[key].equal(value), key


def test_damaged_and_other_caffe_models(tmp_path):
    path = tmp_path / "net.caffemodel"
    net = build_model("dispnet-corr1d", width=8)

    def error():
        with pytest.raises(InputError, match=r"net\.caffemodel") as caught:
            load_model(path, width=8)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    caffe_file(path, net, "dispnet-corr1d", augmentation=[])
    assert "lacks the views' mean colours" in error()
    path.write_bytes(path.read_bytes()[:-9])
    assert "not a whole Caffe model" in error()
    path.write_bytes(caffe_layer("conv1", np.zeros((8, 3, 3, 3))))
    assert "64 of 64 tensors of dispnet-corr1d are missing or have another size" in error()
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_model(tmp_path / "absent.caffemodel")


@pytest.fixture
def reversing_state():
    """A network and its state dict as the authors have it, concatenations in their order."""
    net = build_model("iresnet-reversing", width=8)
    state = {reversing_key(key): value.clone() for key, value in net.state_dict().items()}
    return net, state


@pytest.mark.parametrize("prefix", ["", "module."])
def test_iresnet_of_reversing_the_cycle(reversing_state, prefix, tmp_path):
    """The parity tests show that the orders are right; here, that a file gets there."""
    net, state = reversing_state
    wrapped = {prefix + key: value for key, value in state.items()}
    torch.save({"state_dict": wrapped, "epoch": 3}, tmp_path / "ckpt.pth")
    loaded = load_model(tmp_path / "ckpt.pth", width=8).state_dict()
    key = "refinement.conv1b.0.weight"
    assert loaded[key][:, 41:].equal(net.state_dict()[key][:, :8])
    moved = [key for key, value in net.state_dict().items() if not loaded[key].equal(value)]
    assert len(moved) == 10
    state.pop("stem_block.conv1.0.0.bias")
    torch.save({"state_dict": state}, tmp_path / "less.pth")
    with pytest.raises(InputError, match=r"less\.pth: not the iResNet of .*: 1 tensors missing"):
        load_model(tmp_path / "less.pth")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("model.ckpt-600000.index", "a TensorFlow snapshot"),
        ("model.ckpt-600000.data-00000-of-00001", "a TensorFlow snapshot"),
        ("net_kitti_fast_-a_train_all.t7", "a Torch7 file"),
    ],
)
def test_what_cannot_be_read_is_told(name, words, tmp_path):
    (tmp_path / name).write_bytes(b"anything")
    with pytest.raises(InputError, match=f"{words} cannot be read without that framework"):
        load_model(tmp_path / name)
