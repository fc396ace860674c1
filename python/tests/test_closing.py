"""Takes that are closed, by a ``with`` statement or by hand."""

import os
import sys
import threading

import numpy as np
import pytest

import mocapd


def is_open(path):
    files = (f"/proc/self/fd/{fd}" for fd in os.listdir("/proc/self/fd"))
    return str(path) in [os.readlink(file) for file in files if os.path.lexists(file)]


def test_with_closes_the_file(path):
    with mocapd.open(path) as take:
        assert not take.closed and "closed" not in repr(take)
        part = take.read(1, 2)
    assert take.closed and "closed" in repr(take)
    np.testing.assert_array_equal(part, mocapd.open(path).read(1, 2))
    assert take.n_frames == 4200 and len(take.labels) == 70 and take.header.rate_hz == 120


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="open files are listed in /proc")
def test_the_file_is_held_open_until_then(path):
    assert not is_open(path)
    with mocapd.open(path) as take:
        assert is_open(path)
        take.read(0, 1)
    assert not is_open(path)
    with pytest.raises(RuntimeError, match="in the block"), mocapd.open(path) as take:
        raise RuntimeError("in the block")
    assert take.closed and not is_open(path)
    # As without a block, it is open as long as something refers to it.
    take = mocapd.open(path)
    assert is_open(path)
    del take
    assert not is_open(path)


def test_reading_a_closed_take_is_an_error(path):
    take = mocapd.open(path)
    positions = take.positions
    take.close()
    take.close()
    for wrong in (
        take.read,
        lambda: take[:10],
        lambda: take["M01"].positions,
        lambda: take.summary,
        take.knots,
        lambda: take.lost,
        lambda: take.analog,
        lambda: take.metadata,
        lambda: take.force_plates,
        take.to_pandas,
        take.to_xarray,
        take.__enter__,
    ):
        with pytest.raises(ValueError, match=r"made\.take.* closed.*mocapd\.open"):
            wrong()
    # What was read stays.
    assert take.positions is positions and take.events == ()


def test_closing_while_another_thread_reads(path):
    take = mocapd.open(path, threads=1)
    whole = mocapd.open(path).positions
    found = []

    def work():
        try:
            for _ in range(200):
                found.append(np.array_equal(take.read(), whole, equal_nan=True))
        except ValueError as error:
            found.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    while not found:
        pass
    take.close()
    thread.join()
    assert "closed" in found.pop() and all(found)
