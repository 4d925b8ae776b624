"""Stamps of an input: which are taken, and that a wrong one does not shut out the next."""

from __future__ import annotations

from contextlib import suppress

import pytest

from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor

PERIOD_NS = 10_000_000
START_NS = 10**18


def fed(monitor: InputMonitor, first: int, last: int, ahead_ns: int = 0) -> int:
    """Give messages in turn, their stamps ahead of the clock; return how many were taken."""
    before = monitor.accepted
    for k in range(first, last):
        with suppress(InputError):
            monitor.accept(START_NS + k * PERIOD_NS + ahead_ns, 5.0 + 1e-9 * k * PERIOD_NS)
    return monitor.accepted - before


@pytest.mark.parametrize('ahead', [0.015, 0.06, 1.0, 1e3])
def test_a_single_stamp_from_the_future_does_not_shut_out_the_next(ahead: float) -> None:
    monitor = InputMonitor('/topic')
    assert fed(monitor, 0, 50) == 50
    assert fed(monitor, 50, 51, round(1e9 * ahead)) == 1
    assert fed(monitor, 51, 100) == 49


def test_a_clock_that_was_set_ahead_and_back_needs_a_reset() -> None:
    monitor = InputMonitor('/topic')
    assert fed(monitor, 0, 50) == 50
    assert fed(monitor, 50, 60, 10**12) == 10
    assert fed(monitor, 60, 100) == 0
    monitor.reset()
    assert fed(monitor, 100, 150) == 50


def test_after_a_stamp_from_the_future_no_older_one_than_before_is_taken() -> None:
    monitor = InputMonitor('/topic')
    fed(monitor, 0, 50)
    fed(monitor, 50, 51, 10**12)
    assert fed(monitor, 40, 50) == 0
    assert fed(monitor, 51, 52) == 1


def test_a_message_that_another_overtook_is_refused() -> None:
    monitor = InputMonitor('/topic')
    assert fed(monitor, 0, 50) == 50
    arrival = 5.0 + 1e-9 * 51 * PERIOD_NS - 1e-3  # The faster one is ahead of all others.
    monitor.accept(START_NS + 51 * PERIOD_NS, arrival)
    with pytest.raises(InputError, match='must not go back'):
        monitor.accept(START_NS + 50 * PERIOD_NS, arrival)


def test_a_message_without_a_stamp_compares_nothing() -> None:
    monitor = InputMonitor('/topic')
    fed(monitor, 0, 10)
    monitor.accept(None, 100.0)
    assert fed(monitor, 10, 20) == 10
