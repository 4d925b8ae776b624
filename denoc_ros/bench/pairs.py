"""The dynamics of a robot beside those of another: checked, timed in turns, as a ratio."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from denoc_ros.bench.growth import check_forward, check_inverse
from denoc_ros.bench.results import AT_MOST, BenchLine, Reach
from denoc_ros.bench.rigid import State
from denoc_ros.bench.timing import Effort, Subject, compare, ratio
from denoc_ros.dynamics.robot import Robot

VERBS = 'inverse_dynamics', 'forward_dynamics'
States = tuple[Robot, Sequence[State]]


def dynamics_lines(
    group: str, names: tuple[str, str], robots: tuple[States, States], reach: float, effort: Effort
) -> Iterator[BenchLine]:
    """Yield inverse and forward dynamics of the first robot over those of the second.

    Parameters
    ----------
    group : str
    names : (str, str)
        Of the two, as the line says them.
    robots : two of (Robot, sequence of state)
        The verbs are called at the states in turn.
    reach : float
        Largest ratio.
    effort : Effort
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
        if not worst.good:
            yield line
            continue
        ours, theirs = compare((first[0], second[0]), effort)
        yield BenchLine(
            line.group, line.what, line.against, worst, value=ratio(ours, theirs),
            reach=Reach(AT_MOST, reach), ours=ours, peer=theirs,
        )  # fmt: skip
