"""Rigid chains and the SSRMS beside Pinocchio."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.studies.benchmarks.peers import Dense, Pinocchio, rigid_chain
from denoc_ros.studies.benchmarks.results import (
    AT_MOST,
    BenchCheck,
    BenchLine,
    Reach,
    relative_error,
)
from denoc_ros.studies.benchmarks.timing import Effort, Subject, compare, ratio
from denoc_ros.types import Array

State = tuple[Array, ...]

SIZES = (6, 30, 100)
REACH_INVERSE = (1.0, 0.5, 0.35)
REACH_FORWARD = (1.0, 0.6, 0.45)
REACH_INERTIA = (1.0, 0.8, 0.8)
REACH_SSRMS_FORWARD = 1.0
REACH_SSRMS_INVERSE = 1.2
STATES = 16  # in turn, so that no branch is learnt by heart
TOLERANCE = 1e-10  # two recursions over up to 100 links differ by their rounding
DEFLECTION = 0.02  # m and rad, of the states' amplitudes


def random_states(robot: Robot, count: int = STATES) -> list[State]:
    """Return states (q, qd, qdd or tau): joints at random, amplitudes and their rates small."""
    rng = np.random.default_rng(1)
    scale = np.full(robot.n, DEFLECTION)
    scale[robot.joint_indices] = 1.0
    return [
        (
            scale * rng.uniform(-2.0, 2.0, robot.n),
            scale * rng.uniform(-1.0, 1.0, robot.n),
            scale * rng.uniform(-5.0, 5.0, robot.n),
        )
        for _ in range(count)
    ]


def results(subject: Subject) -> list[Array]:
    """Results of a subject's calls, one after another."""
    return [np.array(subject.call(*arguments)) for arguments in subject.states]


def conditioned(robot: Robot, states: Sequence[State]) -> float:
    """Return the tolerance of a solution: that of rounding times the inertia's condition."""
    condition = max(float(np.linalg.cond(robot.inertia_matrix(state[0]))) for state in states)
    return max(TOLERANCE, 4e-16 * condition)


def check(
    ours: Sequence[ArrayLike], theirs: Sequence[ArrayLike], whose: str, limit: float
) -> BenchCheck:
    """Compare results one by one."""
    errors = [relative_error(a, b) for a, b in zip(ours, theirs, strict=True)]
    return BenchCheck(whose, max(errors), limit)


def beside(
    group: str,
    what: str,
    against: str,
    subjects: Sequence[Subject],
    checked: BenchCheck,
    reach: float,
    effort: Effort,
) -> Iterator[BenchLine]:
    """Time ours, ours unchecked, and the peer; yield a line each for the first two.

    Parameters
    ----------
    subjects : (ours, ours without checks, peer)
    reach : float
        Largest ratio of the first line; the second has none.
    """
    if not checked.good:
        yield BenchLine(group, what, against, checked)
        return
    ours, unchecked, peer = compare(subjects, effort)
    for name, times, limit in (
        (what, ours, Reach(AT_MOST, reach)),
        (f'{what}, check=False', unchecked, None),
    ):
        yield BenchLine(
            group, name, against, checked,
            value=ratio(times, peer), reach=limit, ours=times, peer=peer,
        )  # fmt: skip


def unchecked(states: Sequence[State]) -> list[tuple[Any, ...]]:
    """Return arguments with `check=False` at the end, by position: (…, wrenches, out, check)."""
    return [(*state, None, None, False) for state in states]


def inverse_lines(effort: Effort) -> Iterator[BenchLine]:
    """Yield `inverse_dynamics` of rigid chains beside `pin.rnea`."""
    for n, reach in zip(SIZES, REACH_INVERSE, strict=True):
        robot, peer, states = _chain(n)
        theirs = peer.inverse_dynamics(states)
        yield from _pair('inverse', n, robot.inverse_dynamics, states, theirs, reach, effort)


def forward_lines(effort: Effort) -> Iterator[BenchLine]:
    """Yield `forward_dynamics` of rigid chains beside `pin.aba`."""
    for n, reach in zip(SIZES, REACH_FORWARD, strict=True):
        robot, peer, states = _chain(n)
        # forces that go with moderate accelerations: arbitrary ones make a long chain whip
        states = [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]
        theirs = peer.forward_dynamics(states)
        limit = conditioned(robot, states)
        yield from _pair(
            'forward', n, robot.forward_dynamics, states, theirs, reach, effort, limit
        )


def inertia_lines(effort: Effort) -> Iterator[BenchLine]:
    """Yield `inertia_matrix` of rigid chains beside `pin.crba`."""
    for n, reach in zip(SIZES, REACH_INERTIA, strict=True):
        robot, peer, states = _chain(n)
        ours = Subject(robot.inertia_matrix, [state[:1] for state in states])
        bare = Subject(robot.inertia_matrix, [(state[0], None, False) for state in states])
        theirs = peer.inertia_matrix(states)
        upper = [np.triu(matrix) for matrix in results(theirs)]
        full = [matrix + np.triu(matrix, 1).T for matrix in upper]
        checked = check(results(ours), full, 'pin.crba', TOLERANCE)
        yield from beside(
            'inertia', f'inertia_matrix, rigid n = {n}', 'pin.crba', (ours, bare, theirs),
            checked, reach, effort,
        )  # fmt: skip


def ssrms_lines(file: Path, effort: Effort) -> Iterator[BenchLine]:
    """Yield the SSRMS (14 coordinates, 8 elastic) beside Pinocchio's rigid chain of 14 joints."""
    robot = load_robot(file)
    states = random_states(robot)
    chain, peer, rigid = _chain(robot.n)
    matrices = [robot.inertia_matrix(state[0]) for state in states]
    biases = [robot.bias_forces(q, qd) for q, qd, _ in states]
    expected = [m @ qdd + h for m, h, (_, _, qdd) in zip(matrices, biases, states, strict=True)]
    ours = Subject(robot.inverse_dynamics, states)
    size = f'SSRMS, {robot.n} coordinates'
    yield from beside(
        'ssrms', f'inverse_dynamics, {size}', f'pin.rnea, rigid n = {robot.n}',
        (ours, Subject(robot.inverse_dynamics, unchecked(states)), peer.inverse_dynamics(rigid)),
        check(results(ours), expected, 'I qdd + h', TOLERANCE), REACH_SSRMS_INVERSE, effort,
    )  # fmt: skip
    driven = [(q, qd, tau) for (q, qd, _), tau in zip(states, results(ours), strict=True)]
    rigid = [(q, qd, chain.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in rigid]
    ours = Subject(robot.forward_dynamics, driven)
    expected = results(Subject(Dense(robot).forward_dynamics, driven))
    yield from beside(
        'ssrms', f'forward_dynamics, {size}', f'pin.aba, rigid n = {robot.n}',
        (ours, Subject(robot.forward_dynamics, unchecked(driven)), peer.forward_dynamics(rigid)),
        check(results(ours), expected, 'dense Cholesky', conditioned(robot, states)),
        REACH_SSRMS_FORWARD, effort,
    )  # fmt: skip


def _chain(n: int) -> tuple[Robot, Pinocchio, list[State]]:
    text = rigid_chain(n)
    robot = load_robot(text)
    return robot, Pinocchio(text), random_states(robot)


def _pair(
    group: str,
    n: int,
    verb: Callable[..., Array],
    states: Sequence[State],
    theirs: Subject,
    reach: float,
    effort: Effort,
    limit: float = TOLERANCE,
) -> Iterator[BenchLine]:
    ours, against = Subject(verb, states), f'pin.{theirs.call.__name__}'
    checked = check(results(ours), results(theirs), against, limit)
    subjects = (ours, Subject(verb, unchecked(states)), theirs)
    what = f'{verb.__name__}, rigid n = {n}'
    yield from beside(group, what, against, subjects, checked, reach, effort)
