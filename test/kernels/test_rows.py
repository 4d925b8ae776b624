"""Every verb of a state takes rows of states, and gives what it gives row by row."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from looped_robots import random_closed
from strategies import random_state

from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

pytestmark = pytest.mark.usefixtures('two_threads')
ROWS = 150


@pytest.fixture(scope='module')
def robot() -> Robot:
    return random_closed(3, 'universal').robot


def flexible_link(robot: Robot) -> str:
    return next(b.name for b in robot.tree.bodies if b.beam is not None and any(b.beam.modes))


VERBS: dict[str, Callable[[Robot, Array], Any]] = {
    'frame_pose': lambda robot, q: robot.frame_pose(list(robot.tree.frames)[-1], q),
    'frame_jacobian': lambda robot, q: robot.frame_jacobian(list(robot.tree.frames)[-1], q),
    'tip_deflection': lambda robot, q: robot.tip_deflection(flexible_link(robot), q),
    'sensor_values': lambda robot, q: robot.sensor_values(q),
    'denoc_matrices': lambda robot, q: robot.denoc_matrices(q)[0],
    'natural_frequencies': lambda robot, q: robot.natural_frequencies(q[:3] if q.ndim > 1 else q),
    'closure': lambda robot, q: robot.closure(q),
    'closure_jacobian': lambda robot, q: robot.closure_jacobian(q),
    'closure_bias': lambda robot, q: robot.closure_bias(q, q),
    'inertia_matrix': lambda robot, q: robot.inertia_matrix(q),
    'constrained_forward_dynamics': lambda robot, q: robot.constrained_forward_dynamics(q, q, q)[
        0
    ],
}


@pytest.mark.parametrize('verb', VERBS.values(), ids=VERBS)
def test_rows_equal_states_one_by_one(robot: Robot, verb: Callable[[Robot, Array], Any]) -> None:
    state = random_state(robot.coordinate_names, 1)
    rows = state.q * np.linspace(0.5, 1.5, ROWS)[:, None]
    together = verb(robot, rows)
    for k in range(0, len(together), 37):
        alone = verb(robot, rows[k])
        scale = 1e-13 * max(1.0, float(np.abs(alone).max(initial=0.0)))
        np.testing.assert_allclose(together[k], alone, rtol=0.0, atol=scale)


def test_static_deflection_takes_rows_of_joint_positions(robot: Robot) -> None:
    joints = np.linspace(0.0, 0.1, 3)[:, None] * np.ones(len(robot.joint_names))
    together = robot.static_deflection(joints)
    assert together.shape == (3, robot.n)
    np.testing.assert_array_equal(together[2], robot.static_deflection(joints[2]))
