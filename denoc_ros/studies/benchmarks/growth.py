"""How the cost grows with the number of links, and where dense Cholesky falls behind."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.studies.benchmarks.peers import Dense, flexible_chain, rigid_chain
from denoc_ros.studies.benchmarks.results import (
    AT_LEAST,
    AT_MOST,
    BenchCheck,
    BenchLine,
    Reach,
    compared,
)
from denoc_ros.studies.benchmarks.rigid import TOLERANCE, State, check, random_states, results
from denoc_ros.studies.benchmarks.timing import Effort, Spread, Subject, Times, compare, ratio

LINKS = (8, 16, 32, 64, 128)
FEWER_LINKS = (8, 16, 32)  # where only results matter
MODES = (2, 2, 0)  # two per plane
REACH_SLOPE = 1.05
CROSSING_LINKS = (1, 2, 3, 4, 6, 8, 12, 16, 32, 64)
FEWER_CROSSING_LINKS = (1, 2, 8)
REACH_FACTOR = 10.0
STATES = 4


def slope(sizes: Sequence[int], times: Sequence[Times]) -> Spread:
    """Return the least-squares slope of log time by log size, block by block."""
    medians = np.log([each.blocks for each in times])
    return Spread.of(np.polyfit(np.log(sizes), medians, 1)[0])


def sloped(
    line: BenchLine,
    sizes: Sequence[int],
    subjects: Sequence[Subject],
    reach: float,
    effort: Effort,
) -> BenchLine:
    """Return a line with the slope of its subjects' times by size, if their results are good."""
    if not line.check.good:
        return line
    times = compare(subjects, effort)
    each = ', '.join(f'{n}: {1e6 * t.median:.1f}' for n, t in zip(sizes, times, strict=True))
    return replace(
        line,
        value=slope(sizes, times),
        reach=Reach(AT_MOST, reach),
        ours=times[-1],
        note=f'us at n links: {each}',
    )


def crossing(sizes: Sequence[int], factors: Sequence[float]) -> float:
    """Return the size from which on the factor stays above 1, between two sizes by logarithms.

    The first size where it always is, inf where it is not at the last.
    """
    logs, x = np.log(factors), np.log(sizes)
    below = np.flatnonzero(logs < 0.0)
    if len(below) == 0:
        return float(sizes[0])
    k = int(below[-1])
    if k + 1 == len(sizes):
        return float('inf')
    share = logs[k] / (logs[k] - logs[k + 1])
    return float(np.exp(x[k] + share * (x[k + 1] - x[k])))


def growth_lines(effort: Effort, quick: bool) -> Iterator[BenchLine]:
    """Yield the slopes of inverse and forward dynamics of all-flexible chains."""
    sizes = FEWER_LINKS if quick else LINKS
    inverse, forward, errors = [], [], []
    for n in sizes:
        robot = load_robot(flexible_chain(n, *MODES))
        states, driven = _states(robot)
        inverse.append(Subject(robot.inverse_dynamics, states))
        forward.append(Subject(robot.forward_dynamics, driven))
        errors.append(check_forward(robot, driven))
        errors.append(check_inverse(robot, states))
    checked = max(errors, key=lambda each: each.error / each.tolerance)
    for name, subjects in (('inverse_dynamics', inverse), ('forward_dynamics', forward)):
        what = f'{name}, all-flexible chains n = {sizes[0]} … {sizes[-1]}, two modes per plane'
        line = BenchLine('growth', what, 'own slope, log-log', checked, 'slope')
        yield sloped(line, sizes, subjects, REACH_SLOPE, effort)


def dense_lines(effort: Effort, quick: bool) -> Iterator[BenchLine]:
    """Yield the recursion beside dense Cholesky: the factor at 64 links and the crossing point."""
    sizes = FEWER_CROSSING_LINKS if quick else CROSSING_LINKS
    for name, text in (
        ('all-flexible chain, two modes per plane', lambda n: flexible_chain(n, *MODES)),
        ('rigid chain', rigid_chain),
    ):
        pairs, errors = [], []
        for n in sizes:
            robot = load_robot(text(n))
            driven = _states(robot)[1]
            errors.append(check_forward(robot, driven))
            pairs.append((robot, driven))
        checked = max(errors, key=lambda each: each.error / each.tolerance)
        reach = REACH_FACTOR if name.startswith('all-flexible') else None
        yield from _factors(name, sizes, pairs, checked, reach, effort)


def _factors(
    name: str,
    sizes: Sequence[int],
    pairs: Sequence[tuple[Robot, list[State]]],
    checked: BenchCheck,
    reach: float | None,
    effort: Effort,
) -> Iterator[BenchLine]:
    what = f'dense Cholesky over recursion, {name}'
    if not checked.good:
        yield BenchLine('dense', what, 'dense Cholesky', checked)
        return
    factors = []
    for robot, driven in pairs:
        ours = Subject(robot.forward_dynamics, driven)
        dense = Subject(Dense(robot).forward_dynamics, driven)
        recursion, cholesky = compare((ours, dense), effort)
        factors.append(ratio(cholesky, recursion))
    each = ', '.join(f'{n}: {f.value:.2f}' for n, f in zip(sizes, factors, strict=True))
    yield BenchLine(
        'dense', f'{what}, {sizes[-1]} links', 'dense Cholesky', checked, 'ratio', factors[-1],
        None if reach is None else Reach(AT_LEAST, reach), recursion, cholesky,
        note=f'factor at n links: {each}',
    )  # fmt: skip
    point = [crossing(sizes, [getattr(f, part) for f in factors]) for part in ('high', 'low')]
    middle = crossing(sizes, [f.value for f in factors])
    yield BenchLine(
        'dense', f'crossing point, {name}', 'dense Cholesky', checked, 'links',
        Spread(middle, point[0], point[1]),
        note=f'{pairs[0][0].n} coordinate(s) per link; public calls on both sides',
    )  # fmt: skip


def _states(robot: Robot) -> tuple[list[State], list[State]]:
    """Return states (q, qd, qdd) and the same with the forces that go with them."""
    states = random_states(robot, count=STATES)
    return states, [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]


def check_forward(robot: Robot, driven: Sequence[State]) -> BenchCheck:
    """Compare tau with I qdd + h: the solutions of long chains are too ill-conditioned."""
    errors = []
    for q, qd, tau in driven:
        force = robot.inertia_matrix(q) @ robot.forward_dynamics(q, qd, tau)
        bias = robot.bias_forces(q, qd)
        errors.append(float(np.abs(force + bias - tau).max() / np.abs((bias, tau)).max()))
    return BenchCheck('dense I qdd + h = tau', max(errors), TOLERANCE)


def check_inverse(robot: Robot, states: Sequence[State]) -> BenchCheck:
    """Compare with the dense I qdd + h."""
    ours = results(Subject(robot.inverse_dynamics, states))
    dense = [robot.inertia_matrix(q) @ qdd + robot.bias_forces(q, qd) for q, qd, qdd in states]
    return check(ours, dense, 'I qdd + h', TOLERANCE)


SEGMENTS = 8
BEAM = '<beam link="link_1"'


def link_of(segments: int) -> Robot:
    """Return a link on a joint, two modes per plane and segment."""
    text = flexible_chain(1, *MODES)
    return load_robot(text.replace(BEAM, f'{BEAM} segments="{segments}"'))


def segment_lines(effort: Effort) -> Iterator[BenchLine]:
    """Yield inverse and forward dynamics of a link of segments over those of one beam."""
    divided, whole = link_of(SEGMENTS), link_of(1)
    robots = (
        (divided, random_states(divided, count=STATES)),
        (whole, random_states(whole, count=STATES)),
    )
    names = f'a link of {SEGMENTS} segments', 'one beam'
    yield from dynamics_lines('growth', names, robots, float(SEGMENTS), effort)


REACH = 1.4
ARMATURE = 'armature="0.5"'  # kg m^2, of each rotor
SPRING = 'stiffness="2e4" damping="5"'


def geared(file: Path, springs: bool) -> Robot:
    """Return a rigid robot with rotors, and with springs at all joints or without."""
    block = ''.join(
        f'<actuator joint="{name}" {ARMATURE}/>'
        + (f'<spring joint="{name}" {SPRING}/>' if springs else '')
        for name in load_robot(file).joint_names
    )
    text = file.read_text(encoding='utf-8')
    return load_robot(text.replace('</robot>', f'<flexibility>{block}</flexibility></robot>'))


def spring_lines(file: Path, effort: Effort) -> Iterator[BenchLine]:
    """Yield inverse and forward dynamics with elastic joints over those with rigid ones."""
    elastic, rigid = geared(file, springs=True), geared(file, springs=False)
    robots = (elastic, random_states(elastic)), (rigid, random_states(rigid))
    names = f'{file.stem} with springs', 'rigid joints'
    yield from dynamics_lines('springs', names, robots, REACH, effort)


VERBS = 'inverse_dynamics', 'forward_dynamics'
States = tuple[Robot, Sequence[State]]


def dynamics_lines(
    group: str, names: tuple[str, str], robots: tuple[States, States], reach: float, effort: Effort
) -> Iterator[BenchLine]:
    """Yield inverse and forward dynamics of the first robot over those of the second.

    Parameters
    ----------
    robots : two of (Robot, sequence of state)
        The verbs are called at the states in turn.
    """
    subjects = []
    for robot, states in robots:
        driven = [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]
        checks = check_inverse(robot, states), check_forward(robot, driven)
        verbs = Subject(robot.inverse_dynamics, states), Subject(robot.forward_dynamics, driven)
        subjects.append(list(zip(verbs, checks, strict=True)))
    for verb, first, second in zip(VERBS, *subjects, strict=True):
        worst = max(first[1], second[1], key=lambda each: each.error / each.tolerance)
        line = BenchLine(group, f'{verb}, {names[0]}', names[1], worst)
        yield compared(line, (first[0], second[0]), effort, reach)
