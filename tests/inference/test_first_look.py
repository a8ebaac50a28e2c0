"""The first look: what it finds, puts right and leaves alone."""

import cv2
import numpy as np
import pytest

from mobilestereonet import InputError, StereoMatcher
from mobilestereonet.inference import load_pair
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
    assert found(kept)["orientation"] == "problem"
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
