"""The first Ctrl-C as a wish, the second one as usual."""

import signal
import threading

import pytest

from mobilestereonet.interruption import sigint_sets_event


@pytest.fixture(params=[signal.default_int_handler, signal.SIG_IGN, lambda *_: None])
def handler(request):
    """The handler of Ctrl-C before: Python's own, none, another one."""
    before = signal.signal(signal.SIGINT, request.param)
    yield request.param
    signal.signal(signal.SIGINT, before)


def test_the_first_ctrl_c_sets_the_event_the_second_one_interrupts(handler):
    stop, told = threading.Event(), []
    with sigint_sets_event(stop, lambda: told.append(stop.is_set())):
        inside = signal.getsignal(signal.SIGINT)
        assert (inside is handler) == (handler is not signal.default_int_handler)
        if inside is not handler:
            inside(signal.SIGINT, None)
            assert stop.is_set() and told == [True]
            with pytest.raises(KeyboardInterrupt):
                signal.getsignal(signal.SIGINT)(signal.SIGINT, None)
    assert signal.getsignal(signal.SIGINT) is handler


def test_work_that_fails_gives_the_handler_back(handler):
    with pytest.raises(ZeroDivisionError), sigint_sets_event(threading.Event()):
        1 / 0  # noqa: B018
    assert signal.getsignal(signal.SIGINT) is handler


def test_another_thread_leaves_ctrl_c_alone(handler):
    seen = []

    def work():
        with sigint_sets_event(threading.Event()):
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [handler]
