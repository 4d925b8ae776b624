"""Rigid chains, the SSRMS and mechanisms beside Pinocchio, or their own open tree."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
from book.benchmarks.peers import Dense, Pinocchio, rigid_chain
from book.benchmarks.results import (
    BenchCheck,
    BenchLine,
    Reach,
    compared,
    relative_error,
)
from book.benchmarks.timing import Effort, Subject, compare, ratio
from numpy.typing import ArrayLike

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.state_rows import cores
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


def driven(robot: Robot, states: Sequence[State]) -> list[State]:
    """Return states with the forces that go with them in place of their accelerations."""
    return [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]


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
    reach : float
        Largest ratio of the first line; the second has none.
    """
    if not checked.good:
        yield BenchLine(group, what, against, checked)
        return
    ours, unchecked, peer = compare(subjects, effort)
    for name, times, limit in (
        (what, ours, Reach(reach)),
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
        yield from pair('inverse', robot.inverse_dynamics, states, theirs, reach, effort)


def forward_lines(effort: Effort) -> Iterator[BenchLine]:
    """Yield `forward_dynamics` of rigid chains beside `pin.aba`."""
    for n, reach in zip(SIZES, REACH_FORWARD, strict=True):
        robot, peer, states = _chain(n)
        # forces that go with moderate accelerations: arbitrary ones make a long chain whip
        states = driven(robot, states)
        theirs = peer.forward_dynamics(states)
        limit = conditioned(robot, states)
        yield from pair('forward', robot.forward_dynamics, states, theirs, reach, effort, limit)


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
    pushed, rigid = driven(robot, states), driven(chain, rigid)
    ours = Subject(robot.forward_dynamics, pushed)
    expected = results(Subject(Dense(robot).forward_dynamics, pushed))
    yield from beside(
        'ssrms', f'forward_dynamics, {size}', f'pin.aba, rigid n = {robot.n}',
        (ours, Subject(robot.forward_dynamics, unchecked(pushed)), peer.forward_dynamics(rigid)),
        check(results(ours), expected, 'dense Cholesky', conditioned(robot, states)),
        REACH_SSRMS_FORWARD, effort,
    )  # fmt: skip


def _chain(n: int) -> tuple[Robot, Pinocchio, list[State]]:
    text = rigid_chain(n)
    robot = load_robot(text)
    return robot, Pinocchio(text), random_states(robot)


def pair(
    group: str,
    verb: Callable[..., Any],
    states: Sequence[State],
    theirs: Subject,
    reach: float,
    effort: Effort,
    limit: float = TOLERANCE,
    whole: Callable[[Array], Array] = np.asarray,
) -> Iterator[BenchLine]:
    """Yield a verb of a rigid chain beside Pinocchio's, whose results `whole` completes."""
    ours, against = Subject(verb, states), f'pin.{theirs.call.__name__}'
    checked = check(results(ours), [whole(each) for each in results(theirs)], against, limit)
    subjects = (ours, Subject(verb, unchecked(states)), theirs)
    what = f'{verb.__name__}, rigid n = {len(states[0][0])}'
    yield from beside(group, what, against, subjects, checked, reach, effort)


# mechanisms with loops ---------------------------------------------------------------------------

FLEXIBLE = 'five_bar_ffff'
RIGID = ('four_bar_rrr', 'five_bar_rrrr')
REACH_TREE = 3.0
REDUNDANT = 1e-8  # of the greatest singular value: rows that say nothing new
LOOP_TOLERANCE = 1e-9  # two solutions of a mechanism that is far from singular


def loop_lines(robots: Path, effort: Effort) -> Iterator[BenchLine]:
    """Yield constrained forward dynamics of the book's mechanisms."""
    yield _beside_tree(load_robot(robots / f'{FLEXIBLE}.urdf'), effort)
    for name in RIGID:
        yield _beside_pinocchio((robots / f'{name}.urdf').read_text(), effort)


def closed_states(robot: Robot) -> list[State]:
    """Return closed states (q, qd, tau) with small amplitudes."""
    states: list[State] = []
    for q, qd, qdd in random_states(robot, count=20 * STATES):
        q = robot.assemble(0.3 * q) if len(states) < STATES else q
        if len(states) < STATES and well_posed(robot, q):
            qd = robot.assemble_rates(q, qd)
            states.append((q, qd, robot.inverse_dynamics(q, qd, qdd)))
    return states


def well_posed(robot: Robot, q: Array) -> bool:
    """Say whether a configuration is far from singular ones."""
    values = np.linalg.svd(robot.closure_jacobian(q), compute_uv=False)
    kept = values[values > REDUNDANT * values.max()]
    return bool(kept.min() > 0.05 * kept.max())


def dense_solution(robot: Robot, q: Array, qd: Array, tau: Array) -> Array:
    """Return accelerations by the inertia matrix and a null space of the rows."""
    rows, bias = robot.closure_jacobian(q), robot.closure_bias(q, qd)
    inertia, force = robot.inertia_matrix(q), tau - robot.bias_forces(q, qd)
    start = np.linalg.lstsq(rows, -bias, rcond=REDUNDANT)[0]
    free = scipy.linalg.null_space(rows, rcond=REDUNDANT)
    inside = np.linalg.solve(free.T @ inertia @ free, free.T @ (force - inertia @ start))
    return np.asarray(start + free @ inside)


def _accelerations(robot: Robot, states: Sequence[State]) -> list[Array]:
    return [robot.constrained_forward_dynamics(q, qd, tau)[0] for q, qd, tau in states]


def _beside_tree(robot: Robot, effort: Effort) -> BenchLine:
    """Return the constrained forward dynamics of a mechanism beside that of its open tree."""
    states = closed_states(robot)
    expected = [dense_solution(robot, *state) for state in states]
    checked = check(_accelerations(robot, states), expected, 'dense null space', LOOP_TOLERANCE)
    subjects = [
        Subject(robot.constrained_forward_dynamics, states),
        Subject(robot.forward_dynamics, states),
    ]
    what = f'constrained_forward_dynamics, {robot.tree.name} FFFF, {robot.n} coordinates'
    line = BenchLine('loops', what, 'forward_dynamics of its open tree', checked)
    return compared(line, subjects, effort, REACH_TREE)


def _beside_pinocchio(text: str, effort: Effort) -> BenchLine:
    """Return the constrained forward dynamics of a rigid mechanism beside Pinocchio's."""
    robot, peer = load_robot(text), Pinocchio(text)
    states = closed_states(robot)
    theirs = peer.constrained_dynamics(states, robot)
    checked = check(
        _accelerations(robot, states),
        [np.array(theirs.call(*arguments)) for arguments in theirs.states],
        'pin.constraintDynamics', LOOP_TOLERANCE,
    )  # fmt: skip
    subjects = [Subject(robot.constrained_forward_dynamics, states), theirs]
    what = f'constrained_forward_dynamics, {robot.tree.name}, rigid n = {robot.n}'
    line = BenchLine('loops', what, 'pin.constraintDynamics', checked)
    return compared(line, subjects, effort)


# many states in one call -------------------------------------------------------------------------

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
            reach=Reach(REACH_ONE_THREAD),
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
        reach=Reach(REACH_TWO_THREADS, '>='),
        ours=pair.scaled(1 / rows), peer=single.scaled(1 / rows),
        note='holds only where two processors are free',
    )  # fmt: skip
