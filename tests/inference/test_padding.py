"""Padding and tiling undo themselves, whatever the sizes."""

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mobilestereonet.data.images import pad, unpad
from mobilestereonet.inference.tiling import BLEND_PX, CONTEXT_PX, match_in_tiles

sides = st.integers(2, 70)


@settings(deadline=None)
@given(
    height=sides,
    width=sides,
    above=st.integers(0, 40),
    right=st.integers(0, 40),
    zeros=st.booleans(),
)
def test_unpad_undoes_pad(height, width, above, right, zeros):
    view = torch.rand(2, 3, height, width)
    padded = pad(view, height + above, width + right, zeros=zeros)
    assert padded.shape == (2, 3, height + above, width + right)
    assert torch.equal(unpad(padded, height, width), view)
    # The map of a padded view is cut likewise, without its channels.
    assert torch.equal(unpad(padded[:, 0], height, width), view[:, 0])
    border = torch.zeros(()) if zeros else view[..., :1, :]
    assert (padded[..., :above, :width] == border).all()


@st.composite
def tilings(draw):
    """Size of a view, multiple of the engine, its range, and tiles that hold their margins."""
    multiple = draw(st.sampled_from([1, 8, 16, 32]))
    max_disparity = draw(st.integers(1, 64))
    margin = CONTEXT_PX + math.ceil(max_disparity / multiple) * multiple
    smallest = (2 * CONTEXT_PX + BLEND_PX, margin + CONTEXT_PX + BLEND_PX)
    tile = tuple(
        side + multiple * draw(st.integers(2, 200 // multiple + 2)) + 2 * multiple
        for side in smallest
    )
    size = draw(st.tuples(st.integers(2, 1400), st.integers(2, 1400)))
    return size, multiple, max_disparity, tile


@settings(deadline=None)
@given(tilings(), st.integers(1, 2))
def test_tiles_of_a_map_give_the_map(tiling, batch):
    size, multiple, max_disparity, tile = tiling
    view = torch.rand(batch, 1, *size)
    sizes = set()

    def match(left, right):
        assert torch.equal(left, right)
        padded = [math.ceil(side / multiple) * multiple for side in left.shape[-2:]]
        sizes.add(tuple(padded))
        assert padded[0] <= tile[0] and padded[1] <= tile[1]
        return left.squeeze(1)

    found = match_in_tiles(
        match, view, view, tile=tile, max_disparity=max_disparity, multiple=multiple
    )
    torch.testing.assert_close(found, view.squeeze(1), rtol=0, atol=1e-5)
    assert len(sizes) == 1, "an engine of fixed size could not run these tiles"
