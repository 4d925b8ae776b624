"""The bench of requests: its numbers are there, and requests are answered."""

from __future__ import annotations

import numpy as np
import pytest
from bench.loops.request_lateness import PERCENTILES, SHARES, Found, lateness


@pytest.mark.ros
def test_requests_are_answered_beside_loops_that_go_on() -> None:
    found = lateness(2.0 / 60.0, 2.0)
    # How many, and how late the ticks are, is judged by `python -m campaigns requests`: the
    # machine may be loaded.
    asked = found.asked['feedforward']
    assert asked['answered'] > 10, found.asked
    assert not asked['refused']
    assert len(found.late['requests'][0]) > 400
    assert len(found.late['bare'][0]) > 100
    assert len(found.text()) == 1 + len(SHARES) + len(found.asked)


def test_percentiles_are_those_of_all_blocks_together() -> None:
    counts = {'sent': 3.0, 'answered': 3.0, 'refused': 0.0, 'worst': 0.1}
    found = Found(asked={'feedforward': counts})
    for kind in SHARES:
        found.late[kind] = [np.arange(5001.0) * 1e-6, np.arange(5001.0, 10001.0) * 1e-6]
    expected = dict(zip(PERCENTILES, (9.9e-3, 9.99e-3, 9.999e-3, 1e-2), strict=True))
    for kind in SHARES:
        assert found.percentiles(kind) == pytest.approx(expected)
    assert found.met
    assert found.record()['lateness']['quiet']['ticks'] == 10001
    assert not Found(asked={'feedforward': {**counts, 'refused': 1.0}}).met
    assert not Found(asked={'feedforward': {**counts, 'answered': 2.0}}).met
    assert not Found(asked={'feedforward': {**counts, 'sent': 0.0, 'answered': 0.0}}).met
