"""How the cost grows with the number of links, and where dense Cholesky falls behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from book.benchmarks.peers import Dense, flexible_chain, rigid_chain
from book.benchmarks.results import BenchCheck, BenchLine, Reach, compared
from book.benchmarks.rigid import (
    TOLERANCE,
    State,
    check,
    driven,
    random_states,
    results,
)
from book.benchmarks.timing import Effort, Spread, Subject, Times, compare, ratio

from denoc_ros.dynamics.robot import Robot, load_robot

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


Made = tuple[tuple[Subject, ...], list[BenchCheck]]  # verbs of a chain, and their checks


def slope_lines(
    group: str,
    sizes: Sequence[int],
    made: Callable[[int], Made],
    reach: float,
    effort: Effort,
    more: str = '',
) -> Iterator[BenchLine]:
    """Yield the slope of each verb's times by the number of links, if all results are good.

    Parameters
    ----------
    more : str
        What is said of the chains behind their number of links.
    """
    chains = [made(n) for n in sizes]
    checked = worst([check for _, checks in chains for check in checks])
    for subjects in zip(*(verbs for verbs, _ in chains), strict=True):
        what = f'{subjects[0].call.__name__}, all-flexible chains n = {sizes[0]} … {sizes[-1]}'
        line = BenchLine(group, what + more, 'own slope, log-log', checked, 'slope')
        if not checked.good:
            yield line
            continue
        times = compare(subjects, effort)
        each = ', '.join(f'{n}: {1e6 * t.median:.1f}' for n, t in zip(sizes, times, strict=True))
        value, note = slope(sizes, times), f'us at n links: {each}'
        limit = Reach(reach)
        yield replace(line, value=value, reach=limit, ours=times[-1], note=note)


def worst(checks: Sequence[BenchCheck]) -> BenchCheck:
    """Return the check that is nearest to its tolerance, or farthest beyond."""
    return max(checks, key=lambda each: each.error / each.tolerance)


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
    sizes, more = FEWER_LINKS if quick else LINKS, ', two modes per plane'
    yield from slope_lines('growth', sizes, _chain, REACH_SLOPE, effort, more)


def _chain(n: int) -> Made:
    robot = load_robot(flexible_chain(n, *MODES))
    return _verbs(robot, random_states(robot, count=STATES))


def _verbs(robot: Robot, states: Sequence[State]) -> Made:
    """Return inverse and forward dynamics at states."""
    pushed = driven(robot, states)
    verbs = Subject(robot.inverse_dynamics, states), Subject(robot.forward_dynamics, pushed)
    return verbs, [check_inverse(robot, states), check_forward(robot, pushed)]


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
            pushed = driven(robot, random_states(robot, count=STATES))
            errors.append(check_forward(robot, pushed))
            pairs.append((robot, pushed))
        reach = REACH_FACTOR if name.startswith('all-flexible') else None
        yield from _factors(name, sizes, pairs, worst(errors), reach, effort)


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
    for robot, pushed in pairs:
        ours = Subject(robot.forward_dynamics, pushed)
        dense = Subject(Dense(robot).forward_dynamics, pushed)
        recursion, cholesky = compare((ours, dense), effort)
        factors.append(ratio(cholesky, recursion))
    each = ', '.join(f'{n}: {f.value:.2f}' for n, f in zip(sizes, factors, strict=True))
    yield BenchLine(
        'dense', f'{what}, {sizes[-1]} links', 'dense Cholesky', checked, 'ratio', factors[-1],
        None if reach is None else Reach(reach, '>='), recursion, cholesky,
        note=f'factor at n links: {each}',
    )  # fmt: skip
    point = [crossing(sizes, [getattr(f, part) for f in factors]) for part in ('high', 'low')]
    middle = crossing(sizes, [f.value for f in factors])
    yield BenchLine(
        'dense', f'crossing point, {name}', 'dense Cholesky', checked, 'links',
        Spread(middle, point[0], point[1]),
        note=f'{pairs[0][0].n} coordinate(s) per link; public calls on both sides',
    )  # fmt: skip


def check_forward(robot: Robot, pushed: Sequence[State]) -> BenchCheck:
    """Compare tau with I qdd + h: the solutions of long chains are too ill-conditioned."""
    errors = []
    for q, qd, tau in pushed:
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
    (ours, first), (theirs, second) = (_verbs(*each) for each in robots)
    for k, verb in enumerate(ours):
        checked = worst([first[k], second[k]])
        line = BenchLine(group, f'{verb.call.__name__}, {names[0]}', names[1], checked)
        yield compared(line, (verb, theirs[k]), effort, reach)
