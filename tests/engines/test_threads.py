"""`use_threads` changes one thread of the program, for a while."""

import threading

import pytest
import torch

from mobilestereonet.engines import threads
from mobilestereonet.engines.threads import use_threads


def in_new_thread(function):
    results = []
    thread = threading.Thread(target=lambda: results.append(function()))
    thread.start()
    thread.join()
    return results[0]


@pytest.fixture(autouse=True)
def three_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    yield
    torch.set_num_threads(before)


def test_the_number_holds_inside_and_only_in_this_thread():
    with use_threads(1):
        assert torch.get_num_threads() == 1
        with use_threads(2):
            assert torch.get_num_threads() == 2
        assert torch.get_num_threads() == 1
        assert in_new_thread(torch.get_num_threads) == 3
    assert torch.get_num_threads() == 3
    assert in_new_thread(torch.get_num_threads) == 3


def test_an_error_inside_changes_nothing():
    with pytest.raises(ValueError, match="inside"), use_threads(1):
        raise ValueError("inside")
    assert torch.get_num_threads() == 3


def test_none_does_not_touch_the_setting(monkeypatch):
    def set_num_threads(count):
        raise AssertionError(f"set to {count}")

    monkeypatch.setattr(torch, "set_num_threads", set_num_threads)
    with use_threads(None):
        pass


@pytest.mark.parametrize("second", [None, 1, 2, 3])
def test_overlapping_uses_leave_the_setting_as_it_was(second):
    """One thread begins while another uses one thread, and ends after it."""
    begun, first_ended = threading.Event(), threading.Event()
    seen = []

    def overlap():
        with use_threads(second):
            seen.append(torch.get_num_threads())
            begun.set()
            assert first_ended.wait(10)
        seen.append(torch.get_num_threads())

    other = threading.Thread(target=overlap)
    with use_threads(1):
        other.start()
        assert begun.wait(10)
    first_ended.set()
    other.join()
    assert seen == [second or 3, 3]
    assert torch.get_num_threads() == 3
    assert in_new_thread(torch.get_num_threads) == 3


@pytest.mark.parametrize(
    ("seconds", "fitting"), [([1.0, 0.5], 1), ([1.0, 0.95], 3), ([0.5, 1.0], 3)]
)
def test_fewer_threads_where_they_are_clearly_faster(monkeypatch, seconds, fitting):
    for name in threads.THREAD_SETTINGS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(threads, "time_interleaved", lambda *runs, repeats: seconds)
    assert threads.fitting_threads() == fitting
    monkeypatch.setenv("OMP_NUM_THREADS", "3")  # what the user says is not measured
    assert threads.fitting_threads() == 3


def test_threads_are_really_timed(monkeypatch):
    for name in threads.THREAD_SETTINGS:
        monkeypatch.delenv(name, raising=False)
    assert threads.fitting_threads() in (1, 3)
    assert torch.get_num_threads() == 3
