"""What elastic joints cost beside the same robot with rigid ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from denoc_ros.bench.growth import check_forward, check_inverse
from denoc_ros.bench.results import AT_MOST, BenchLine, Reach
from denoc_ros.bench.rigid import random_states
from denoc_ros.bench.timing import Effort, Subject, compare, ratio
from denoc_ros.dynamics.robot import Robot, load_robot

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
    subjects = []
    for springs in (True, False):
        robot = geared(file, springs)
        states = random_states(robot)
        driven = [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]
        checks = check_inverse(robot, states), check_forward(robot, driven)
        verbs = Subject(robot.inverse_dynamics, states), Subject(robot.forward_dynamics, driven)
        subjects.append(list(zip(verbs, checks, strict=True)))
    for name, elastic, rigid in zip(
        ('inverse_dynamics', 'forward_dynamics'), *subjects, strict=True
    ):
        worst = max(elastic[1], rigid[1], key=lambda each: each.error / each.tolerance)
        line = BenchLine('springs', f'{name}, {file.stem} with springs', 'rigid joints', worst)
        if not worst.good:
            yield line
            continue
        ours, theirs = compare((elastic[0], rigid[0]), effort)
        yield BenchLine(
            line.group, line.what, line.against, worst, value=ratio(ours, theirs),
            reach=Reach(AT_MOST, REACH), ours=ours, peer=theirs,
        )  # fmt: skip
