"""Signals that come at an awkward moment."""

from __future__ import annotations

import signal

import pytest

from denoc_ros.runtime.loop.ending import EndSignals, Interrupted


def test_a_signal_just_before_a_long_block_interrupts_it() -> None:
    signals = EndSignals()

    class Late(list[int]):
        """Empty when it is looked at; the signal comes just after."""

        def __bool__(self) -> bool:
            signals._on_signal(signal.SIGTERM, None)
            return False

    signals.received = Late()
    with pytest.raises(Interrupted), signals.interrupting():
        pytest.fail('the block must not begin')


def test_a_signal_that_was_kept_gives_a_later_block_up() -> None:
    signals = EndSignals()
    signals._on_signal(signal.SIGTERM, None)
    with pytest.raises(Interrupted), signals.interrupting():
        pytest.fail('the block must not begin')
    signals._on_signal(signal.SIGTERM, None)  # of no effect any more
    assert signals.received == [signal.SIGTERM] * 2
