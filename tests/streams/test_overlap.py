"""Items made ahead in a thread."""

import threading
import time

import pytest

from mobilestereonet.streams.overlap import latest_only, prefetch


def test_prefetch_keeps_the_order_and_the_number():
    assert list(prefetch(range(100), 3)) == list(range(100))
    assert list(prefetch([])) == []


def test_prefetch_makes_the_next_items_while_the_caller_works():
    made, third = [], threading.Event()

    def items():
        for item in range(6):
            made.append(item)
            if item == 2:
                third.set()
            yield item

    stream = prefetch(items(), 2)
    assert next(stream) == 0
    assert third.wait(5), "nothing was made while the caller held the first item"
    time.sleep(0.05)
    assert made == [0, 1, 2], "more was made ahead than may wait"
    stream.close()


def test_prefetch_hands_errors_over_in_their_place():
    def items():
        yield 1
        raise OSError("disk full")

    stream = prefetch(items())
    assert next(stream) == 1
    with pytest.raises(OSError, match="disk full"):
        next(stream)


def test_prefetch_ends_its_source_when_it_is_closed():
    ended = threading.Event()

    def items():
        try:
            while True:
                yield 0
        finally:
            ended.set()

    stream = prefetch(items())
    next(stream)
    stream.close()
    assert ended.is_set()


def test_latest_only_passes_over_what_came_meanwhile_and_gives_the_last_one():
    proceed = threading.Event()

    def items():
        yield 0
        proceed.wait(5)
        yield from range(1, 50)

    stream = latest_only(items())
    assert next(stream) == 0
    proceed.set()
    time.sleep(0.2)
    assert list(stream) == [49]


def test_latest_only_hands_errors_over_and_ends_its_source():
    ended = threading.Event()

    def broken():
        yield 0
        raise OSError("unplugged")

    def endless():
        try:
            while True:
                time.sleep(0.001)
                yield 0
        finally:
            ended.set()

    with pytest.raises(OSError, match="unplugged"):
        list(latest_only(broken()))
    stream = latest_only(endless())
    next(stream)
    stream.close()
    assert ended.is_set()
