"""Arrays handed over as objects: whatever comes, the result is that of an ordinary call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from strategies import random_state, seeded_robot

from denoc_ros.dynamics import robot_model
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.kernels.dynamics.inverse import inverse_dynamics
from denoc_ros.kernels.jit.array_object import NOWHERE, array_type
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.kernels.jit.handle import GOOD, MISFIT
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
State = tuple[Array, Array, Array]
ROBOT = seeded_robot(3)


class Subclass(np.ndarray[Any, Any]):
    """Arrays of a subclass may hold their elements as they like."""


@pytest.fixture(scope='module')
def robot() -> Robot:
    return load_robot(ROBOT)


@pytest.fixture(scope='module')
def state(robot: Robot) -> State:
    s = random_state(robot.coordinate_names, 1)
    return s.q, s.qd, s.qdd


def status(robot: Robot, *arguments: Any) -> int:
    return entry(inverse_dynamics)(robot.handle, *arguments)


def test_arrays_are_looked_into_here() -> None:
    assert array_type() == id(np.ndarray)


@pytest.mark.parametrize(
    'form',
    [
        lambda a: None,
        lambda a: 7,
        lambda a: a.tolist(),
        lambda a: a.view(Subclass),
        lambda a: a.astype(np.float32),
        lambda a: a.astype(np.int64),
        lambda a: a.astype('>f8'),
        lambda a: np.repeat(a, 2)[::2],
        lambda a: a[::-1],
        lambda a: a[:-1].copy(),
        lambda a: np.append(a, 0.0),
        lambda a: a[None].copy(),
        lambda a: a[0],
        lambda a: np.array(a[0]),
        lambda a: np.frombuffer(b'x' + a.tobytes(), dtype=np.float64, offset=1),
        lambda a: np.ndarray,
        lambda a: memoryview(a),
    ],
)
def test_kernel_refuses_all_but_plain_vectors(
    robot: Robot, state: State, form: Callable[[Array], Any]
) -> None:
    plain = [*state, np.zeros(robot.n)]
    assert status(robot, *plain) == GOOD
    for k in range(4):
        assert status(robot, *plain[:k], form(plain[k]), *plain[k + 1 :]) == MISFIT


def test_kernel_reads_what_it_may_not_write_and_no_more(robot: Robot, state: State) -> None:
    q, qd, qdd = state
    fixed, out = q.copy(), np.zeros(robot.n)
    fixed.flags.writeable = False
    assert status(robot, fixed, qd, qdd, out) == GOOD
    out.flags.writeable = False
    assert status(robot, q, qd, qdd, out) == MISFIT


def test_interpreter_without_such_arrays_gets_the_same(
    robot: Robot, state: State, monkeypatch: pytest.MonkeyPatch, close: Close
) -> None:
    monkeypatch.setattr(robot_model, 'ARRAY_TYPE', NOWHERE)
    other = load_robot(ROBOT)
    q, qd, _ = state
    assert status(other, *state, np.zeros(other.n)) == MISFIT
    out = np.zeros(other.n)
    assert other.inverse_dynamics(*state, out=out) is out
    # compiled loops may add in another order
    close(out, robot.inverse_dynamics(*state), 1e-13)
    close(other.forward_dynamics(q, qd, out), robot.forward_dynamics(q, qd, out), 1e-13)
    close(other.inertia_matrix(q), robot.inertia_matrix(q), 1e-13)
    close(other.energy(q, qd), robot.energy(q, qd), 1e-13)
