"""Fixtures of the inference tests."""

import pytest
import torch


@pytest.fixture(params=["cpu", "cuda"])
def device(request):
    """Device to run a test on: the CPU, and a GPU where there is one."""
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("no GPU")
    return request.param
