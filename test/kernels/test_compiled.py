"""What the loop relies on: kernels compile once, whatever array comes, and allocate nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from looped_robots import random_closed
from numba.core.runtime import _nrt_python, rtsys
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.kernels.jit.compiled import DECLARED, kernel_modules
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]


def entries() -> dict[str, Any]:
    """Kernels that Python calls."""
    kernel_modules()
    return {kernel.__name__: kernel for kernel in DECLARED}


@pytest.fixture(scope='module')
def robot() -> Robot:
    return load_robot(seeded_robot(3))


def call_all(robot: Robot, q: Array, qd: Array, qdd: Array) -> list[Array]:
    """Results of the verbs that a loop calls."""
    return [
        robot.inverse_dynamics(q, qd, qdd),
        robot.forward_dynamics(q, qd, qdd),
        robot.bias_forces(q, qd),
        robot.inertia_matrix(q),
        np.asarray(robot.energy(q, qd)),
        *robot.hybrid_dynamics(q, qd, np.ones((*q.shape[:-1], len(robot.joint_names)))),
    ]


def read_only(array: Array) -> Array:
    return np.frombuffer(array.tobytes()).reshape(array.shape)


def strided(array: Array) -> Array:
    wide = np.zeros((*array.shape, 2))
    wide[..., 0] = array
    return np.asarray(wide[..., 0])


def unaligned(array: Array) -> Array:
    raw = bytearray(1) + bytearray(array.tobytes())
    return np.frombuffer(raw, dtype=np.float64, offset=1).reshape(array.shape)


def swapped(array: Array) -> Array:
    return array.astype('>f8')


FORMS: list[Callable[[Array], Array]] = [read_only, strided, unaligned, swapped]


@pytest.mark.parametrize('form', FORMS, ids=lambda form: form.__name__)
@pytest.mark.parametrize('rows', [0, 3])
def test_any_array_gives_the_same_without_compiling(
    robot: Robot, form: Callable[[Array], Array], rows: int
) -> None:
    s = random_state(robot.coordinate_names, 1)
    state = [np.array([array] * rows) if rows else array for array in (s.q, s.qd, s.qdd)]
    expected = call_all(robot, *state)
    compiled = {name: len(kernel.signatures) for name, kernel in entries().items()}
    for value, plain in zip(call_all(robot, *map(form, state)), expected, strict=True):
        np.testing.assert_array_equal(value, plain)
    assert compiled == {name: len(kernel.signatures) for name, kernel in entries().items()}


def test_each_kernel_has_one_signature(robot: Robot) -> None:
    s = random_state(robot.coordinate_names, 1)
    other = load_robot('<robot name="r"><link name="a"/></robot>')
    call_all(robot, s.q, s.qd, s.qdd)
    call_all(robot.copy(), *(np.array([array] * 2) for array in (s.q, s.qd, s.qdd)))
    call_all(other, *np.zeros((3, other.n)))
    stepper = Stepper(robot, 1e-3)
    q, qd = s.q.copy(), s.qd.copy()
    stepper.free(q, qd, np.zeros(robot.n))
    stepper.driven(q, qd, np.zeros(len(robot.joint_names)))
    signatures = {name: len(kernel.signatures) for name, kernel in entries().items()}
    assert {'inverse_dynamics', 'articulated_dynamics', 'inertia_matrix'} <= set(signatures)
    assert {name: count for name, count in signatures.items() if count > 1} == {}


def allocations(robot: Robot, rows: int) -> int:
    """Allocations of numba's run time in calls of the verbs with so many rows."""
    s = random_state(robot.coordinate_names, 1)
    state = [np.array([array] * rows) for array in (s.q, s.qd, s.qdd)]
    before = rtsys.get_allocation_stats()
    call_all(robot, *state)
    after = rtsys.get_allocation_stats()
    return int(after.mi_alloc - before.mi_alloc + after.alloc - before.alloc)


def test_kernels_allocate_nothing(robot: Robot) -> None:
    _nrt_python.memsys_enable_stats()
    try:
        # each array argument of a call is one handle; 40 rows are 40 runs in one call
        assert allocations(robot, 40) == allocations(robot, 1)
    finally:
        _nrt_python.memsys_disable_stats()


def test_loops_allocate_nothing_and_compile_once() -> None:
    closed = random_closed(1, 'revolute')
    robot, tau = closed.robot, np.zeros(closed.robot.n)
    plain, tied = Stepper(load_robot(seeded_robot(3)), 1e-4), Stepper(robot, 1e-4)
    rest = np.zeros((3, plain.robot.n))
    q, qd = closed.q.copy(), closed.qd.copy()

    def counted(call: Callable[[], Any]) -> int:
        before = rtsys.get_allocation_stats()
        for _ in range(10):
            call()
        after = rtsys.get_allocation_stats()
        return int(after.mi_alloc - before.mi_alloc + after.alloc - before.alloc)

    _nrt_python.memsys_enable_stats()
    try:
        assert counted(lambda: robot.constrained_forward_dynamics(q, qd, tau)) == 0
        assert counted(lambda: plain.free(rest[0].copy(), rest[1].copy(), rest[2])) == 0
        # handles of the arguments' six arrays: taken, and given back
        assert counted(lambda: tied.free(q, qd, tau)) == 10 * 2 * 6
    finally:
        _nrt_python.memsys_disable_stats()
    counts = {name: len(kernel.signatures) for name, kernel in entries().items()}
    assert {name: count for name, count in counts.items() if count > 1} == {}


def test_robot_without_coordinates_has_empty_results() -> None:
    robot = load_robot('<robot name="r"><link name="a"/></robot>')
    empty = np.zeros(0)
    assert robot.n == 0
    assert robot.inverse_dynamics(empty, empty, empty).shape == (0,)
    assert robot.forward_dynamics(empty, empty, empty).shape == (0,)
    assert robot.inertia_matrix(empty).shape == (0, 0)
    assert robot.natural_frequencies(empty).shape == (0,)


def test_no_rows_give_no_rows(robot: Robot) -> None:
    none = np.zeros((0, robot.n))
    assert robot.inverse_dynamics(none, none, none).shape == (0, robot.n)
    assert robot.forward_dynamics(none, none, none).shape == (0, robot.n)
    assert robot.inertia_matrix(none).shape == (0, robot.n, robot.n)


def test_rows_in_parallel_are_rows_alone(close: Close, robot: Robot) -> None:
    states = [random_state(robot.coordinate_names, seed) for seed in range(40)]
    q, qd, u = (np.array([getattr(s, f) for s in states] * 20) for f in ('q', 'qd', 'qdd'))
    tau, qdd = robot.inverse_dynamics(q, qd, u), robot.forward_dynamics(q, qd, u)
    for k, s in enumerate(states):
        for row in range(k, len(q), 40):
            # two compiled loops may add in another order
            close(tau[row], robot.inverse_dynamics(s.q, s.qd, s.qdd), 1e-13)
            close(qdd[row], robot.forward_dynamics(s.q, s.qd, s.qdd), 1e-13)
