"""Simulations on a base that moves: six prescribed joints, conservation, steady spin."""

from __future__ import annotations

import numpy as np
import pytest
from base_robots import SIX, base_motion, description, pair

import denoc_ros as dn
from denoc_ros.errors import StateError
from denoc_ros.types import Array

GRAVITY = np.array([0.0, -9.0, 3.0])


def rolling(k: int, t: float) -> tuple[float, float, float]:
    """Position, rate and acceleration of the k-th of six joints of a ship."""
    size, w = 0.1 + 0.05 * k, 0.5 + 0.2 * k
    s, c = np.sin(w * t), np.cos(w * t)
    return size * s, size * w * c, -size * w * w * s


@pytest.mark.long
def test_run_equals_that_on_six_prescribed_joints() -> None:
    robot, carried, root = pair('two_link_ff', GRAVITY)
    start = np.zeros(robot.n)
    rate = np.array([rolling(k, 0.0)[1] for k in range(6)])
    times = np.linspace(0.0, 2.0, 9)

    def base(t: float) -> tuple[Array, ...]:
        joints = np.array([rolling(k, t) for k in range(6)])
        state = [np.append(joints[:, part], start) for part in range(3)]
        return base_motion(carried, root, (state[0], state[1], state[2]))

    run = dn.simulate(robot, start, start, times, base=base, rtol=1e-10, atol=1e-12)
    prescribed = {name: (lambda t, k=k: rolling(k, t)) for k, name in enumerate(SIX)}
    wanted = dn.simulate(
        carried, np.append(np.zeros(6), start), np.append(rate, start), times,
        prescribed=prescribed, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    # two integrations at 1e-10 per step, of motions of 1 rad and 1 J
    np.testing.assert_allclose(run.q, wanted.q[:, 6:], rtol=0, atol=1e-7)
    np.testing.assert_allclose(run.energy, wanted.energy, rtol=1e-6, atol=1e-6)
    assert np.abs(run.q[-1]).max() > 0.01


def test_steady_spin_by_a_tuple_is_that_of_a_function() -> None:
    robot = dn.load_robot(description('two_link_ff'), gravity=(0, 0, 0))
    base = (np.array([0.0, 0, 0, 0, 0.3, 0.2]), np.array([0.1, 0, 0, 0, 0, 0]))
    q = np.full(robot.n, 0.01)
    times = np.linspace(0.0, 0.5, 3)
    steady = dn.simulate(robot, q, 0 * q, times, base=base)
    by_time = dn.simulate(robot, q, 0 * q, times, base=lambda t: base)
    still = dn.simulate(robot, q, 0 * q, times)
    np.testing.assert_allclose(steady.q, by_time.q, rtol=0, atol=1e-9)
    assert np.abs(steady.q - still.q).max() > 1e-3
    robot.move_base(base)
    live = dn.simulate(robot, q, 0 * q, times)
    np.testing.assert_allclose(live.q, steady.q, rtol=0, atol=1e-12)


def test_a_wrong_base_stops_the_run() -> None:
    robot = dn.load_robot(description('two_link_ff'))
    zero = np.zeros(robot.n)
    with pytest.raises(StateError, match='base acceleration must have shape'):
        dn.simulate(robot, zero, zero, np.array([0.0, 1.0]), base=lambda t: (np.zeros(6), 1.0))
