"""Pairing of what two cameras took, by its times."""

import random
from operator import attrgetter
from types import SimpleNamespace

from mobilestereonet.streams.pairing import pair_by_time, pair_nearest

stamp_of = attrgetter("stamp")


def test_pairs_are_the_nearest_ones():
    def images(side, *stamps):
        return [(side, SimpleNamespace(stamp=stamp)) for stamp in stamps]

    def stamps(pairs):
        return [tuple(view and view.stamp for view in pair) for pair in pairs]

    left, right = images(0, 10, 20, 30, 40), images(1, 11, 19, 33, 60)
    expected = [(10, 11), (20, 19), (30, 33), (40, None), (None, 60)]
    for order in (left + right, right + left):
        assert stamps(pair_nearest(order, stamp_of, 3)) == expected
    # The nearer one counts, not the first one that is near enough.
    assert stamps(pair_nearest(images(0, 10, 12) + images(1, 13), stamp_of, 5)) == [
        (10, None),
        (12, 13),
    ]
    # A camera that stops does not fill the memory: its partner's images are given up.
    many = pair_nearest(images(0, *range(1000)) + images(1, 0), stamp_of, 0)
    assert stamps([next(many)]) == [(0, None)]


def test_pairs_do_not_depend_on_the_order_of_the_bag():
    rng = random.Random(3)
    images = [
        (side, SimpleNamespace(stamp=100 * i + rng.randint(-8, 8)))
        for i in range(40)
        for side in (0, 1)
        if rng.random() < 0.8
    ]
    late = sorted(images, key=lambda image: (image[1].stamp + 700 * image[0], image[0]))
    by_stamp = sorted(images, key=lambda image: image[1].stamp)
    pairs = [list(pair_nearest(order, stamp_of, 16)) for order in (by_stamp, late)]
    assert {tuple(map(id, pair)) for pair in pairs[0]} == {
        tuple(map(id, pair)) for pair in pairs[1]
    }
    assert sum(None not in pair for pair in pairs[0]) > 15


def test_two_recordings_are_paired_by_the_nearest_moments():
    """The first left one is near enough to the first right one, the second is nearer."""
    dropped = []
    pairs = pair_by_time([0.0, 0.012, 0.1], [0.013, 0.099, 0.3], float, 0.02, dropped)
    assert list(pairs) == [(0.012, 0.013), (0.1, 0.099)]
    assert dropped == [0.0, 0.3]
    assert list(pair_by_time([], [1.0], float, 1.0, dropped)) == []
    assert dropped == [0.0, 0.3, 1.0]
