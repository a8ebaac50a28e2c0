import numpy as np
import pytest
import torch
from matplotlib import colormaps

from mobilestereonet.data.images import to_picture
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.plots import (
    colour_disparity,
    contact_sheet,
    depth_picture,
    error_map,
    side_by_side,
)


def test_disparity_colours_are_those_of_turbo():
    disparity = np.linspace(0, 64, 256, dtype=np.float32).reshape(4, 64)
    picture = colour_disparity(disparity, maximum=64)
    expected = colormaps["turbo"](disparity / 64, bytes=True)[..., :3]
    assert picture.dtype == np.uint8
    # OpenCV and matplotlib round the published table differently by one level.
    assert np.abs(picture.astype(int) - expected).max() <= 1


def test_unknown_disparities_are_black():
    disparity = torch.tensor([[10.0, float("nan"), float("inf"), 20.0]])
    picture = colour_disparity(disparity, valid=torch.tensor([[True, True, True, False]]))
    assert picture[0, 0].any()
    assert not picture[0, 1:].any()
    assert not colour_disparity(disparity, valid=torch.zeros(1, 4)).any()


def test_a_wild_value_does_not_take_the_range():
    disparity = np.tile(np.linspace(1, 100, 400, dtype=np.float32), (10, 1))
    wild = disparity.copy()
    wild[0, 0] = 1e6
    plain = colour_disparity(disparity).astype(int)
    assert np.abs(colour_disparity(wild).astype(int) - plain)[1:].max() < 12


def test_depth_is_coloured_as_its_disparity_beside_a_bar():
    depth = np.repeat(np.linspace(1, 9, 300)[:, None], 40, axis=1)
    depth[:3] = 0
    picture = depth_picture(depth)
    near = 1 / np.percentile(1 / depth[3:], 99)
    disparity = colour_disparity(near / np.where(depth > 0, depth, np.inf), 1, depth > 0)
    np.testing.assert_allclose(picture[:, :40], disparity, atol=8)  # rounding
    assert (picture[:3, :40] == 0).all()
    bar = picture[:, 40 + 4 :]
    # Marks stand where the bar has the colour of their distance: 2 m is half of the nearest's.
    marked = np.flatnonzero((bar[:, 20:] < 128).any(axis=(1, 2)))
    row = round((1 - near / 2) * 299)
    assert row in marked and len(marked) > 30
    there = picture[np.abs(depth[:, 0] - 2).argmin(), 0]
    np.testing.assert_allclose(bar[row, 0], there, atol=8)
    assert depth_picture(np.zeros((9, 9))).shape[0] == 9


def test_error_map_has_kittis_steps():
    # min(error / 3, error / 5 %) of the threshold, and the colour that the devkit gives it.
    steps = [
        (0.0, (49, 54, 149)),
        (0.1, (69, 117, 180)),
        (0.2, (116, 173, 209)),
        (0.4, (171, 217, 233)),
        (0.9, (224, 243, 248)),
        (1.1, (254, 224, 144)),
        (3.0, (253, 174, 97)),
        (7.0, (244, 109, 67)),
        (9.0, (215, 48, 39)),
        (99.0, (165, 0, 38)),
    ]
    share = np.array([[step for step, _ in steps]], dtype=np.float32)
    truth = np.full_like(share, 40)  # 5 % are 2 px: 3 px is the threshold
    picture = error_map(truth + 3 * share, truth)
    np.testing.assert_array_equal(picture[0], [colour for _, colour in steps])
    # At 100 px of ground truth 4 px are less than 5 %, although more than 3 px.
    assert tuple(error_map(np.array([[104.0]]), np.array([[100.0]]))[0, 0]) == (224, 243, 248)


def test_error_map_without_truth_and_occluded():
    truth = torch.tensor([[40.0, 0.0, 40.0, 40.0]])
    valid = torch.tensor([[True, False, False, True]])
    occluded = torch.tensor([[False, False, False, True]])
    picture = error_map(truth, truth, valid, occluded)
    np.testing.assert_array_equal(picture[0], [(49, 54, 149), (0, 0, 0), (0, 0, 0), (24, 27, 74)])
    assert not error_map(truth, truth)[0, 1].any()


def test_side_by_side():
    red = np.full((10, 20, 3), (255, 0, 0), np.uint8)
    blue = np.full((6, 30, 3), (0, 0, 255), np.uint8)
    row = side_by_side([red, blue])
    assert row.shape == (10, 20 + 4 + 30, 3)
    assert (row[:, :20] == red).all() and (row[:6, 24:] == blue).all()
    assert (row[:, 20:24] == 255).all() and (row[6:, 24:] == 255).all()
    titled = side_by_side([red, blue], ["left", "right"])
    assert (titled[-10:] == row).all()
    assert (titled[: len(titled) - 10] < 128).any()


def test_to_picture():
    view = torch.tensor([0.0, 0.5, 1.0])[:, None, None].expand(3, 2, 4)
    picture = to_picture(view)
    assert picture.shape == (2, 4, 3)
    assert tuple(picture[0, 0]) == (0, 128, 255)


def test_contact_sheet():
    views = torch.rand(3, 20, 40)
    disparity = torch.full((20, 40), 9.0)
    occluded = torch.zeros(20, 40, dtype=torch.bool)
    occluded[:, :20] = True
    full = StereoSample(views, views, disparity, disparity > 0, occluded, name="full")
    bare = StereoSample(torch.rand(3, 10, 40), torch.rand(3, 10, 40), name="bare")
    sheet = contact_sheet([full, bare], width=80)
    assert sheet.shape == (24 + 40 + 24 + 20, 4 * 80 + 3 * 4, 3)
    occlusion = sheet[24:64, -80:]
    assert (occlusion[:, :40] == 255).all() and (occlusion[:, 40:] == 0).all()
    assert (sheet[-20:, -80:] == 128).all()
    with pytest.raises(InputError, match="at least one sample"):
        contact_sheet([])
