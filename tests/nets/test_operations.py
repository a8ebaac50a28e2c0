"""Operations of the Caffe releases against what those gave."""

from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from mobilestereonet.nets.operations import correlation_1d
from mobilestereonet.nets.resampling import downsample, flow_warp, remap

OUTPUTS = {
    name: torch.from_numpy(values)
    for name, values in np.load(Path(__file__).parents[1] / "data/caffe_operations.npz").items()
}


def close(found, name, atol=1e-12):
    torch.testing.assert_close(found, OUTPUTS[name], rtol=0, atol=atol)


def test_correlation_1d():
    close(correlation_1d(OUTPUTS["corr_left"], OUTPUTS["corr_right"], 3), "corr_d3")


@pytest.mark.parametrize(("warp", "name"), [(flow_warp, "flow_warp"), (remap, "remap")])
def test_warps(warp, name):
    close(warp(OUTPUTS["warp_image"], OUTPUTS["warp_flow"]), name)


@pytest.mark.parametrize("size", [(2, 3), (4, 6), (8, 12), (16, 24)])
def test_downsample(size):
    close(downsample(OUTPUTS["down_in"], *size), "down_{}x{}".format(*size))


def test_enlarging_by_equal_factors_is_pytorchs_bilinear():
    """So that the networks need no filter of their own for their last step."""
    enlarged = F.interpolate(OUTPUTS["resample_in"], scale_factor=2, mode="bilinear")
    close(enlarged, "resample_26x40")
    close(enlarged, "resample_26x40_antialias")


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_warps_count_columns_in_float32(dtype):
    image = torch.rand(1, 2, 4, 1280).to(dtype)
    flow = torch.zeros(1, 2, 4, 1280, dtype=dtype)
    for warp in (remap, flow_warp):
        torch.testing.assert_close(warp(image, flow), image, rtol=0, atol=4e-3)
    ramp = torch.arange(1025.0).expand(1, 1, 3, -1) / 1024
    shrunk = downsample(ramp.to(dtype), 2, 513)
    expected = torch.arange(513.0).expand(1, 1, 2, -1) / 512
    torch.testing.assert_close(shrunk.float(), expected, rtol=0, atol=0.01)
