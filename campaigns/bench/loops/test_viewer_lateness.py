"""The viewer's bench: its numbers are there, and who does not draw gets updates."""

from __future__ import annotations

import numpy as np
import pytest
from bench.loops.viewer_lateness import KINDS, LOOPS, Blocks, lateness


@pytest.mark.long
@pytest.mark.ros
def test_a_client_gets_updates_of_the_ssrms_beside_its_loops() -> None:
    found = lateness(1.0, 1, ('feedforward',))
    record = found.record()
    # A loaded machine gives a nice process little time: how much is judged by
    # `python -m campaigns watched`.
    assert found.updates[0] > 1.0
    for kind in KINDS:
        shares = record['processor'][kind]
        assert ('viewer' in shares, 'client' in shares) == (kind != 'alone', kind == 'watched')
        assert shares['feedforward'] > 0.0
    # most of the ticks of a second are there
    assert all(len(found.late['feedforward', kind][0]) > 200 for kind in KINDS)
    assert len(found.text()) == 2 * len(KINDS) + 1


def test_one_loop_that_is_late_or_too_few_updates_are_missed() -> None:
    rng = np.random.default_rng(2)

    def made(late_loop: str = '', updates: float = 30.0) -> Blocks:
        blocks = Blocks(updates=[updates, updates])
        for loop in LOOPS:
            for kind in KINDS:
                slow = 3.0 if (loop, kind) == (late_loop, 'watched') else 1.0
                blocks.late[loop, kind] = [slow * rng.exponential(size=400) for _ in range(6)]
        for kind in KINDS:
            blocks.processor[kind] = [{'feedforward': 0.2}]
        return blocks

    assert made().met
    assert not made(updates=20.0).met
    for loop in LOOPS:
        assert not made(late_loop=loop).met
