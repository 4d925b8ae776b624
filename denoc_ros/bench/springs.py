"""Cost of elastic joints beside the same robot with rigid ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from denoc_ros.bench.pairs import dynamics_lines
from denoc_ros.bench.results import BenchLine
from denoc_ros.bench.rigid import random_states
from denoc_ros.bench.timing import Effort
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
    elastic, rigid = geared(file, springs=True), geared(file, springs=False)
    robots = (elastic, random_states(elastic)), (rigid, random_states(rigid))
    names = f'{file.stem} with springs', 'rigid joints'
    yield from dynamics_lines('springs', names, robots, REACH, effort)
