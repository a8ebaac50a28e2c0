"""The first look: what it finds, puts right and leaves alone."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from mobilestereonet import Calibration, InputError, StereoMatcher
from mobilestereonet.data.rig import Camera, CameraPair, Rig
from mobilestereonet.inference import Rectifier, load_pair
from mobilestereonet.inference.arrangement import Arrangement, Turn
from mobilestereonet.inference.first_look import ViewOptions, check_whole, put_right

HEIGHT, WIDTH = 180, 260


def scene(seed=0):
    """A textured plane that is nearer below: its points move left by 8 to 24 px."""
    noise = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH + 80, 3), dtype=np.uint8)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.6), None, 0, 255, cv2.NORM_MINMAX)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    moved = columns + 8 + 16 * rows / HEIGHT
    return texture[:, :WIDTH].copy(), cv2.remap(texture, moved, rows, cv2.INTER_LINEAR)


LEFT, RIGHT = scene()


def found(pair):
    return {finding.check: finding.level for finding in pair.findings if finding.level != "good"}


def same(pair, left=LEFT, right=RIGHT):
    return np.array_equal(pair.left_image, left) and np.array_equal(pair.right_image, right)


def half_turn(view):
    return np.ascontiguousarray(view[::-1, ::-1])


def mirror(view):
    return np.ascontiguousarray(view[:, ::-1])


def flipped(view):
    return np.ascontiguousarray(view[::-1])


def test_a_good_pair_is_left_alone():
    pair = put_right(load_pair(LEFT, RIGHT))
    assert same(pair)
    assert found(pair) == {}


@pytest.mark.parametrize(
    ("left", "right", "fixed"),
    [
        (RIGHT, LEFT, {"order"}),
        (LEFT, half_turn(RIGHT), {"orientation"}),
        (half_turn(LEFT), RIGHT, {"orientation"}),
        (LEFT, mirror(RIGHT), {"orientation"}),
        (mirror(LEFT), RIGHT, {"orientation"}),
        (LEFT, flipped(RIGHT), {"orientation"}),
        (np.rot90(LEFT), np.rot90(RIGHT), {"orientation"}),
        (np.rot90(LEFT, -1), np.rot90(RIGHT, -1), {"orientation"}),
    ],
)
def test_what_can_be_put_right_is(left, right, fixed):
    pair = put_right(load_pair(left, right))
    assert same(pair)
    assert found(pair) == dict.fromkeys(fixed, "fixed")
    assert np.allclose(pair.left.permute(1, 2, 0) * 255, LEFT, atol=1e-3)
    told = {finding.check: finding for finding in pair.findings}
    assert all("--" in told[check].advice for check in fixed)
    problems = [f.check for f in check_whole(load_pair(left, right), 192) if f.level == "problem"]
    assert fixed <= set(problems)


def test_both_views_upside_down_are_matched_in_the_other_order():
    pair = put_right(load_pair(half_turn(LEFT), half_turn(RIGHT)))
    assert same(pair, half_turn(RIGHT), half_turn(LEFT))
    assert found(pair) == {"order": "fixed"}


@pytest.mark.parametrize(
    ("picture", "fixed"),
    [
        (np.hstack([LEFT, RIGHT]), set()),
        (np.hstack([RIGHT, LEFT]), {"order"}),
        (np.vstack([LEFT, RIGHT]), {"layout"}),
        (np.vstack([RIGHT, LEFT]), {"layout", "order"}),
    ],
)
def test_one_picture_with_both_views(picture, fixed):
    pair = put_right(load_pair(picture))
    assert same(pair)
    assert set(found(pair)) == fixed


def test_the_user_overrules_the_look():
    swapped = put_right(load_pair(RIGHT, LEFT), ViewOptions(order="left-right"))
    assert same(swapped, RIGHT, LEFT)
    assert found(swapped) == {"order": "warning"}
    assert same(put_right(load_pair(RIGHT, LEFT), ViewOptions(order="right-left")))
    turned = load_pair(half_turn(LEFT), half_turn(RIGHT))
    assert same(put_right(turned, ViewOptions(rotate=180)))
    kept = put_right(load_pair(LEFT, half_turn(RIGHT)), ViewOptions(rotate=0))
    assert same(kept, LEFT, half_turn(RIGHT))
    assert found(kept)["orientation"] == "warning"
    stacked = load_pair(np.vstack([LEFT, RIGHT]))
    assert same(put_right(stacked, ViewOptions(layout="top-bottom")))
    beside = put_right(stacked, ViewOptions(layout="side-by-side"))
    assert beside.left_image.shape == (2 * HEIGHT, WIDTH // 2, 3)
    with pytest.raises(InputError, match="rotate is one of 0, 90, 180, 270; got 45"):
        ViewOptions(rotate=45)


def missing(view):
    view = view.copy()
    view[HEIGHT // 2 :] = 128
    return view


OTHER = scene(seed=1)[0]


@pytest.mark.parametrize(
    ("left", "right", "check"),
    [
        (LEFT, LEFT, "content"),
        (LEFT, np.full_like(LEFT, 90), "content"),
        (LEFT, missing(RIGHT), "content"),
        (LEFT, np.roll(RIGHT, 5, axis=0), "rectified"),
        (LEFT, OTHER, "overlap"),
    ],
)
def test_what_cannot_be_put_right_is_a_problem(left, right, check):
    pair = put_right(load_pair(left, right))
    assert same(pair, left, right)
    assert found(pair) == {check: "problem"}


def test_the_matcher_looks_unless_it_is_told_not_to():
    matcher = StereoMatcher.from_pretrained("sgbm", max_disparity=64)
    result, expected = matcher(RIGHT, LEFT), matcher(LEFT, RIGHT)
    np.testing.assert_array_equal(result.disparity, expected.disparity)
    assert {f.check for f in result.findings if f.level == "fixed"} == {"order"}
    kept = matcher(RIGHT, LEFT, look=False)
    np.testing.assert_array_equal(kept.left, RIGHT)
    assert [finding.check for finding in kept.findings] == ["content", "exposure"]


SIZE = (WIDTH, HEIGHT)


def raw_rig(angle=0.1, distortion=-0.1):
    """Two cameras, of which the right one alone is turned and distorted."""
    matrix = np.array([[300.0, 0, WIDTH / 2], [0, 300, HEIGHT / 2], [0, 0, 1]])
    left, right = (Camera(matrix, np.array([d, 0, 0, 0, 0])) for d in (0.0, distortion))
    turned = cv2.Rodrigues(np.array([0, 0, angle]))[0]
    return Rig((CameraPair(left, right, turned, np.array([-0.1, 0, 0]), SIZE),))


def known(**geometry):
    """Has the calibration of rectified views."""
    return Rectifier(Rig((Calibration(focal=300, baseline=0.1, **geometry),), "known"))


def test_views_are_arranged_as_the_user_says_before_they_are_rectified():
    rectifier = Rectifier(raw_rig())
    expected = rectifier.pair(load_pair(LEFT, RIGHT))
    swapped = put_right(load_pair(RIGHT, LEFT), ViewOptions(order="right-left"), rectifier)
    assert same(swapped, expected.left_image, expected.right_image)
    assert swapped.calibration == expected.calibration
    both = load_pair(np.vstack([LEFT, RIGHT]))
    stacked = put_right(both, None, rectifier)
    assert same(stacked, expected.left_image, expected.right_image)
    assert "layout" in {finding.check for finding in check_whole(both, 192, rectifier)}


def test_rectified_views_are_not_exchanged_afterwards():
    rectifier = Rectifier(raw_rig(angle=0.0, distortion=0.0))
    pair = put_right(load_pair(RIGHT, LEFT), rectifier=rectifier)
    assert found(pair) == {"order": "problem"}
    assert "--order right-left" in {f.check: f for f in pair.findings}["order"].advice
    expected = rectifier.pair(load_pair(RIGHT, LEFT))
    assert same(pair, expected.left_image, expected.right_image)
    matcher = StereoMatcher.from_pretrained("sgbm", max_disparity=64, rig=rectifier.rig)
    result = matcher(RIGHT, LEFT)
    np.testing.assert_array_equal(result.left, expected.left_image)
    assert "order" in {f.check for f in result.findings if f.level == "problem"}


def cropped(columns):
    """The pair of cameras that see all things moved by as many columns more."""
    if columns > 0:
        return LEFT[:, :-columns].copy(), RIGHT[:, columns:].copy()
    return LEFT[:, -columns:].copy(), RIGHT[:, :columns].copy()


CONVERGING = cropped(-40)  # disparities of -32 to -16 px


def test_cameras_that_converge_are_in_order_if_their_calibration_says_so():
    converging = load_pair(*CONVERGING)
    assert found(put_right(converging)) == {"order": "fixed"}
    pair = put_right(converging, rectifier=known(doffs=60))
    assert same(pair, *CONVERGING)
    assert found(pair) == {"range": "problem"}  # nothing is searched below 0
    assert "--shift -" in {f.check: f for f in pair.findings}["range"].advice
    assert found(put_right(converging, rectifier=known(doffs=60), shift=-48)) == {}
    levels = {f.check: f.level for f in check_whole(converging, 192, known(doffs=60))}
    assert levels["order"] == "good"
    half = load_pair(CONVERGING[0], half_turn(CONVERGING[1]))
    assert same(put_right(half, rectifier=known(doffs=60), shift=-48), *CONVERGING)


def test_the_rig_of_exchanged_files_is_that_of_the_right_order():
    geometry = known(doffs=5, cx=120, cy=80)
    expected = put_right(load_pair(LEFT, RIGHT), rectifier=geometry).calibration
    for options in (None, ViewOptions(order="right-left")):
        pair = put_right(load_pair(RIGHT, LEFT), options, geometry)
        assert same(pair)
        assert pair.calibration == expected


@pytest.mark.parametrize(
    ("arrangement", "principal", "doffs"),
    [
        (Arrangement(left=Turn(180), right=Turn(180), swapped=True), (WIDTH - 126, 99), 5),
        (Arrangement(left=Turn(180), right=Turn(180)), (WIDTH - 121, 99), -5),
        (Arrangement(swapped=True), (125, 80), -5),
        (Arrangement(right=Turn(180)), (120, 80), WIDTH - 126 - 120),
    ],
)
def test_the_calibration_follows_the_views(arrangement, principal, doffs):
    given = Calibration(focal=300, baseline=0.1, doffs=5, cx=120, cy=80)
    pair = arrangement(replace(load_pair(LEFT, RIGHT), calibration=given))
    assert (pair.calibration.cx, pair.calibration.cy) == principal
    assert pair.calibration.doffs == doffs
    unknown = arrangement.calibration(replace(given, doffs=0, cx=None, cy=None), SIZE)
    assert (unknown.cx, unknown.cy, unknown.doffs) == (None, None, 0)


def test_a_calibration_of_views_side_by_side_does_not_fit_views_that_are_turned():
    given = Calibration(focal=300, baseline=0.1)
    upright = replace(load_pair(np.rot90(LEFT), np.rot90(RIGHT)), calibration=given)
    with pytest.raises(InputError, match="--rotate 0"):
        put_right(upright)


def test_a_search_that_begins_elsewhere():
    converging = load_pair(*CONVERGING)
    assert found(put_right(converging, shift=-48)) == {}
    few = StereoMatcher.from_pretrained("sgbm", max_disparity=64, shift=-48)
    assert found(few(*CONVERGING)) == {}
    assert found(few(LEFT, RIGHT)) == {"range": "problem"}  # up to 24 px, and it ends at 16
    near = load_pair(*cropped(60))  # 68 to 84 px
    assert found(put_right(near, max_disparity=64)) == {"range": "problem"}
    assert found(put_right(near, max_disparity=64 + 40, shift=40)) == {}
    assert found(put_right(load_pair(LEFT, RIGHT), max_disparity=104, shift=40)) == {
        "range": "warning"
    }


def test_one_view_above_the_other_with_odd_sides():
    views = LEFT[:, 1:], RIGHT[:, 1:]
    pair = load_pair(np.vstack(views), layout="top-bottom")
    assert same(put_right(pair, ViewOptions(layout="top-bottom")), *views)
    tensor = torch.from_numpy(np.vstack(views)).permute(2, 0, 1)
    assert same(load_pair(tensor, layout="top-bottom"), *views)
    with pytest.raises(InputError, match=r"259 px wide, .*--layout top-bottom says"):
        load_pair(tensor)
    odd = np.vstack([LEFT, RIGHT])[1:]
    with pytest.raises(InputError, match="359 px high"):
        load_pair(odd, layout="top-bottom")
    with pytest.raises(InputError, match="359 px high"):
        put_right(load_pair(odd), ViewOptions(layout="top-bottom"))
    assert put_right(load_pair(odd), ViewOptions(layout="side-by-side")).height == 359


@pytest.mark.parametrize(
    "picture",
    [
        LEFT,  # the left view alone
        np.hstack([LEFT, OTHER]),
        np.hstack([LEFT, mirror(LEFT)]),  # one view of something symmetric
        np.hstack([LEFT, missing(RIGHT)]),
        np.tile(np.linspace(0, 255, 2 * WIDTH, dtype=np.uint8), (HEIGHT, 1)),  # nothing to match
    ],
)
def test_one_view_is_not_taken_for_two(picture):
    pair = load_pair(picture)
    with pytest.raises(InputError, match=r"halves are not two views .*right view, too.*--layout"):
        put_right(pair)
    options = ViewOptions(layout="side-by-side")
    assert put_right(pair, options).width == picture.shape[1] // 2  # the user knows better
    (told,) = [f for f in check_whole(pair, 192) if f.check == "layout"]
    assert told.level == "problem"
    assert "layout" not in {f.check for f in check_whole(pair, 192, options=options)}


def test_all_checks_hear_how_the_views_lie():
    stacked = load_pair(np.vstack([RIGHT, LEFT]), layout="top-bottom")
    levels = {f.check: f.level for f in check_whole(stacked, 192)}
    assert levels["order"] == "problem"
    options = ViewOptions(layout="top-bottom", order="right-left")
    levels = {f.check: f.level for f in check_whole(stacked, 192, options=options)}
    assert set(levels.values()) == {"good"}
    turned = load_pair(half_turn(RIGHT), half_turn(LEFT))
    options = ViewOptions(rotate=180, order="right-left")
    assert {f.level for f in check_whole(turned, 192, options=options)} == {"good"}
