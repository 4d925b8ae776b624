"""A simulated run of flexible links as a bag, for those who read it back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.simulation.simulate import Run, simulate
from denoc_ros.simulation.simulated_bag import write_run

GRAVITY = (0.0, -9.81, 0.0)
PERIOD = 0.004


Law = Callable[[float], tuple[float, float, float]]


@dataclass(frozen=True)
class SimulatedBag:
    """Two flexible links whose joints move as sines, sampled at 250 Hz."""

    path: Path
    robot: Robot
    run: Run


def swing(amplitude: float, rate: float) -> Law:
    def at(t: float) -> tuple[float, float, float]:
        angle = rate * t
        return (
            amplitude * (1.0 - np.cos(angle)),
            amplitude * rate * np.sin(angle),
            amplitude * rate**2 * np.cos(angle),
        )

    return at


def make_simulated_bag(repository: Path, folder: Path) -> SimulatedBag:
    robot = load_robot(repository / 'config/robots/two_link_ff.urdf', gravity=GRAVITY)
    robot = robot.with_overrides(
        {f'beam.link_{k}.y.damping_ratio': 0.02 for k in (1, 2)}
        | {'joint.joint_1.damping': 0.5, 'joint.joint_2.friction': 0.3}
    )
    motion = {'joint_1': swing(0.4, 2.0), 'joint_2': swing(0.3, 3.1)}
    start = robot.static_deflection(np.zeros(2))
    t = PERIOD * np.arange(500, dtype=np.float64)
    run = simulate(robot, start, np.zeros(robot.n), t, prescribed=motion, rtol=1e-6, atol=1e-8)
    path = folder / 'run.mcap'
    write_run(run, robot, path, robot.tree.source)
    return SimulatedBag(path, robot, run)


def make_mechanism_bag(repository: Path, folder: Path, links: str) -> SimulatedBag:
    """Write a five-bar mechanism, its joints 1 and 3 driven, the others passive."""
    robot = load_robot(repository / f'config/robots/five_bar_{links}.urdf', gravity=GRAVITY)
    posture = np.zeros(robot.n)
    posture[robot.joint_indices] = np.radians([108.0, -72.0, 72.0, 72.0])
    first, third = robot.joint_indices[[0, 2]]

    def around(place: int, law: Law) -> Law:
        start = float(posture[place])
        return lambda t: (start + law(t)[0], *law(t)[1:])

    motion = {
        'joint_1': around(first, swing(-0.3, 3.0)),
        'joint_3': around(third, swing(-0.1, 2.0)),
    }
    start = robot.assemble(posture, fixed=list(motion))
    t = PERIOD * np.arange(300, dtype=np.float64)
    run = simulate(robot, start, np.zeros(robot.n), t, prescribed=motion, rtol=1e-6, atol=1e-8)
    path = folder / f'{links}.mcap'
    write_run(run, robot, path, robot.tree.source)
    return SimulatedBag(path, robot, run)
