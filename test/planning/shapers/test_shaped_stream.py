"""A streamed motion through a shaper, on a clock of the test's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from denoc_ros.planning.shapers.joint_servo import JointServo, joint_servo
from denoc_ros.planning.shapers.ringing import RingingModes
from denoc_ros.planning.shapers.shaped_stream import ShapedStream
from denoc_ros.types import Array

pytestmark = pytest.mark.ros
PERIOD = 0.005
MODES = RingingModes(np.array([2.0, 9.0]), np.zeros(2))
NONE = joint_servo(1)


def run(
    points: Callable[[float], tuple[float, float, float] | None],
    servo: JointServo = NONE,
    duration: float = 4.0,
    missed: int = 0,
) -> tuple[Array, Array]:
    """Return times and what one joint is told (k, 3), points of (q, qd, qdd) while there are."""
    stream = ShapedStream(1, PERIOD, stale_after=0.1, stop_time=0.3)
    stream.begin('zv', MODES, np.zeros(1), servo)
    times, rows = [], []
    ticks = iter(range(round(duration / PERIOD)))
    for tick in ticks:
        now = tick * PERIOD
        point = points(now)
        if point is not None:
            stream.follower.offer_point(now, *(np.array([value]) for value in point))
        steps = 1
        if tick == 100:
            for _ in range(missed):  # the loop was away
                next(ticks)
                steps += 1
        row = stream.tick(now + (steps - 1) * PERIOD, steps)
        if row is None:
            break
        times.append(now + (steps - 1) * PERIOD)
        rows.append(row[:, 0])
    assert not stream.active
    return np.array(times), np.array(rows)


def test_points_that_stop_coming_are_braked_and_the_mode_is_at_rest() -> None:
    # half a radian per second for half a second, then nothing
    t, rows = run(lambda now: (0.5 * now, 0.5, 0.0) if now < 0.5 else None)
    q, qd, _ = rows.T
    # on for the time that makes it stale, then evenly slower
    assert q[-1] == pytest.approx(0.5 * 0.6 + 0.5 * 0.5 * 0.3, abs=0.01)
    assert qd[-1] == 0.0
    assert np.abs(np.diff(q)).max() <= 0.51 * PERIOD
    # the delay of both modes later it is over
    assert t[-1] == pytest.approx(0.6 + 0.3 + 0.25 + 1.0 / 18.0, abs=0.05)


def test_rates_are_those_of_the_positions() -> None:
    def swell(now: float) -> tuple[float, float, float]:
        s = min(now, 1.0)
        return (
            s**3 * (10 - 15 * s + 6 * s * s),
            30 * s * s * (1 - s) ** 2,
            60 * s * (1 - s) * (1 - 2 * s),
        )

    _, rows = run(lambda now: swell(now) if now < 1.5 else None)
    q, qd, qdd = rows.T
    np.testing.assert_allclose(np.gradient(q, PERIOD)[2:-2], qd[2:-2], atol=2e-3)
    np.testing.assert_allclose(np.gradient(qd, PERIOD)[2:-2], qdd[2:-2], atol=0.1)
    assert q[-1] == pytest.approx(1.0, abs=1e-6)


def test_ticks_that_are_missed_are_caught_up() -> None:
    def point(now: float) -> tuple[float, float, float] | None:
        return (0.3 * min(now, 1.0), 0.3 * (now < 1.0), 0.0) if now < 1.2 else None

    t, rows = run(point)
    late, caught = run(point, missed=4)
    whole = np.interp(late, t, rows[:, 0])
    np.testing.assert_allclose(caught[:, 0], whole, atol=0.3 * 5 * PERIOD)
    np.testing.assert_allclose(caught[-1, 0], rows[-1, 0], atol=1e-6)


def test_servo_is_undone_but_for_its_delay() -> None:
    servo = joint_servo(1, 5.0, 0.5)

    def points(now: float) -> tuple[float, float, float] | None:
        row = 0.1 * np.sin(now) ** 2, 0.1 * np.sin(2.0 * now), 0.2 * np.cos(2.0 * now)
        return row if now < 1.0 else None

    _, plain = run(points)
    _, told = run(points, servo)
    omega = 2.0 * np.pi * 5.0
    wanted = plain[:, 0] + plain[:, 1] / omega + plain[:, 2] / omega**2
    np.testing.assert_allclose(told[:, 0], wanted, atol=1e-12)
