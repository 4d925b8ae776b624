"""What elastic joints cost: `python test/bench/elastic_joints.py` on a machine at rest.

Prints the time of inverse and forward dynamics of a UR10 with six springs over that of the same
robot without them, both with the rotors' armature; least times of many, in processor time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from denoc_ros.dynamics.robot import Robot, load_robot

FILE = Path(__file__).resolve().parents[2] / 'config' / 'robots' / 'ur10.urdf'
CALLS, REPEATS = 10_000, 20


def geared(springs: bool) -> Robot:
    """Return the robot with rotors, and springs before its links or not."""
    text = FILE.read_text(encoding='utf-8')
    block = ''.join(
        f'<actuator joint="{name}" armature="0.5"/>'
        + (f'<spring joint="{name}" stiffness="2e4" damping="5"/>' if springs else '')
        for name in load_robot(FILE).joint_names
    )
    return load_robot(text.replace('</robot>', f'<flexibility>{block}</flexibility></robot>'))


def least_ns(call: Callable[[], object]) -> float:
    """Return the least time of a call [ns]."""
    times = []
    for _ in range(REPEATS):
        begin = time.process_time_ns()
        for _ in range(CALLS):
            call()
        times.append((time.process_time_ns() - begin) / CALLS)
    return min(times)


def measure(robot: Robot, verb: str) -> float:
    """Return the least time of a verb [ns]."""
    q, qd, last = np.random.default_rng(0).uniform(-1.0, 1.0, (3, robot.n))
    out = np.empty(robot.n)
    call = getattr(robot, verb)
    return least_ns(lambda: call(q, qd, last, out=out))


def main() -> None:
    """Print both times and their ratio."""
    robots = geared(False), geared(True)
    for verb in ('inverse_dynamics', 'forward_dynamics'):
        rigid, elastic = (measure(robot, verb) for robot in robots)
        print(f'{verb}: {rigid:.0f} ns, with springs {elastic:.0f} ns, {elastic / rigid:.2f} x')


if __name__ == '__main__':
    main()
