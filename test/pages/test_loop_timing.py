"""Loops are measured over all starts of their nodes."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.bags.run import Diagnostic
from denoc_ros.pages.loop_timing import SECOND, loop_measures

# what a node counts at each second: ticks, late ones, deadlines passed over; then from zero on
FIRST, AGAIN = [(1000, 5, 300), (2000, 6, 300)], [(900, 1, 0), (1900, 2, 11)]


def said(rows: list[tuple[int, int, int]]) -> list[Diagnostic]:
    """Return a plant's words, one a second from 1 s on."""
    found = []
    for k, (ticks, late, skipped) in enumerate(rows):
        values = {
            'ticks': f'{ticks}',
            'overruns_total': f'{late}',
            'skipped_total': f'{skipped}',
            'histogram_counts': f'{ticks - late} {late}',
            'histogram_edges': '0 1.5 2',
            'nominal_rate_hz': '1000',
            'period_p50_us': '1000',
            'period_p99_us': '1050',
            'period_max_us': f'{1100 + k}',
        }
        found.append(Diagnostic((k + 1) * SECOND, 'plant: loop', 0, '', '', values))
    return found


@pytest.mark.parametrize(
    ('since', 'expected'),
    [
        (0, (3900, 8, 311)),  # the whole of both
        (2, (2900, 3, 11)),  # what came after the first second of the first start
        (3, (1900, 2, 11)),  # the second start
    ],
)
def test_all_starts_of_a_node_are_counted(since: int, expected: tuple[int, int, int]) -> None:
    (loop,) = loop_measures(said(FIRST + AGAIN), since * SECOND)
    assert (loop.ticks, loop.late, loop.skipped) == expected
    np.testing.assert_array_equal(loop.counts, [expected[0] - expected[1], expected[1]])
    assert loop.longest == pytest.approx(1.103e-3)
