"""Mechanisms with loops: beside their own open tree, and beside Pinocchio's constraints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import scipy.linalg

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.studies.benchmarks.peers import Pinocchio
from denoc_ros.studies.benchmarks.results import AT_MOST, BenchCheck, BenchLine, Reach
from denoc_ros.studies.benchmarks.rigid import STATES, State, check, random_states
from denoc_ros.studies.benchmarks.timing import Effort, Subject, compare, ratio
from denoc_ros.types import Array

FLEXIBLE = 'five_bar_ffff'
RIGID = ('four_bar_rrr', 'five_bar_rrrr')
REACH_TREE = 3.0
REDUNDANT = 1e-8  # of the greatest singular value: rows that say nothing new
TOLERANCE = 1e-9  # two solutions of a mechanism that is far from singular


def loop_lines(robots: Path, effort: Effort) -> Iterator[BenchLine]:
    """Yield constrained forward dynamics of the book's mechanisms.

    Parameters
    ----------
    robots : Path
        The folder of their descriptions.
    effort : Effort
    """
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
    checked = check(_accelerations(robot, states), expected, 'dense null space', TOLERANCE)
    subjects = [
        Subject(robot.constrained_forward_dynamics, states),
        Subject(robot.forward_dynamics, states),
    ]
    what = f'constrained_forward_dynamics, {robot.tree.name} FFFF, {robot.n} coordinates'
    return _line(what, 'forward_dynamics of its open tree', checked, subjects, REACH_TREE, effort)


def _beside_pinocchio(text: str, effort: Effort) -> BenchLine:
    """Return the constrained forward dynamics of a rigid mechanism beside Pinocchio's."""
    robot, peer = load_robot(text), Pinocchio(text)
    states = closed_states(robot)
    theirs = peer.constrained_dynamics(states, robot)
    checked = check(
        _accelerations(robot, states),
        [np.array(theirs.call(*arguments)) for arguments in theirs.states],
        'pin.constraintDynamics', TOLERANCE,
    )  # fmt: skip
    subjects = [Subject(robot.constrained_forward_dynamics, states), theirs]
    what = f'constrained_forward_dynamics, {robot.tree.name}, rigid n = {robot.n}'
    return _line(what, 'pin.constraintDynamics', checked, subjects, None, effort)


def _line(
    what: str,
    against: str,
    checked: BenchCheck,
    subjects: Sequence[Subject],
    reach: float | None,
    effort: Effort,
) -> BenchLine:
    if not checked.good:
        return BenchLine('loops', what, against, checked)
    ours, peer = compare(subjects, effort)
    return BenchLine(
        'loops', what, against, checked, value=ratio(ours, peer),
        reach=None if reach is None else Reach(AT_MOST, reach), ours=ours, peer=peer,
    )  # fmt: skip
