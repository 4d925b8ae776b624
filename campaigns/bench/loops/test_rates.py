"""The rates campaign: nothing that is published is lost, and every number is there."""

from __future__ import annotations

import numpy as np
import pytest
from bench.loops.journal import Entries
from bench.loops.rates import measure, table
from bench.loops.rates_blocks import LOOPS, NODES, Window, loop_share, missing_messages

from denoc_ros.cli.session.session_config import load_config


def keys(*values: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.array(values, dtype=np.int64)


def test_missing_messages_are_counted_wherever_they_are() -> None:
    published, begin = keys(1, 2, 3, 4, 4, 5), 2
    assert missing_messages(published, keys(1, 2, 3, 4, 4, 5), begin) == 0
    assert missing_messages(published, keys(3, 4, 4, 5), begin) == 0
    assert missing_messages(published, keys(1, 2, 3, 4, 4), begin) == 1
    assert missing_messages(published, keys(3, 4, 5), begin) == 1
    assert missing_messages(published, keys(1, 4, 4), begin) == 2
    assert missing_messages(published, keys(), begin) == 4


def test_one_of_equal_messages_that_is_gone_is_one() -> None:
    still = [9] * 5  # before and after a motion, as commands at rest
    published = keys(*still, *range(1000, 1200), *still)
    recorded = keys(*still, *range(1000, 1200), *still[1:])
    assert missing_messages(published, recorded, 5) == 1
    assert missing_messages(published, np.delete(recorded, 100), 5) == 2


def test_deadlines_passed_over_count_as_missed() -> None:
    # ticks on time, late by 0.6 periods, and by 2.3: that passed two more deadlines over
    window = Window()
    start, late = window.begin + np.arange(3.0), np.array([0.0, 0.6, 2.3])
    window.finish = window.begin + 10.0
    share = loop_share(Entries({}, {}, {}, start, late, 1.0), window)
    assert (share.deadlines, share.missed) == (5, 4)


@pytest.mark.ros
@pytest.mark.alone
def test_campaign_loses_nothing_and_has_its_numbers() -> None:
    # a machine that stands still for longer than sockets hold may lose some, but not each time
    lost = []
    for _ in range(3):
        # a rate that a loaded machine keeps: how late the ticks are is not judged here
        campaign = measure(load_config('config/canadarm.yaml'), 200.0, seconds=1.0, blocks=1)
        lost.append({kind: getattr(campaign, kind)[0].missing for kind in ('ours', 'bare')})
        if not any(lost[-1].values()):
            break
    else:
        pytest.fail(f'messages must all be in a bag in one of three runs, missing: {lost}')
    record = campaign.record()
    for kind in ('ours', 'bare'):
        found = record[kind]
        assert found['missing'] == 0
        assert found['published'] > 0.5 * 9 * 200.0
        assert set(found['late_share']) == set(LOOPS)
        assert all(0.0 <= share <= 1.0 for share in found['late_share'].values())
        assert all(found['processor'][node] > 0.0 for node in NODES)
    assert len(table(campaign)) == 2 + len(NODES) + 2
