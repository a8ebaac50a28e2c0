"""Parity with the authors' networks, and reading of their checkpoints."""

import numpy as np
import pytest
import torch

from extras import SHARED, needs_shared
from mobilestereonet import InputError, load_model
from parity import MODELS, OUTPUTS, TOLERANCE, authors_state, largest_error


@pytest.fixture(scope="module", params=list(MODELS))
def authors(request, tmp_path_factory):
    """Name of a model and its checkpoint in the authors' format."""
    path = tmp_path_factory.mktemp("authors") / "checkpoint.ckpt"
    state = authors_state(request.param)
    torch.save({"model": {f"module.{key}": value for key, value in state.items()}}, path)
    return request.param, path


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_equals_the_authors_networks(authors, dtype):
    name, path = authors
    net = load_model(path)
    assert largest_error(net, dtype, OUTPUTS[name], seed=7) < TOLERANCE[name, dtype]


@needs_shared
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_equals_the_authors_networks_at_every_stored_size(authors, dtype):
    name, path = authors
    net = load_model(path)
    outputs = np.load(SHARED / "parity" / f"{name}.npz")
    for key in set(outputs) - {"seed7_h64_w256"}:
        seed = int(key.split("_")[0].removeprefix("seed"))
        assert largest_error(net, dtype, outputs[key], seed) < TOLERANCE[name, dtype], key


@pytest.mark.parametrize("prefix", ["module._orig_mod.", "module.module.", "_orig_mod."])
def test_checkpoints_with_other_prefixes_and_a_number_of_numpy(authors, tmp_path, prefix):
    name, path = authors
    state = {prefix + key: value for key, value in authors_state(name).items()}
    torch.save({"model": state, "loss": np.float64(0.5)}, tmp_path / "other.ckpt")
    other, expected = load_model(tmp_path / "other.ckpt"), load_model(path)
    assert other.config == expected.config
    for key, value in expected.state_dict().items():
        assert value.equal(other.state_dict()[key]), key


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
