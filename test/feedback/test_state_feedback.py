"""State feedback on a robot that is not its model: how far the tip is off, what it survives."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from feedback_runs import (
    PERIOD,
    Loop,
    Outcome,
    Planned,
    canadarm,
    closed,
    described,
    tip_exact,
)

from denoc_ros.feedback.state_feedback import FADE, RAMP, StateFeedback


@cache
def whole() -> Outcome:
    """Return the whole motion with feedback, no value lost."""
    return closed(tip_exact(), canadarm(0.9, 1.2)).run()


def test_tip_stays_with_its_plan_on_a_wrong_model() -> None:
    alone, good = Loop(tip_exact(), canadarm(0.9, 1.2), None).run(), whole()
    # the plan alone drifts away for good: metres
    assert alone.after(0.0) > 1.0
    # 2.1 and 0.47 mm; without the estimate of the model's errors 4.6 mm
    assert good.rms < 0.0035
    assert good.after(3.0) < 0.0008


def test_errors_of_the_model_are_found_and_undone() -> None:
    loop = closed(tip_exact(), canadarm(0.9, 1.2))
    loop.noise = 0.0
    run = loop.run()
    assert loop.feedback is not None
    errors = loop.feedback.filter.errors
    assert errors is not None
    # compliance of two beams, and the load
    np.testing.assert_allclose(errors.values, [0.11, 0.11, 0.2], atol=0.08)
    # 1 mm; 4 mm where integrals alone undo them
    assert run.rms < 0.002
    assert run.after(3.0) < 1e-4


def test_errors_of_a_right_model_stay_small() -> None:
    loop = closed(tip_exact(4.0, 0.3), canadarm())
    loop.run(4.0)
    assert loop.feedback is not None
    errors = loop.feedback.filter.errors
    assert errors is not None
    assert np.abs(errors.values).max() < 0.05


@pytest.mark.long
def test_lost_gauge_values_cost_little() -> None:
    loop = closed(tip_exact(), canadarm(0.9, 1.2))
    loop.lost = 0.3
    lossy = loop.run()
    assert lossy.rms < 2.0 * whole().rms
    assert lossy.after(3.0) < 2.0 * whole().after(3.0)
    assert (lossy.share[1000:] == 1.0).all()


@pytest.mark.long
def test_robot_that_was_let_go_in_the_middle_is_caught_again() -> None:
    loop = closed(tip_exact(), canadarm(0.9, 1.2))
    loop.gone = (3.5, 3.7)
    run = loop.run(9.0)
    assert run.error.max() > 0.1
    assert run.share[4500:].all()
    assert run.error[-1000:].max() < 0.02


@pytest.mark.long
def test_pauses_of_the_loop_do_not_lose_the_robot() -> None:
    planned = tip_exact(4.0, 0.3)
    loop = closed(planned, canadarm(0.9, 1.2))
    loop.stall = 0.004
    run = loop.run()
    assert run.error.max() < 0.1
    assert run.after(3.0) < 0.005
    assert (run.share[1000:] == 1.0).all()


@pytest.mark.long
def test_pauses_of_a_tenth_of_a_second_do_not_lose_the_robot() -> None:
    loop = closed(tip_exact(4.0, 0.3), canadarm(0.9, 1.2))
    # moving fast, moving slowly, and at the end, where errors of the model show no more
    loop.away = {0.7: 0.1, 2.2: 0.1, 4.5: 0.2}
    loop.backlog = 5  # what was measured meanwhile comes with the next ticks
    run = loop.run()
    # the estimate knows what the held torque did: nothing falls back (without leaving out what
    # was measured meanwhile, it is never believed again)
    assert (run.share[1000:] == 1.0).all()
    # 61 mm; when the estimate started anew after each pause, and took what it saw for errors of
    # the model, 112 mm after the first and 400 mm after the last, and growing
    assert run.error.max() < 0.1
    # 5.4 mm
    assert run.error[6500:].max() < 0.015
    assert loop.feedback is not None
    errors = loop.feedback.filter.errors
    assert errors is not None
    # the load's 0.37, 0.28 without pauses; all three had run to their bound of 0.4
    np.testing.assert_allclose(errors.values, [0.11, 0.11, 0.2], atol=0.25)


@pytest.mark.parametrize(
    ('seconds', 'backlog', 'moving'),
    [
        # 3.5 mm, then 0.2; 88 and 55 mm where gains for 1 ms went on with ticks 12 ms apart
        pytest.param(1.0, 0, 0.008, marks=pytest.mark.long),
        # 15 mm, 0.4; what was measured in a pause arrives in the three ticks after it
        (4.0, 3, 0.04),
    ],
)
def test_loop_that_is_slow_for_long_lets_go_and_takes_up_again(
    seconds: float, backlog: int, moving: float
) -> None:
    planned = tip_exact(source=described())
    loop = closed(planned, canadarm(0.9, 1.2, described(segments=8)))
    begin, now, rng = 4.0 - 0.5 * (seconds - 1.0), 0.0, np.random.default_rng(0)
    while now < seconds:
        loop.away[begin + now] = rng.uniform(0.004, 0.02)
        now += loop.away[begin + now] + rng.uniform(0.001, 0.006)
    loop.backlog = backlog
    run = loop.run()
    slow = slice(round((begin + 0.3) / PERIOD), round((begin + seconds) / PERIOD))
    assert not run.share[slow].any()
    assert run.share[-1] == 1.0
    assert run.rms < moving
    assert run.after(3.0) < 0.001


@pytest.mark.long
def test_feedback_comes_back_to_a_robot_that_has_drifted_meanwhile() -> None:
    planned = tip_exact(4.0, 0.3)
    loop = closed(planned, canadarm(0.9, 1.2))
    # with nothing but the plan on a wrong model the estimate by the joints goes astray as well
    loop.silent = (1.5, 2.2)
    run = loop.run()
    assert not run.share[1600:2200].any()
    assert run.error[1500:3000].max() > 0.05
    assert run.share[-1] == 1.0
    assert run.after(3.0) < 0.01


def stand_on_the_plan(
    planned: Planned, feedback: StateFeedback, tick: int, wild: int | None = None
) -> None:
    """Measure in one tick what the plan's first row has; the feedback must add no torque.

    `wild` is the place of a sensor whose value is off by 1.
    """
    now, q, qd = tick * PERIOD, planned.q[0], planned.qd[0]
    feedback.follow(now, q, qd)
    feedback.filter.take_joints(now, q[planned.robot.joint_indices], np.zeros(3))
    for place, value in enumerate(planned.robot.sensor_values(q, qd)):
        feedback.filter.take_sensor(place, now, value + (1.0 if place == wild else 0.0))
    assert not feedback.torque(now).any()
    feedback.applied(np.zeros(3))


def test_without_deviation_the_torque_is_exactly_the_plans() -> None:
    planned = tip_exact(4.0, 0.1)
    feedback = StateFeedback(planned.robot, planned.schedule())
    for k in range(1000):
        stand_on_the_plan(planned, feedback, k)
    assert feedback.share == 1.0


def test_silent_gauge_leaves_the_plan_alone_and_comes_back_without_a_jump() -> None:
    planned, truth = tip_exact(4.0, 0.1), canadarm(0.9, 1.2)
    loop = closed(planned, truth)
    begin, end = 2.0, 2.3
    loop.silent = (begin, end)
    run = loop.run(4.0)
    timeout = planned.schedule().settings.sensor_timeout
    fell = round((begin + timeout) / PERIOD)
    assert run.share[fell - 2] == 1.0
    # from the first tick after the timeout on nothing answers any more: the last torque fades
    quiet = slice(fell + 1, round(end / PERIOD))
    assert not run.share[quiet].any()
    gone = slice(fell + 1 + round(FADE / PERIOD), quiet.stop)
    np.testing.assert_array_equal(run.torque[gone], planned.torque[gone])
    added = run.torque - planned.torque[: len(run.torque)]
    before = np.abs(added[fell - 1]).max()
    assert before > 0.0
    fading = np.abs(np.diff(added[fell + 1 : gone.start], axis=0))
    assert fading.max() < 1.001 * before * PERIOD / FADE
    back = np.flatnonzero(run.share[quiet.stop :])[0] + quiet.stop
    assert 0.15 < back * PERIOD - end < 0.6
    assert run.share[back] <= 1.1 * PERIOD / RAMP
    full = np.flatnonzero(run.share[back:] == 1.0)[0]
    assert full * PERIOD > 0.9 * RAMP
    change = np.abs(np.diff(run.torque[back - 1 : back + full], axis=0))
    usual = np.abs(np.diff(run.torque[1000 : fell - 2], axis=0))
    assert change.max() < 1.2 * usual.max()


def test_feedback_keeps_to_its_limits_and_its_integrals_rest_there() -> None:
    planned = tip_exact(4.0, 0.1)
    feedback = StateFeedback(planned.robot, planned.schedule(limit=0.002))
    q, qd = planned.q[0], planned.qd[0]
    values = planned.robot.sensor_values(q, qd)
    most = 0.002 * planned.limits
    sums = []
    for k in range(1500):
        now = k * PERIOD
        feedback.follow(now, q, qd)
        # the joints drift away slowly enough for the gauges to believe it
        away, rate = (1e-3 * (now - 0.8), 1e-3) if now > 0.8 else (0.0, 0.0)
        joints = q[planned.robot.joint_indices] + away
        feedback.filter.take_joints(now, joints, np.full(3, rate))
        for place, value in enumerate(values):
            feedback.filter.take_sensor(place, now, value)
        torque = feedback.torque(now)
        assert (np.abs(torque) <= most).all()
        feedback.applied(torque)
        sums.append(feedback.integrals.copy())
    assert feedback.limited > 400
    # nothing winds up while the torque is at its limit
    np.testing.assert_array_equal(sums[1100], sums[-1])


def test_outliers_of_a_gauge_move_nothing_and_for_long_leave_the_plan_alone() -> None:
    planned = tip_exact(4.0, 0.1)
    feedback = StateFeedback(planned.robot, planned.schedule())
    for k in range(1400):
        stand_on_the_plan(planned, feedback, k, wild=2 if k % 10 == 0 or k > 1300 else None)
        if k == 1300:
            assert feedback.filter.believed
    assert not feedback.filter.believed
    assert feedback.filter.cause == 'no good values of link_2_y_root'
    assert feedback.filter.refused[2] > 200
