"""What the derivatives take and give: out=, its refusals, and no memory kept."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from book.benchmarks.peers import flexible_chain
from looped_robots import random_closed
from numba.core.runtime import _nrt_python, rtsys
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array

KernelOperation = Callable[..., Sequence[Array]]
VERBS = ('inverse', 'forward', 'hybrid')


def verb(robot: Robot, name: str, rows: int = 0) -> KernelOperation:
    s = random_state(robot.coordinate_names, 2)
    q, qd, qdd = (np.array([x] * rows) if rows else x.copy() for x in (s.q, s.qd, s.qdd))
    if name == 'hybrid':
        given = np.ascontiguousarray(qdd[..., robot.joint_indices])
        return lambda **more: robot.hybrid_dynamics_derivatives(q, qd, given, **more)
    called = getattr(robot, f'{name}_dynamics_derivatives')
    return lambda **more: called(q, qd, qdd, **more)


def constrained(name: str, count: int = 3) -> tuple[KernelOperation, KernelOperation]:
    """A verb of a robot with loops, on one state and on rows."""
    c = random_closed(2, 'revolute', links=8)
    robot, tau = c.robot, np.zeros(c.robot.n)
    tau[robot.joint_indices] = 1.0
    third = tau
    if name == 'inverse':
        third = robot.constrained_forward_dynamics(c.q, c.qd, tau)[0]
    more = {} if name == 'forward' else {'actuated': robot.joint_names}
    if name == 'hybrid':
        more, third = {'actuated': robot.joint_names[:1]}, np.ones(1)
    called = getattr(robot, f'constrained_{name}_dynamics_derivatives')
    rows = [np.array([x] * count) for x in (c.q, c.qd, third)]
    return (
        lambda **out: called(c.q, c.qd, third, **more, **out),
        lambda **out: called(*rows, **more, **out),
    )


def fills(called: KernelOperation) -> None:
    """Assert that out= takes the results and is what comes back."""
    fresh = called()
    out = [np.full_like(each, np.nan) for each in fresh]
    for result, given, expected in zip(called(out=out), out, fresh, strict=True):
        assert result is given
        np.testing.assert_array_equal(given, expected)
    with pytest.raises(StateError, match=rf'out must be (three|{len(fresh)}) arrays, got 1'):
        called(out=out[:1])
    with pytest.raises(StateError, match='out must be a writable C-contiguous float64 array'):
        called(out=[*out[:-1], np.zeros(1)])


@pytest.mark.parametrize('rows', [0, 3])
@pytest.mark.parametrize('name', VERBS)
def test_out_is_filled_and_returned(name: str, rows: int) -> None:
    fills(verb(load_robot(seeded_robot(5)), name, rows))


@pytest.mark.parametrize('name', VERBS)
def test_out_of_loops_is_filled_and_returned(name: str) -> None:
    for called in constrained(name):
        fills(called)


def test_results_of_one_call_outlive_the_next() -> None:
    robot = load_robot(seeded_robot(5))
    first = verb(robot, 'hybrid')()
    kept = [each.copy() for each in first]
    zero = np.zeros(robot.n)
    robot.hybrid_dynamics_derivatives(zero, zero, zero[robot.joint_indices])
    for each, expected in zip(first, kept, strict=True):
        np.testing.assert_array_equal(each, expected)


@pytest.mark.parametrize('name', VERBS)
def test_call_with_out_keeps_no_memory(name: str) -> None:
    robot = load_robot(flexible_chain(8, 2, 2, 0))
    called = verb(robot, name)
    peak = peak_with_out(lambda **out: called(check=False, **out))
    # frames, argument tuples and arrays of the state's size pass, matrices do not
    assert peak < 8192 < 8 * robot.n**2


@pytest.mark.parametrize('name', VERBS)
def test_call_of_loops_with_out_keeps_no_memory(name: str) -> None:
    single, rows = constrained(name, 60)  # as many as one thread takes, in this workspace
    matrices = sum(each.nbytes for each in rows())
    assert peak_with_out(single) < 8192 < matrices // 8
    # rows of zeros for forces that are not given pass
    assert peak_with_out(rows, 5) < matrices // 8


def peak_with_out(called: KernelOperation, count: int = 200) -> int:
    """Peak of traced memory over calls that are given their results' arrays [bytes]."""
    out = called()

    def calls(count: int) -> int:
        """Peak of traced memory over the calls [bytes]."""
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(count):
            called(out=out)
        return tracemalloc.get_traced_memory()[1] - before

    tracemalloc.start()
    try:
        calls(10)
        return calls(count)
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize('name', VERBS)
def test_kernels_allocate_nothing(name: str) -> None:
    robot = load_robot(seeded_robot(5))
    allocate_the_same(lambda rows: verb(robot, name, rows))


@pytest.mark.parametrize('name', VERBS)
def test_kernels_of_loops_allocate_nothing(name: str) -> None:
    allocate_the_same(lambda rows: constrained(name, rows)[1])


def allocate_the_same(of_rows: Callable[[int], KernelOperation]) -> None:
    """Assert that a call allocates no more for many rows than for two."""

    def allocations(rows: int) -> int:
        called = of_rows(rows)
        called()
        before = rtsys.get_allocation_stats()
        called()
        after = rtsys.get_allocation_stats()
        return int(after.mi_alloc - before.mi_alloc + after.alloc - before.alloc)

    _nrt_python.memsys_enable_stats()
    try:
        assert allocations(40) == allocations(2)
    finally:
        _nrt_python.memsys_disable_stats()
