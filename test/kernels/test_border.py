"""What Robot takes and gives at its border: out=, bad arguments, no allocation."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.validation import as_states
from denoc_ros.errors import StateError
from denoc_ros.types import Array


@pytest.fixture(scope='module')
def robot() -> Robot:
    return load_robot(seeded_robot(6))


@pytest.fixture
def state(robot: Robot) -> tuple[Array, Array, Array]:
    s = random_state(robot.coordinate_names, 1)
    return s.q, s.qd, s.qdd


def verbs(robot: Robot, q: Array, qd: Array, qdd: Array) -> dict[str, Callable[..., Array]]:
    """Verbs of one result, by name, with the result's place left open."""
    return {
        'inverse': lambda **more: robot.inverse_dynamics(q, qd, qdd, **more),
        'forward': lambda **more: robot.forward_dynamics(q, qd, qdd, **more),
        'bias': lambda **more: robot.bias_forces(q, qd, **more),
        'inertia': lambda **more: robot.inertia_matrix(q, **more),
    }


def test_out_is_filled_and_returned(robot: Robot, state: tuple[Array, Array, Array]) -> None:
    for name, verb in verbs(robot, *state).items():
        fresh = verb()
        out = np.full_like(fresh, np.nan)
        assert verb(out=out) is out, name
        np.testing.assert_array_equal(out, fresh, err_msg=name)


def test_out_may_be_an_argument(robot: Robot, state: tuple[Array, Array, Array]) -> None:
    expected = {name: verb() for name, verb in verbs(robot, *state).items()}
    for position in range(3):
        for name in ('inverse', 'forward'):
            arguments = [array.copy() for array in state]
            verbs(robot, *arguments)[name](out=arguments[position])
            np.testing.assert_array_equal(arguments[position], expected[name], err_msg=name)
    q, qd, _ = (array.copy() for array in state)
    np.testing.assert_array_equal(robot.bias_forces(q, qd, out=qd), expected['bias'])


def test_out_of_rows_is_filled(robot: Robot, state: tuple[Array, Array, Array]) -> None:
    q, qd, u = (np.array([array] * 3) for array in state)
    for name, verb in verbs(robot, q, qd, u).items():
        fresh = verb()
        out = np.full_like(fresh, np.nan)
        assert verb(out=out) is out, name
        np.testing.assert_array_equal(out, fresh, err_msg=name)


@pytest.mark.parametrize('size', [-1, 1])
def test_wrong_sizes_never_reach_memory(
    robot: Robot, state: tuple[Array, Array, Array], size: int
) -> None:
    for position in range(3):
        arguments = [array.copy() for array in state]
        arguments[position] = np.zeros(robot.n + size)
        q, qd, u = arguments
        for verb in (robot.inverse_dynamics, robot.forward_dynamics):
            with pytest.raises(StateError, match='must have shape'):
                verb(q, qd, u, check=False)
    for name, verb in verbs(robot, *state).items():
        for out in (np.zeros(robot.n + size), np.zeros((robot.n + size, robot.n + size))):
            with pytest.raises(StateError, match='out must'):
                verb(out=out, check=False)
        frozen = verb()
        frozen.setflags(write=False)
        with pytest.raises(StateError, match='out must'):
            verb(out=frozen, check=False)
        with pytest.raises(StateError, match='out must'):
            verb(out=np.zeros((*frozen.shape, 2))[..., 0], check=False)
        assert name


def test_result_without_out_is_the_callers_own(
    robot: Robot, state: tuple[Array, Array, Array]
) -> None:
    for name, verb in verbs(robot, *state).items():
        first = verb()
        kept = first.copy()
        first[...] = 0
        np.testing.assert_array_equal(verb(), kept, err_msg=name)


def test_arguments_are_left_alone(robot: Robot, state: tuple[Array, Array, Array]) -> None:
    before = [array.copy() for array in state]
    for verb in verbs(robot, *state).values():
        verb()
    for array, kept in zip(state, before, strict=True):
        np.testing.assert_array_equal(array, kept)


@pytest.mark.parametrize('position', [0, 1, 2])
def test_wrong_shape_is_named(robot: Robot, position: int) -> None:
    q, qd, u = (np.zeros(robot.n + (k == position)) for k in range(3))
    for verb in (robot.inverse_dynamics, robot.forward_dynamics):
        with pytest.raises(StateError, match=rf'must .*{robot.n}.*got.*{robot.n + 1}'):
            verb(q, qd, u)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('position', [0, 1, 2])
def test_non_finite_is_refused(
    robot: Robot, state: tuple[Array, Array, Array], position: int, bad: float
) -> None:
    arguments = [array.copy() for array in state]
    arguments[position][robot.n // 2] = bad
    for verb in (robot.inverse_dynamics, robot.forward_dynamics):
        with pytest.raises(StateError, match='finite'):
            verb(*arguments)


def test_wrong_type_is_refused(robot: Robot, state: tuple[Array, Array, Array]) -> None:
    q, qd, qdd = state
    with pytest.raises(StateError, match='must'):
        robot.inverse_dynamics(np.array(['a'] * robot.n), qd, qdd)  # type: ignore[arg-type]
    with pytest.raises(StateError, match='must'):
        robot.inverse_dynamics(q.astype(complex) + 1j, qd, qdd)  # type: ignore[arg-type]
    with pytest.raises(StateError, match='must'):
        robot.inverse_dynamics(q, qd, qdd, out=np.zeros(robot.n, dtype=np.float32))  # type: ignore[arg-type]
    with pytest.raises(StateError, match='must'):
        robot.inverse_dynamics(q, qd, qdd, out=np.zeros(robot.n - 1))


def test_unknown_frame_is_refused(robot: Robot, state: tuple[Array, Array, Array]) -> None:
    q, qd, qdd = state
    with pytest.raises(StateError, match='nowhere'):
        robot.frame_pose('nowhere', q)
    with pytest.raises(StateError, match='nowhere'):
        robot.inverse_dynamics(q, qd, qdd, wrenches={'nowhere': np.zeros(6)})


def test_batch_rows_are_checked(robot: Robot, state: tuple[Array, Array, Array]) -> None:
    q, qd, qdd = (np.array([array] * 3) for array in state)
    with pytest.raises(StateError, match='must'):
        robot.inverse_dynamics(q, qd[:2], qdd)
    qd[2, 0] = np.nan
    with pytest.raises(StateError, match='finite'):
        robot.inverse_dynamics(q, qd, qdd)


@pytest.mark.parametrize('name', ['inverse', 'forward', 'bias', 'inertia'])
def test_call_with_out_keeps_no_memory(
    robot: Robot, state: tuple[Array, Array, Array], name: str
) -> None:
    verb = verbs(robot, *state)[name]
    out = verb()

    def calls(count: int) -> int:
        """Peak of traced memory over the calls [bytes]."""
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(count):
            verb(out=out, check=False)
        return tracemalloc.get_traced_memory()[1] - before

    tracemalloc.start()
    try:
        calls(10)
        peak = calls(200)
    finally:
        tracemalloc.stop()
    # frames and argument tuples of Python pass; an array of the state's size is 8 n bytes each
    assert peak < 4096


def test_finite_states_are_taken_where_their_squares_overflow() -> None:
    large = np.array([1e200, -1e300, 0.0])
    assert as_states('q', large, 3) is large
    for bad in (np.nan, np.inf, -np.inf):
        with pytest.raises(StateError, match=r'q must be finite, got .* at index \(1,\)'):
            as_states('q', [1e200, bad, 0.0], 3)
