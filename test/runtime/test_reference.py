"""What the reference asks for at a time. No graph."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.joint_gate import JointGate
from denoc_ros.runtime.inputs.trajectory_messages import TrajectoryMessage
from denoc_ros.runtime.reference.reference import FiniteDifferencer, ReferenceFollower
from denoc_ros.types import Array

NOW_NS = 1_000_000_000_000


def trajectory(times: list[float], positions: list[float], start_s: float = 0.0) -> Any:
    """Return a message of one joint that starts `start_s` from NOW_NS (0: now)."""
    stamp = NOW_NS + round(start_s * 1e9) if start_s else 0
    return TrajectoryMessage(stamp, np.array(times), np.array(positions)[:, None], None, None)


def point(position: float, rate: float, acceleration: float) -> TrajectoryMessage:
    rows = [np.array([[value]]) for value in (position, rate, acceleration)]
    return TrajectoryMessage(0, np.zeros(1), rows[0], rows[1], rows[2])


def at(follower: ReferenceFollower, now: float) -> tuple[float, float, float]:
    q, qd, qdd = np.zeros((3, 1))
    assert follower.sample(now, q, qd, qdd)
    return float(q[0]), float(qd[0]), float(qdd[0])


def test_a_new_trajectory_takes_over_at_its_start_not_before() -> None:
    follower = ReferenceFollower(1, 0.2)
    follower.offer(trajectory([0.0, 1.0], [1.0, 1.0]), 10.0, NOW_NS)
    follower.offer(trajectory([0.0, 1.0], [5.0, 5.0], start_s=2.0), 11.0, NOW_NS)
    assert at(follower, 12.99)[0] == 1.0  # although nobody sampled the first in between
    assert at(follower, 13.01)[0] == 5.0
    assert follower.age(13.01) == 0.0


def test_a_trajectory_takes_over_from_a_stream_that_has_gone_stale() -> None:
    follower = ReferenceFollower(1, 0.2)
    follower.offer(point(1.0, 0.0, 0.0), 10.0, NOW_NS)
    assert follower.age(11.0) == 1.0
    follower.offer(trajectory([0.0, 1.0], [5.0, 5.0], start_s=1.0), 11.0, NOW_NS)
    assert follower.age(11.5) == 1.5
    # a node that looks at the age first would never sample it
    assert follower.age(12.0) == 0.0
    assert at(follower, 12.0)[0] == 5.0


def test_a_trajectory_from_the_past_starts_part_way_and_ends_holding() -> None:
    follower = ReferenceFollower(1, 0.2)
    follower.offer(trajectory([0.0, 2.0], [0.0, 1.0], start_s=-1.0), 10.0, NOW_NS)
    position, rate, _ = at(follower, 10.0)
    assert position == pytest.approx(0.5)
    assert rate > 0.5
    assert not follower.finished(10.5)
    assert at(follower, 11.5) == (1.0, 0.0, 0.0)
    assert follower.finished(11.5)


def test_a_late_first_point_is_reached_from_what_is_followed_or_measured() -> None:
    follower = ReferenceFollower(1, 0.2)
    follower.offer(trajectory([1.0], [3.0]), 10.0, NOW_NS, np.array([2.0]))
    assert at(follower, 10.0)[0] == 2.0
    assert at(follower, 11.0)[0] == 3.0
    follower.offer(trajectory([1.0], [0.0]), 20.0, NOW_NS, np.array([99.0]))
    assert at(follower, 20.0)[0] == 3.0
    assert at(follower, 21.0)[0] == 0.0


def both(follower: ReferenceFollower, now: float) -> tuple[list[float], list[float]]:
    q, qd, qdd = np.zeros((3, 2))
    assert follower.sample(now, q, qd, qdd)
    return q.tolist(), qd.tolist()


def of_the_second(times: list[float], positions: list[float]) -> TrajectoryMessage:
    """Return a message that does not name the first of two joints."""
    rows = np.column_stack((np.zeros(len(times)), positions))
    return TrajectoryMessage(0, np.array(times), rows, None, None, held=(0,))


def test_joints_that_a_trajectory_does_not_name_stay_where_they_are_wanted() -> None:
    follower = ReferenceFollower(2, 0.2)
    moving = TrajectoryMessage(
        0, np.array([0.0, 2.0]), np.array([[0.0, 5.0], [1.0, 5.0]]), *2 * (None,)
    )
    follower.offer(moving, 10.0, NOW_NS)
    follower.offer(of_the_second([1.0], [7.0]), 11.0, NOW_NS, np.array([99.0, 99.0]))
    for now in (11.0, 11.4, 12.0):
        q, qd = both(follower, now)
        assert q[0] == pytest.approx(0.5)
        assert qd[0] == pytest.approx(0.0)
    assert q[1] == 7.0
    follower.offer(of_the_second([0.0], [6.0]), 20.0, NOW_NS)  # a streamed point
    assert both(follower, 20.0)[0] == [pytest.approx(0.5), 6.0]


def test_joints_that_nobody_wanted_anywhere_stay_where_they_stand() -> None:
    follower = ReferenceFollower(2, 0.2)
    admitted: list[int] = []
    message = of_the_second([0.0, 1.0], [0.0, 1.0])
    with pytest.raises(InputError, match='reference must name all joints') as caught:
        follower.offer(message, 10.0, NOW_NS, None, lambda: admitted.append(1))
    assert caught.value.cause == 'missing_joint'
    assert not admitted
    assert not follower.given
    follower.offer(message, 10.0, NOW_NS, np.array([3.0, 4.0]), lambda: admitted.append(1))
    assert both(follower, 11.0)[0] == [3.0, 1.0]
    assert admitted == [1]


def nothing() -> TrajectoryMessage:
    return TrajectoryMessage(0, np.zeros(0), np.zeros((0, 1)), None, None)


@pytest.mark.parametrize('streamed', [False, True])
def test_a_message_without_points_brakes_along_the_motion_without_a_step(streamed: bool) -> None:
    follower = ReferenceFollower(1, 0.2)
    if streamed:
        follower.offer(point(1.0, 0.5, 0.0), 9.99, NOW_NS)
        follower.offer(point(1.005, 0.5, 0.0), 10.0, NOW_NS)
    else:
        follower.offer(trajectory([0.0, 4.0], [0.0, 2.0]), 8.0, NOW_NS)
        follower.offer(trajectory([0.0, 1.0], [5.0, 5.0], start_s=2.0), 10.0, NOW_NS)
    before = at(follower, 10.0)
    follower.offer(nothing(), 10.0, NOW_NS)
    assert at(follower, 10.0) == pytest.approx(before, abs=1e-9)
    times = np.arange(10.0, 10.4, 1e-3)
    q, qd, _ = np.array([at(follower, t) for t in times]).T
    assert np.abs(np.diff(q) - 1e-3 * qd[:-1]).max() < 1e-5  # neither position nor rate jumps
    assert np.abs(np.diff(qd)).max() < 0.01
    assert np.all(qd <= before[1] * (1.0 + 1e-3))
    assert np.all(qd >= -1e-6)
    q_end, rate, acceleration = at(follower, 10.5)
    assert (rate, acceleration) == (0.0, 0.0)
    assert before[0] < q_end <= before[0] + 0.16 * before[1]
    assert at(follower, 14.0)[0] == q_end  # what was to come does not


def test_at_rest_a_message_without_points_changes_nothing() -> None:
    follower = ReferenceFollower(1, 0.2)
    follower.offer(nothing(), 9.0, NOW_NS)
    assert not follower.given
    follower.offer(trajectory([0.0, 1.0], [0.0, 2.0]), 10.0, NOW_NS)
    follower.offer(nothing(), 12.0, NOW_NS)
    assert at(follower, 12.5) == (2.0, 0.0, 0.0)


def test_a_streamed_point_goes_on_for_one_interval_of_the_stream() -> None:
    follower = ReferenceFollower(1, 0.2)
    follower.offer(point(1.0, 2.0, 4.0), 10.0, NOW_NS)
    assert at(follower, 10.005) == (1.0, 2.0, 4.0)  # the interval is not known yet
    follower.offer(point(1.0, 2.0, 4.0), 10.01, NOW_NS)
    position, rate, _ = at(follower, 10.015)
    assert position == pytest.approx(1.0 + 2.0 * 0.005 + 2.0 * 0.005**2)
    assert rate == pytest.approx(2.0 + 4.0 * 0.005)
    assert at(follower, 10.5) == pytest.approx(at(follower, 10.02))
    assert follower.age(10.5) == pytest.approx(0.49)


def test_clear_leaves_nothing() -> None:
    follower = ReferenceFollower(1, 0.2)
    assert not follower.given
    follower.offer(point(1.0, 0.0, 0.0), 10.0, NOW_NS)
    assert follower.given
    assert follower.streamed
    follower.clear()
    assert not follower.given
    assert not follower.sample(10.0, *np.zeros((3, 1)))


def test_missing_rates_are_differenced_and_gaps_are_not() -> None:
    stream = FiniteDifferencer(1, gap=0.1)
    for k in range(4):
        t = 0.01 * k
        _, qd, qdd = stream.complete(t, np.array([3.0 * t * t]), None, None)
    # backward differences of 3 t^2, half an interval behind
    assert qd[0] == pytest.approx(6.0 * (t - 0.005))
    assert qdd[0] == pytest.approx(6.0)
    _, qd, qdd = stream.complete(1.0, np.array([50.0]), None, None)
    assert (qd[0], qdd[0]) == (0.0, 0.0)


def test_differenced_accelerations_pass_the_low_pass() -> None:
    stream = FiniteDifferencer(1, gap=0.1, cutoff=5.0)
    values = [
        float(stream.complete(0.001 * k, np.zeros(1), np.array([float(k > 0)]), None)[2][0])
        for k in range(3)
    ]
    assert values[0] == 0.0
    assert 0.0 < values[1] < 50.0  # of the unfiltered 1000
    assert 0.0 < values[2] < values[1]


def streamed_motion(
    positions: Array, times: Array, limit: float = math.inf
) -> tuple[ReferenceFollower, Array, list[InputError]]:
    """Stream points without rates; return the follower, its motion at each, what it refuses.

    A position of NaN is no point at all.
    """
    gate = JointGate(['swing'], [True], np.array([10.0]))
    follower = ReferenceFollower(1, 0.2, gate=gate, acceleration=np.array([limit]))
    refused: list[InputError] = []
    rows = []
    for t, q in zip(times, positions, strict=True):
        if not math.isnan(q):
            message = TrajectoryMessage(0, np.zeros(1), np.array([[q]]), None, None)
            follower.offer(message, t, NOW_NS, refuse=refused.append)
        rows.append(at(follower, t))
    return follower, np.array(rows), refused


TIMES = np.arange(0.0, 2.0, 0.004)
SWING = 2.4 + 1.5 * (1.0 - np.cos(2.0 * TIMES))


def test_a_stream_that_wraps_is_the_motion_that_does_not() -> None:
    wrapped = (SWING + math.pi) % (2.0 * math.pi) - math.pi
    assert np.abs(np.diff(wrapped)).max() > 6.0
    _, expected, _ = streamed_motion(SWING, TIMES)
    _, found, refused = streamed_motion(wrapped, TIMES)
    assert not refused
    np.testing.assert_allclose(found, expected, atol=1e-7)


@pytest.mark.parametrize('error', [0.3, -2.0, 0.01])
def test_one_wrong_streamed_point_is_one_that_did_not_come(error: float) -> None:
    place = 250
    wrong, missing = SWING.copy(), SWING.copy()
    wrong[place] += error
    missing[place] = math.nan
    _, expected, _ = streamed_motion(missing, TIMES)
    _, found, refused = streamed_motion(wrong, TIMES)
    assert [each.cause for each in refused] == ['implausible']
    np.testing.assert_array_equal(found[place + 1 :], expected[place + 1 :])
    # The motion goes on in the meantime.
    np.testing.assert_allclose(found[place, 0], SWING[place], atol=1e-4)


def test_a_stream_that_jumps_is_reached_with_a_bounded_acceleration() -> None:
    limit, jump = 20.0, 0.5
    positions = np.where(TIMES < 0.5, 1.0, 1.0 + jump)
    _, motion, _ = streamed_motion(positions, TIMES, limit)
    q, qd, qdd = motion.T
    assert np.abs(qdd).max() <= limit * (1.0 + 1e-9)
    assert np.abs(np.diff(q)).max() <= np.abs(qd).max() * 0.004 * (1.0 + 1e-9)
    assert q.max() <= 1.0 + jump + 1e-4
    reached = q[np.searchsorted(TIMES, 0.6 + 2.5 * math.sqrt(jump / limit))]
    assert reached == pytest.approx(1.5, abs=1e-3)
    assert motion[-1] == pytest.approx([1.5, 0.0, 0.0], abs=1e-9)


def test_a_stream_within_the_bound_is_differenced_exactly() -> None:
    _, free, _ = streamed_motion(SWING, TIMES)
    _, bounded, _ = streamed_motion(SWING, TIMES, 50.0)
    np.testing.assert_allclose(bounded[3:], free[3:], rtol=0, atol=1e-7)


def sine(t: Any) -> Any:
    return 0.6 * np.sin(1.3 * np.asarray(t))


@pytest.mark.parametrize(
    ('first', 'late'), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.13)], ids=['now', 'later', 'stamped']
)
def test_a_trajectory_that_replaces_another_goes_on_from_its_state(
    first: float, late: float
) -> None:
    """`late`: a policy needs time, and stamps its points by when it began."""
    follower = ReferenceFollower(1, 0.2)
    times: Array = first + 0.05 * np.arange(16.0)
    jumps = []
    for k in range(8):
        now = 10.0 + 0.4 * k
        before = at(follower, now) if k else None
        message = TrajectoryMessage(
            NOW_NS - round(1e9 * late) if late else 0,
            times,
            sine(now - late - 10.0 + times)[:, None],
            None,
            None,
        )
        follower.offer(message, now, NOW_NS)
        if before is not None:
            jumps.append(np.subtract(at(follower, now), before))
        if k > 2:
            t = np.linspace(now, now + 0.39, 40)
            q = np.array([at(follower, each)[0] for each in t])
            np.testing.assert_allclose(q, sine(t - 10.0), atol=1e-4)
    np.testing.assert_allclose(jumps, 0.0, atol=1e-9)


def test_a_trajectory_that_comes_late_is_joined_with_accelerations_like_its_own() -> None:
    follower = ReferenceFollower(1, 0.2)
    times: Array = 0.05 * np.arange(16.0)
    for k in range(8):
        now = 10.0 + 0.4 * k + 0.02 * (k % 2)  # without a stamp: all points move with it
        points = sine(0.4 * k + times)[:, None]
        follower.offer(TrajectoryMessage(0, times, points, None, None), now, NOW_NS)
        if k:
            moments = np.linspace(now, now + 0.35, 100)
            changes = [abs(at(follower, float(t))[2]) for t in moments]
            assert max(changes) < 3.0 * 0.6 * 1.3**2


def test_a_trajectory_begins_in_the_turn_of_the_joints() -> None:
    gate = JointGate(['swing'], [True], np.array([10.0]))
    turn = 2.0 * math.pi
    for first, position in ((0.0, 0.5 - turn), (0.05, 0.51 + turn)):
        follower = ReferenceFollower(1, 0.2, gate=gate)
        path = trajectory([first, first + 1.0], [position, position + 0.2])
        follower.offer(path, 10.0, NOW_NS, np.array([0.5]))
        assert at(follower, 12.0)[0] == pytest.approx((position + 0.2) % turn)
    follower.offer(trajectory([3.0], [0.5 + 2.0 * turn]), 20.0, NOW_NS, np.array([0.5]))
    assert at(follower, 23.0)[0] == pytest.approx(0.5 + 2.0 * turn)  # turns that are wanted
