"""Results do not depend on what a process did before, bit for bit."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from denoc_ros.dynamics.linear.natural_modes import independent_joints, mechanism_modes
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

Verb = Callable[[Robot, Array, Array, Array], Any]
ROBOTS = {'ssrms': 'tool', 'five_bar_ffff': 'link_2'}
TIMEOUT = 550.0  # s, with kernels to compile on a loaded machine


def verbs(frame: str) -> dict[str, Verb]:
    """Return calls of the verbs at a closed state and a motion."""
    loads = {frame: (3.0, -2.0, 1.0, 0.1, 0.2, 0.3)}
    return {
        'inverse': lambda r, q, qd, x: r.inverse_dynamics(q, qd, x, loads),
        'forward': lambda r, q, qd, x: r.forward_dynamics(q, qd, x),
        'hybrid': lambda r, q, qd, x: r.hybrid_dynamics(q, qd, x[r.joint_indices]),
        'inertia': lambda r, q, qd, x: r.inertia_matrix(q),
        'energy': lambda r, q, qd, x: r.energy(q, qd),
        'momentum': lambda r, q, qd, x: r.momentum(q, qd),
        'pose': lambda r, q, qd, x: r.frame_pose(frame, q),
        'motion': lambda r, q, qd, x: r.frame_motion(frame, q, qd, x),
        'deflection': lambda r, q, qd, x: r.static_deflection(q[r.joint_indices], loads),
        'stiffness': lambda r, q, qd, x: r.natural_modes(q, held=True),
        'mechanism modes': lambda r, q, qd, x: mechanism_modes(r, q, independent_joints(r, q)),
        'linear model': lambda r, q, qd, x: vars(r.linearize(q, outputs=('joints',))).values(),
        'closure': lambda r, q, qd, x: r.closure_jacobian(q),
        'constrained': lambda r, q, qd, x: r.constrained_forward_dynamics(q, qd, x),
        'derivatives': lambda r, q, qd, x: r.inverse_dynamics_derivatives(q, qd, x, loads),
        'forward derivatives': lambda r, q, qd, x: r.forward_dynamics_derivatives(q, qd, x),
        'constrained derivatives': lambda r, q, qd, x: r.constrained_forward_dynamics_derivatives(
            q, qd, x
        ),
    }


def digest(found: Any) -> str:
    """Return a digest of all numbers of a result."""
    parts = [found] if isinstance(found, np.ndarray) else list(found)
    numbers = [np.asarray(part) for part in parts]
    return hashlib.sha256(b''.join(each.tobytes() for each in numbers)).hexdigest()


def call_all(path: str, frame: str, order: str) -> None:
    """Print a digest of each verb's result: called in order, from the last, or each alone.

    Alone, a verb is the first of a process that has the robot and nothing else: a fork.
    """
    robot = load_robot(path)
    rng = np.random.default_rng(7)
    q = robot.assemble(rng.uniform(-0.05, 0.05, robot.n))
    qd = robot.assemble_rates(q, rng.uniform(-0.1, 0.1, robot.n))
    x = rng.uniform(-1.0, 1.0, robot.n)
    for name, verb in list(verbs(frame).items())[:: -1 if order == 'backwards' else 1]:
        if order == 'alone' and (child := os.fork()):
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
            continue
        print(name, digest(verb(robot, q, qd, x)), flush=True)
        if order == 'alone':
            os._exit(0)


def digests(path: Path, frame: str) -> list[dict[str, str]]:
    """Return the digests of all verbs in a process of its own, by the order of the calls."""
    found = []
    for order in ('alone', 'forwards', 'backwards'):
        done = subprocess.run(
            [sys.executable, __file__, str(path), frame, order],
            timeout=TIMEOUT, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.append(dict(line.rsplit(' ', 1) for line in done.stdout.splitlines()))
    return found


@pytest.mark.parametrize(
    'name', [pytest.param(name, marks=[pytest.mark.long] * (name == 'ssrms')) for name in ROBOTS]
)
def test_each_verb_gives_the_same_on_a_fresh_process_and_after_all_others(
    repository: Path, name: str
) -> None:
    path = repository / 'config' / 'robots' / f'{name}.urdf'
    found = digests(path, ROBOTS[name])
    assert len(found[0]) == len(verbs(''))
    assert found[0] == found[1] == found[2]


if __name__ == '__main__':
    call_all(*sys.argv[1:])
