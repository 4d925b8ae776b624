"""Many states in one call: one thread beside a Python loop over Pinocchio, two beside one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from denoc_ros.dynamics.batch import cores
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.studies.benchmarks.peers import Pinocchio, rigid_chain
from denoc_ros.studies.benchmarks.results import (
    AT_LEAST,
    AT_MOST,
    BenchCheck,
    BenchLine,
    Reach,
    relative_error,
)
from denoc_ros.studies.benchmarks.rigid import TOLERANCE
from denoc_ros.studies.benchmarks.timing import Effort, Subject, compare, ratio

JOINTS = 7
ROWS = 100_000
FEWER_ROWS = 2_000
REACH_ONE_THREAD = 0.5
REACH_TWO_THREADS = 1.7


@contextmanager
def on_cores(count: int) -> Iterator[None]:
    """Let this thread run on so many processors only: batches take as many threads."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def batch_lines(effort: Effort, quick: bool) -> Iterator[BenchLine]:
    """Yield inverse dynamics of many states of seven joints, on one thread and on two."""
    text = rigid_chain(JOINTS)
    robot, peer = load_robot(text), Pinocchio(text)
    rows = FEWER_ROWS if quick else ROWS
    q, qd, qdd = np.random.default_rng(1).uniform(-2.0, 2.0, (3, rows, JOINTS))
    rnea, model, data = peer.pin.rnea, peer.model, peer.data
    given = (q, qd, qdd)

    def loop() -> Any:
        return [rnea(model, data, *state) for state in zip(*given, strict=True)]

    def threads(count: int) -> Callable[[], Any]:
        def run() -> Any:
            with on_cores(count):
                return robot.inverse_dynamics(q, qd, qdd)

        return run

    expected = np.array(loop())
    whose = 'pin.rnea, row by row'
    one = BenchCheck(whose, relative_error(threads(1)(), expected), TOLERANCE)
    what, against = f'inverse_dynamics, batch ({rows}, {JOINTS}), per state', 'loop over pin.rnea'
    if one.good:
        ours, theirs = compare((Subject(threads(1), [()]), Subject(loop, [()])), effort)
        yield BenchLine(
            'batch', f'{what}, one thread', against, one, value=ratio(ours, theirs),
            reach=Reach(AT_MOST, REACH_ONE_THREAD),
            ours=ours.scaled(1 / rows), peer=theirs.scaled(1 / rows),
        )  # fmt: skip
    else:
        yield BenchLine('batch', what, against, one)
    if cores() < 2:
        return
    two = BenchCheck(whose, relative_error(threads(2)(), expected), TOLERANCE)
    what = f'{what}, one thread over two'
    if not two.good:
        yield BenchLine('batch', what, 'one thread', two)
        return
    pair, single = compare((Subject(threads(2), [()]), Subject(threads(1), [()])), effort)
    yield BenchLine(
        'batch', what, 'one thread', two, value=ratio(single, pair),
        reach=Reach(AT_LEAST, REACH_TWO_THREADS),
        ours=pair.scaled(1 / rows), peer=single.scaled(1 / rows),
        note='holds only where two processors are free',
    )  # fmt: skip
