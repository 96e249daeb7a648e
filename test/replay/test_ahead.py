"""Reading ahead and writing behind: order, errors, early ends, bounds."""

import threading

from persem_ros.ahead import read_ahead, WriteBehind
import pytest


def threads_called(name):
    """Return the threads of that name that are alive."""
    return [thread for thread in threading.enumerate() if thread.name == name]


def failing_after(n, error):
    """Yield 0 .. n - 1, then raise."""
    yield from range(n)
    raise error


def test_items_come_in_order_from_another_thread():
    makers = set()

    def items():
        for i in range(100):
            makers.add(threading.current_thread().name)
            yield i

    assert list(read_ahead(items())) == list(range(100))
    assert makers == {'read ahead'}
    assert list(read_ahead(iter([]))) == []
    assert not threads_called('read ahead')


def test_what_the_iterator_raises_comes_in_its_place():
    taken = []
    with pytest.raises(ZeroDivisionError, match='third'):
        for item in read_ahead(failing_after(3, ZeroDivisionError('third'))):
            taken.append(item)
    assert taken == [0, 1, 2]


def test_no_more_than_depth_items_wait():
    made, full = [], threading.Event()

    def items():
        for i in range(50):
            made.append(i)
            if len(made) == 4:      # one taken, two waiting, one that has no room
                full.set()
            yield i

    ahead = read_ahead(items(), depth=2)
    next(ahead)
    assert full.wait(10)
    assert len(made) <= 4
    assert list(ahead) == list(range(1, 50))


def test_a_consumer_that_stops_early_ends_the_thread():
    made = []

    def items():
        for i in range(10 ** 9):
            made.append(i)
            yield i

    ahead = read_ahead(items(), depth=2)
    assert [next(ahead), next(ahead)] == [0, 1]
    ahead.close()
    assert not threads_called('read ahead')
    assert len(made) < 10


def test_calls_are_made_in_order_by_another_thread():
    done = []
    with WriteBehind(depth=2) as later:
        for i in range(50):
            later(lambda i: done.append((i, threading.current_thread().name)), i)
    assert done == [(i, 'write behind') for i in range(50)]
    assert not threads_called('write behind')


def test_a_failing_call_stops_the_rest_and_is_raised():
    done, failed = [], threading.Event()

    def fail():
        failed.set()
        raise OSError(28, 'No space left on device')

    with pytest.raises(OSError, match='No space left'):
        with WriteBehind() as later:
            later(done.append, 1)
            later(fail)
            assert failed.wait(10)
            for i in range(1000):       # more than the queue holds: an earlier one raises
                later(done.append, 2 + i)
    assert done == [1]

    with pytest.raises(ZeroDivisionError):      # the last call of all
        with WriteBehind() as later:
            later(lambda: 1 / 0)


def test_an_error_in_the_block_drops_what_waits_and_wins():
    begun, go, done = threading.Event(), threading.Event(), []

    def slow():
        begun.set()
        assert go.wait(10)

    with pytest.raises(KeyboardInterrupt):
        with WriteBehind() as later:
            later(slow)
            later(done.append, 1)
            assert begun.wait(10)
            threading.Timer(0.05, go.set).start()
            raise KeyboardInterrupt
    assert done == []
    assert not threads_called('write behind')
