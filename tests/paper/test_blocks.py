"""Costs of blocks by formula, and the figure of the expansion factor."""

import pytest

from mobilestereonet.errors import InputError
from mobilestereonet.paper.blocks import (
    block_macs,
    expansion_curve,
    plot_expansion,
    reduction_factor,
)


def test_block_formulas():
    assert block_macs("conv", 3, 32, 64) == 55296
    assert block_macs("v1", 2, 32, 64) == 9 * 32 + 32 * 64
    assert block_macs("v2", 3, 32, 64) == 32 * 64 + 27 * 64 + 64 * 64
    printed = {(2, "v1"): 7.9, (2, "v2"): 2.7, (3, "v1"): 18.9, (3, "v2"): 7.0}
    for (dims, kind), factor in printed.items():
        # The paper cuts 18.99 to 18.9.
        assert 0 <= reduction_factor(kind, dims, 32, 64) - factor + 0.05 < 0.15


def test_expansion_curve():
    assert expansion_curve(2, 32)[0] == pytest.approx(9216 / (32 * 32 + 9 * 32 + 32 * 32))
    assert expansion_curve(3, 128)[7] == pytest.approx(442368 / (8 * (2 * 16384 + 27 * 128)))
    for channels in (32, 64, 128):
        # The paper: in 2D the block is heavier than the convolution from t = 5 on.
        assert all(factor < 1 for factor in expansion_curve(2, channels)[4:])
        assert all(factor > 1 for factor in expansion_curve(3, channels))


def test_expansion_figure(tmp_path):
    plot_expansion(tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match=r"curve\.doc"):
        plot_expansion(tmp_path / "curve.doc")
    assert [path.name for path in tmp_path.iterdir()] == ["curve.png"]
