"""Image-guided refinement, on pictures whose right answer is known."""

import pytest
import torch

from mobilestereonet.inference import refine
from mobilestereonet.inference.refine import matching_features, refine_disparity

BACK, FRONT = 10.0, 40.0


def scene(edge=60, size=(40, 120)):
    """A dark surface in front, right of column ``edge``, of a bright one; sure everywhere."""
    column = torch.arange(size[1]).expand(size)
    truth = torch.where(column >= edge, FRONT, BACK)
    views = [
        torch.where(column >= first, 0.2, 0.8).expand(1, 3, *size) for first in (edge, edge - FRONT)
    ]
    return truth[None], torch.ones(1, *size), views


def textured(edge=60, size=(40, 120)):
    """The same surfaces, with one texture on both of them."""
    truth, sure, _ = scene(edge, size)
    right = 0.45 + 0.1 * torch.rand(1, 3, *size)
    return truth, sure, [left_of(right, truth), right]


def left_of(right, disparity):
    """The left view whose pixels match those of the right view at a disparity."""
    match = torch.arange(right.shape[-1]) - disparity.long()
    return right.gather(-1, match.clamp(min=0)[:, None].expand_as(right))


def test_what_is_right_stays_bit_for_bit():
    truth, sure, views = scene()
    slanted = truth + torch.linspace(0, 3, truth.shape[-1])
    assert torch.equal(refine_disparity(slanted, sure, *views), slanted)


def test_a_steep_surface_has_no_edges():
    torch.manual_seed(0)
    _, sure, views = textured()
    steep = torch.arange(120.0).expand(1, 40, 120)  # 14 px from one of 3 x 3 neighbours to another
    assert torch.equal(refine_disparity(steep, sure, *views), steep)


def test_unsure_pixels_take_the_background():
    truth, sure, views = scene()
    found, sure = truth.clone(), sure.clone()
    found[..., 45:60], sure[..., 45:60] = 33.0, 0.1  # what the right camera does not see
    found[..., :9], sure[..., :9] = 99.0, 0.2  # neither the left border: one neighbour
    assert torch.equal(refine_disparity(found, sure, *views), truth)


@pytest.mark.parametrize(
    ("first", "last", "background"),
    [
        (26, 60, BACK),  # the step is 30 px
        (25, 60, None),
        (80, 84, FRONT),  # no step
        (80, 85, None),
        (0, 14, BACK),  # the left border, beyond which 10 px lie
        (0, 15, None),
        (115, 120, None),  # nothing hides the right border
    ],
)
def test_a_gap_wider_than_what_occlusion_hides_stays(first, last, background):
    found, sure, views = scene()
    found[..., first:last], sure[..., first:last] = 42.0, 0.1
    middle = refine_disparity(found, sure, *views)[..., (first + last) // 2]
    assert (middle == (42.0 if background is None else background)).all()


def test_nothing_is_hidden_right_of_a_nearer_surface():
    found, sure, views = scene()
    found, sure, *views = (map_.flip(-1) for map_ in (found, sure, *views))
    found[..., 60:80], sure[..., 60:80] = 42.0, 0.1
    assert (refine_disparity(found, sure, *views)[..., 70] == 42.0).all()


def test_a_row_without_any_sure_pixel_is_left_alone():
    truth, sure, views = scene()
    assert torch.equal(refine_disparity(truth, 0.1 * sure, *views), truth)


def test_edges_follow_the_colours():
    _, sure, (left, _) = scene(edge=60)
    plain = torch.full_like(left, 0.5)  # a right view that tells nothing
    for found_at in (57, 62):
        found, _, _ = scene(edge=found_at)
        assert torch.equal(refine_disparity(found, sure, left, plain), scene(edge=60)[0])
        # Without a picture that tells where, the edge stays.
        assert torch.equal(refine_disparity(found, sure, plain, plain), found)


@pytest.mark.parametrize("found_at", [56, 64])
def test_edges_lie_where_the_views_match(found_at):
    torch.manual_seed(0)
    truth, sure, (left, right) = textured(edge=60)
    found, _, _ = scene(edge=found_at)
    columns = slice(44, None)  # whose matches lie inside of the right view
    wrong = (found != truth)[..., columns]
    refined = refine_disparity(found, sure, left, right)
    assert (refined != truth)[..., columns].sum() < 0.2 * wrong.sum()
    # Where nothing matches, colours of one texture tell little.
    other = refine_disparity(found, sure, left, right.flip(-2))
    assert (other != truth)[..., columns].sum() > 0.6 * wrong.sum()


@pytest.mark.parametrize("across", [False, True])
def test_the_match_counts_whatever_the_exposure(across):
    torch.manual_seed(0)
    truth, sure, (left, right) = textured(edge=60)
    found, _, _ = scene(edge=64)
    if across:  # an edge along the rows
        truth, found = (
            torch.where(torch.arange(40)[:, None] < row, BACK, FRONT) for row in (20, 24)
        )
        truth, found = (map_.expand(1, 40, 120) for map_ in (truth, found))
        left = left_of(right, truth)
    inside = slice(44, None)
    refined = refine_disparity(found, sure, left, 0.5 * right + 0.3)
    wrong = (found != truth)[..., inside].sum()
    assert (refined != truth)[..., inside].sum() < 0.3 * wrong


def test_matching_features():
    ramp = (0.3 * torch.arange(6.0)).expand(1, 1, 6, 6)
    brightness, along_rows, along_columns = matching_features(ramp)[0]
    assert torch.equal(brightness, ramp[0, 0])
    torch.testing.assert_close(along_rows[:, 1:-1], torch.full((6, 4), 0.6))  # twice the slope
    assert (along_columns == 0).all()
    _, along_rows, along_columns = matching_features(ramp.mT)[0]
    torch.testing.assert_close(along_columns[1:-1], torch.full((4, 6), 0.6))
    assert (along_rows == 0).all()
    assert matching_features(10 * ramp).abs().max() == 2


def test_a_match_outside_of_the_right_view_is_neither_good_nor_bad():
    torch.manual_seed(0)
    sure, edge = torch.ones(1, 40, 120), slice(16, 20)  # FRONT has its match outside there
    left, right = 0.45 + 0.1 * torch.rand(2, 1, 3, 40, 120)
    found = torch.full((1, 40, 120), BACK)
    found[..., 20:40] = FRONT
    # Of a BACK that does not match some pixels go over to FRONT: all would if outside cost 0.
    refined = refine_disparity(found, sure, left, right)
    assert 0.1 < (refined[..., edge] == FRONT).float().mean() < 0.6
    found[..., :20], found[..., 20:40] = FRONT, BACK
    # To a BACK that matches some go over from FRONT: all would if outside cost 1.
    refined = refine_disparity(found, sure, right.roll(int(BACK), -1), right)
    assert 0.1 < (refined[..., edge] == BACK).float().mean() < 0.6


def test_sure_neighbours_outvote_unsure_ones():
    _, _, views = scene()
    found = torch.full((1, 40, 120), BACK)
    found[..., ::4] = FRONT  # stripes, and pictures of one colour
    views = [torch.full_like(view, 0.5) for view in views]
    sure = torch.where(found == BACK, 1.0, 0.35)
    assert (refine_disparity(found, sure, *views)[..., 8:-8] == BACK).all()
    back = refine_disparity(found, torch.where(found == BACK, 0.35, 1.0), *views)[..., 8:-8]
    assert (back == FRONT).float().mean() > 0.2


@pytest.mark.parametrize("chunk", [100, 1 << 15])
def test_batches_are_pairs_one_by_one(device, chunk, monkeypatch):
    monkeypatch.setattr(refine, "_CHUNK_CPU", chunk)
    torch.manual_seed(0)
    found = 60 * torch.rand(2, 1, 24, 40).repeat_interleave(2, -1).squeeze(1).to(device)
    sure, views = torch.rand(2, 24, 80).to(device), torch.rand(2, 2, 3, 24, 80).to(device)
    both = refine_disparity(found, sure, *views)
    for index in range(2):
        one = slice(index, index + 1)
        assert torch.equal(both[one], refine_disparity(found[one], sure[one], *views[:, one]))
    assert not torch.equal(both, found)


def test_nothing_leaves_the_device(monkeypatch):
    # Tensors of the device "meta" hold no numbers, so the edges are given.
    edges = torch.zeros(5, 3, dtype=torch.int64, device="meta")
    monkeypatch.setattr(refine, "_edge_pixels", lambda *_: edges)
    maps = (
        torch.rand(2, *size, device="meta")
        for size in ((24, 80), (24, 80), (3, 24, 80), (3, 24, 80))
    )
    refined = refine_disparity(*maps)
    assert refined.device.type == "meta"
    assert refined.shape == (2, 24, 80)
