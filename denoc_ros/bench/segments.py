"""What a link of segments costs beside the same link as one beam."""

from __future__ import annotations

from collections.abc import Iterator

from denoc_ros.bench.chains import flexible_chain
from denoc_ros.bench.growth import MODES, STATES, check_forward, check_inverse
from denoc_ros.bench.results import AT_MOST, BenchLine, Reach
from denoc_ros.bench.rigid import random_states
from denoc_ros.bench.timing import Effort, Subject, compare, ratio
from denoc_ros.dynamics.robot import Robot, load_robot

SEGMENTS = 8
BEAM = '<beam link="link_1"'


def link_of(segments: int) -> Robot:
    """Return a link on a joint, two modes per plane and segment."""
    text = flexible_chain(1, *MODES)
    return load_robot(text.replace(BEAM, f'{BEAM} segments="{segments}"'))


def segment_lines(effort: Effort) -> Iterator[BenchLine]:
    """Yield inverse and forward dynamics of a link of segments over those of one beam."""
    subjects = []
    for segments in (SEGMENTS, 1):
        robot = link_of(segments)
        states = random_states(robot, count=STATES)
        driven = [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]
        checks = check_inverse(robot, states), check_forward(robot, driven)
        verbs = Subject(robot.inverse_dynamics, states), Subject(robot.forward_dynamics, driven)
        subjects.append(list(zip(verbs, checks, strict=True)))
    for name, divided, whole in zip(
        ('inverse_dynamics', 'forward_dynamics'), *subjects, strict=True
    ):
        worst = max(divided[1], whole[1], key=lambda each: each.error / each.tolerance)
        line = BenchLine('growth', f'{name}, a link of {SEGMENTS} segments', 'one beam', worst)
        if not worst.good:
            yield line
            continue
        ours, theirs = compare((divided[0], whole[0]), effort)
        yield BenchLine(
            line.group, line.what, line.against, worst, value=ratio(ours, theirs),
            reach=Reach(AT_MOST, float(SEGMENTS)), ours=ours, peer=theirs,
        )  # fmt: skip
