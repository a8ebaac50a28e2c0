"""Parity with the authors' networks, and reading of their checkpoints."""

import os
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch

from mobilestereonet import InputError, create_model, load_model
from mobilestereonet.weights.authors import authors_key

REPOSITORY = Path(__file__).parents[2]
SHARED = Path(os.environ.get("MSNET_SHARED", REPOSITORY.parent / "shared")) / "parity"
# The outputs of the authors' code, in float64, for the weights of `fill` and the pair of `pair`.
OUTPUTS = np.load(REPOSITORY / "tests/data/parity_seed7_h64_w256.npz")
MODELS = {"msnet2d": "msnet2d", "msnet3d": "msnet3d-authors"}
# These random weights amplify rounding: float32 is off by hundredths of a pixel on any machine.
TOLERANCE = {
    ("msnet2d", torch.float64): 1e-6,
    ("msnet3d", torch.float64): 1e-6,
    ("msnet2d", torch.float32): 0.05,
    ("msnet3d", torch.float32): 0.1,
}


def fill(shapes):
    """State dict with one tensor per key, each drawn from a stream seeded by the key's name."""
    state = {}
    for key, shape in shapes.items():
        rng = np.random.RandomState(zlib.crc32(key.encode()))
        if key.endswith("num_batches_tracked"):
            state[key] = torch.zeros(shape, dtype=torch.int64)
            continue
        if key.endswith("running_var"):
            value = rng.uniform(0.5, 1.5, shape)
        elif key.endswith("running_mean"):
            value = 0.1 * rng.standard_normal(shape)
        elif len(shape) == 1 and key.endswith("weight"):
            value = rng.uniform(0.7, 1.3, shape)
        elif len(shape) == 1:
            value = 0.1 * rng.standard_normal(shape)
        else:
            value = np.sqrt(2.0 / np.prod(shape[1:])) * rng.standard_normal(shape)
            if key.startswith("classif") and key.endswith("2.weight"):
                value *= 0.02 if len(shape) == 4 else 0.5  # keeps the softmax from one-hot
        state[key] = torch.as_tensor(value, dtype=torch.float32)
    return state


def pair(seed, height, width):
    views = np.random.RandomState(seed).standard_normal((2, 1, 3, height, width))
    return torch.from_numpy(views.astype(np.float32))


def authors_state(name):
    net = create_model(MODELS[name])
    return fill({authors_key(k, net.config): v.shape for k, v in net.state_dict().items()})


@pytest.fixture(scope="module", params=list(MODELS))
def authors(request, tmp_path_factory):
    """Name of a model and its checkpoint in the authors' format."""
    path = tmp_path_factory.mktemp("authors") / "checkpoint.ckpt"
    state = authors_state(request.param)
    torch.save({"model": {f"module.{key}": value for key, value in state.items()}}, path)
    return request.param, path


def largest_error(net, dtype, output, seed):
    left, right = pair(seed, *output.shape).to(dtype)
    with torch.inference_mode():
        disparity = net.to(dtype)(left, right).disparity[0].double().numpy()
    return np.abs(disparity - output).max()


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_equals_the_authors_networks(authors, dtype):
    name, path = authors
    net = load_model(path)
    assert largest_error(net, dtype, OUTPUTS[name], seed=7) < TOLERANCE[name, dtype]


@pytest.mark.skipif(not SHARED.is_dir(), reason="the larger outputs are not in the repository")
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_equals_the_authors_networks_at_every_stored_size(authors, dtype):
    name, path = authors
    net = load_model(path)
    outputs = np.load(SHARED / f"{name}.npz")
    for key in set(outputs) - {"seed7_h64_w256"}:
        seed = int(key.split("_")[0].removeprefix("seed"))
        assert largest_error(net, dtype, outputs[key], seed) < TOLERANCE[name, dtype], key


def test_checkpoint_without_wrapper_and_prefix(authors, tmp_path):
    name, path = authors
    torch.save(authors_state(name), tmp_path / "bare.pth")
    bare, wrapped = load_model(tmp_path / "bare.pth"), load_model(path)
    assert bare.config == wrapped.config
    assert not bare.training
    expected = wrapped.state_dict()
    for key, value in bare.state_dict().items():
        assert value.equal(expected[key]), key


def test_foreign_checkpoints_are_named(authors, tmp_path):
    name, path = authors
    state = authors_state(name)

    def message(content):
        file = tmp_path / "foreign.pth"
        torch.save(content, file) if not isinstance(content, bytes) else file.write_bytes(content)
        with pytest.raises(InputError, match=r"foreign\.pth") as caught:
            load_model(file)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    assert "not a readable" in message(path.read_bytes()[:100_000])
    assert "no state dict" in message({"model": 3})
    lacking = {key: value for key, value in state.items() if key != "classif3.2.weight"}
    assert "1 keys missing" in message(lacking)
    assert "1 unknown" in message(state | {"extra.weight": torch.zeros(1)})
    assert "has shape (2, 2), not (" in message(state | {"classif3.2.weight": torch.zeros(2, 2)})
    with pytest.raises(FileNotFoundError, match="absent"):
        load_model(tmp_path / "absent.pth")


def test_other_authors_names_that_begin_alike_are_not_taken_for_theirs(tmp_path):
    state = {f"feature_extraction.layer{i}.weight": torch.zeros(3) for i in range(9)}
    torch.save({"state_dict": state}, tmp_path / "psmnet.tar")
    with pytest.raises(InputError, match=r"psmnet.tar: .*are those of no registered network"):
        load_model(tmp_path / "psmnet.tar")
