import pytest
import torch

from mobilestereonet import InputError, create_model, save_weights
from mobilestereonet.weights import average_weights, load_model


@pytest.fixture
def files(tmp_path):
    """Two networks of one kind, and another one."""
    paths = []
    for seed, disparities in enumerate((32, 32, 64)):
        torch.manual_seed(seed)
        paths.append(tmp_path / f"{seed}.safetensors")
        save_weights(create_model("msnet2d", max_disparity=disparities), paths[-1])
    return paths


def test_every_weight_is_the_mean(files):
    first, second = (load_model(path).state_dict() for path in files[:2])
    found = average_weights([files[0], files[1], files[1], files[1]])
    assert not found.training
    for name, value in found.state_dict().items():
        expected = (first[name] + 3 * second[name]) / 4
        torch.testing.assert_close(value, expected.to(value.dtype))
    assert any(not torch.equal(first[name], second[name]) for name in first)


def test_command(msnet, files, tmp_path):
    output = tmp_path / "mean.safetensors"
    code, out, _ = msnet("average", *files[:2], "-o", output, "--half")
    assert (code, out) == (0, f"{output}: mean of 2 networks\n")
    expected = average_weights(files[:2]).state_dict()
    for name, value in load_model(output).state_dict().items():
        torch.testing.assert_close(value, expected[name], rtol=0, atol=1e-3)  # half precision


def test_bad_input(msnet, files, tmp_path):
    with pytest.raises(InputError, match=r"two or more weights files or names .*, got 1"):
        average_weights(files[:1])
    with pytest.raises(InputError, match=r"2.saf.* than .*0.saf.*: max_disparity 64, not 32$"):
        average_weights(files)
    code, _, err = msnet("average", files[0], tmp_path / "none.safetensors", "-o", files[1])
    assert code == 2
    assert "none.safetensors: no such file" in err
