"""Fast DS-CS: parity with the fixture, its reader, counts."""

import re

import numpy as np
import pytest
import torch
from released_weights import OUTPUTS

from mobilestereonet import InputError, load_model
from mobilestereonet.costs import count_costs
from mobilestereonet.nets import build_model
from mobilestereonet.nets.fast_ds_cs import MEANS, SCALES, cost_signatures, enlarge
from mobilestereonet.weights.numpy_files import released_array, tensor
from parity import fill, pair

NAME = "fast-ds-cs"


def released_arrays():
    """The release's arrays, float32, from random streams."""
    own = build_model(NAME).state_dict()
    shapes = {}
    for key, value in own.items():
        if (name := released_array(key)) and "num_batches" not in key:
            kernel = value.ndim == 4
            shapes[name] = tuple(value.permute(2, 3, 1, 0).shape) if kernel else tuple(value.shape)
    state = fill(shapes)
    for key in state:
        if key.endswith("_w"):  # the fan-in of kernels stored as (height, width, in, out)
            shape = shapes[key]
            state[key] *= float(np.sqrt(np.prod(shape[1:]) / np.prod(shape[:-1])))
    state["out_w"] *= 3
    return state


@pytest.fixture(scope="module")
def arrays():
    return released_arrays()


@pytest.fixture(scope="module")
def net(arrays):
    arrays = {key: value.double() for key, value in arrays.items()}
    net = build_model(NAME).double().eval()
    own = {key: value for key, value in net.state_dict().items() if "num_batches" not in key}
    net.load_state_dict({key: tensor(key, arrays) for key in own}, strict=False)
    return net


def smooth_pair(seed, height, width):
    """Noise, and a wave seen 6 px apart."""
    y = torch.arange(height, dtype=torch.float64).view(height, 1)
    x = torch.arange(width, dtype=torch.float64).view(1, width)
    views = []
    for noise, shift in zip(pair(seed, height, width).double(), (0, 6), strict=True):
        wave = 0.25 * torch.sin((x + shift) / 7) * torch.cos(y / 5)
        views.append(((0.5 + 0.2 * noise).clamp(0, 1) * 0.5 + 0.25 + wave).clamp(0, 1))
    return views


@pytest.mark.parametrize(
    ("seed", "size", "key"), [(7, (64, 320), NAME), (8, (75, 333), f"{NAME}-odd")]
)
def test_equals_the_release(net, seed, size, key):
    with torch.inference_mode():
        disparity = net(*smooth_pair(seed, *size)).disparity[0]
    assert disparity.shape == size
    assert np.abs(disparity[::3, ::3].numpy() - OUTPUTS[key]).max() < 1e-6


def test_cost_signatures():
    halves = [torch.nn.functional.avg_pool2d(view, 2) for view in smooth_pair(7, 64, 320)]
    costs = cost_signatures(*halves, 128)[0, :, 10, ::3].unflatten(0, (128, 3))
    mean, scale = (torch.tensor(values).double()[:, None] for values in (MEANS, SCALES))
    found = (costs / scale + mean).flatten(0, 1).numpy()
    assert np.abs(found - OUTPUTS[f"{NAME}-signature"]).max() < 1e-6


def test_enlarged_edges_stay_sharp():
    disparity = torch.tensor([[[3.0, 4.0, 9.0]]])
    expected = torch.tensor([3, 3.5, 4, 4, 9, 9]).expand(1, 2, 6)
    torch.testing.assert_close(enlarge(disparity), expected)


def test_reads_the_released_file(arrays, tmp_path, net):
    np.savez(tmp_path / "bn600k.npz", **{key: value.numpy() for key, value in arrays.items()})
    loaded = load_model(tmp_path / "bn600k.npz")
    assert type(loaded) is type(net) and loaded.max_disparity == 256
    views = smooth_pair(9, 34, 47)
    with torch.inference_mode():
        found = loaded(*(view.float() for view in views)).disparity
        torch.testing.assert_close(found, net(*views).disparity.float(), rtol=0, atol=1e-2)
    np.savez(tmp_path / "other.npz", enc0_w=np.zeros(3))
    with pytest.raises(InputError, match=re.escape("other.npz: not the released weights")):
        load_model(tmp_path / "other.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "other.npz").read_bytes()[:50])
    with pytest.raises(InputError, match=r"cut\.npz: not a readable NumPy archive"):
        load_model(tmp_path / "cut.npz")


def test_counts():
    total = count_costs(NAME)["total"]
    assert total.macs / 1e9 == pytest.approx(7.10, abs=0.005)
    assert total.params / 1e6 == pytest.approx(0.9463, abs=0.00005)
