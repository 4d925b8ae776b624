"""No fault moves the robot wrongly, hangs a node or needs cleaning up: the campaign, short."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from trust.outcome import Outcome, judge_torques, markdown
from trust.run import Act, acts, perform
from trust.stage import GOAL, LIMITS, POSTURE, Stage, Torques, staged

# the same in the tests of single nodes; `python -m campaigns soak` has them
LEFT_OUT = (
    'wrong length',
    'wrong joints',
    'second planner',
    'unwritable_cache',
    'killed_recorder',
    'short_disk',
)
SHORT = [(name, act) for name, act in acts(0.2, exact=False) if name not in LEFT_OUT]


@pytest.fixture(scope='module')
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with staged(tmp_path_factory.mktemp('stage')) as stage:
        stage.start_feedforward()
        yield stage


@pytest.mark.ros
@pytest.mark.alone
@pytest.mark.parametrize(('name', 'act'), SHORT, ids=[name for name, _ in SHORT])
def test_fault_breaks_no_law(stage: Stage, name: str, act: Act) -> None:
    outcome = perform(stage, name, act)
    assert not outcome.broken, outcome


def torques(efforts: list[list[float]], pause: float = 0.002) -> Torques:
    """Return torques of successive ticks."""
    count = np.arange(len(efforts), dtype=np.float64)
    position = np.tile(GOAL, (len(efforts), 1))
    return Torques(
        np.multiply(pause, count),
        position,
        np.array(efforts, dtype=np.float64),
        0.0,
    )


@pytest.mark.parametrize(
    ('efforts', 'pause', 'says'),
    [
        ([[0.0, 0.0], [1.0, np.nan]], 0.002, 'finite'),
        ([[0.0, 0.0], [LIMITS[0] + 0.1, 0.0]], 0.002, 'within'),
        ([[0.0, 0.0], [0.0, 4.1]], 0.002, 'per tick'),
        ([[0.0, 0.0], [0.0, 0.0]], 1.5, 'a pause of 1.50 s'),
        (np.zeros((0, 2)).tolist(), 0.002, 'got none'),
    ],
)
def test_broken_laws_are_seen(efforts: list[list[float]], pause: float, says: str) -> None:
    outcome = Outcome('fault', 'something')
    judge_torques(outcome, torques(efforts, pause))
    assert any(says in law for law in outcome.broken)
    assert 'BROKEN' in markdown([outcome])


def test_lawful_torque_breaks_none() -> None:
    outcome = Outcome('fault', 'something')
    judge_torques(outcome, torques([[0.0, 0.0], [4.0, -4.0], [2.0, 0.0]]))
    assert not outcome.broken
    assert POSTURE != GOAL
