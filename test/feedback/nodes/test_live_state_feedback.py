"""Gains that come from beside the loop: when they are taken, kept, refused; no ROS graph."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from feedback_runs import CANADARM, PERIOD, START, Planned, canadarm, tip_exact

from denoc_ros.errors import StateError
from denoc_ros.feedback.live_state_feedback import LiveStateFeedback
from denoc_ros.runtime.inputs.trajectory_messages import TrajectoryMessage
from denoc_ros.runtime.parameters.feedforward_parameters import TABLE
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.reference.reference import ReferenceFollower
from denoc_ros.runtime.worker.worker import Planner

LIMITS = np.full(3, 5000.0)
JOINTS = ('joint_1', 'joint_2', 'joint_3')
SECOND = 1_000_000_000
LONG = 300.0  # s for a design, on a machine that is busy with others


def settings(**changes: Any) -> Settings:
    given = {'urdf_path': str(CANADARM), 'feedback.state': 'lqr'}
    given.update({name.replace('__', '.'): value for name, value in changes.items()})
    return TABLE.settings(given, 'test')


@pytest.fixture(scope='module')
def planner() -> Iterator[Planner]:
    """The process that designs: one for all, as it starts by compiling or loading kernels."""
    planner = Planner()
    yield planner
    planner.close()


class Bench:
    """State feedback with a follower, a clock of its own and a robot that is on its plan."""

    def __init__(self, planner: Planner, **changes: Any) -> None:
        self.live = LiveStateFeedback('/feedforward')
        self.live._worker.planner = planner
        self.follower = ReferenceFollower(3, 0.2)
        self.build(1.0, **changes)
        self.now = 0.0

    def build(self, stiffness: float, patience: float = 0.0, **changes: Any) -> None:
        self.robot = robot = canadarm(stiffness)
        changes |= {f'beam.link_{k}.y.ei': k * stiffness * 1e5 for k in (1, 2)}
        self.live.build(robot, JOINTS, settings(**changes), LIMITS, np.zeros(robot.n), patience)

    def offer(self, planned: Planned, start: float) -> None:
        """Give the whole trajectory of a plan that starts at a time [s]."""
        times, q, qd, qdd = planned.trajectory.table(0.05)
        message = TrajectoryMessage(round(start * SECOND), times, q, qd, qdd)
        self.follower.offer(message, self.now, round(self.now * SECOND), q[0])

    def watch(self, position: Any) -> None:
        """Look, and wait until what was begun is made."""
        end = time.perf_counter() + LONG
        self.live.watch(self.follower, np.asarray(position))
        while self.live._worker.busy:
            assert time.perf_counter() < end, 'the design must come to an end'
            time.sleep(0.002)
            self.live.watch(self.follower, np.asarray(position))

    def ticks(
        self, count: int, q: Any, off: float = 0.0, rates: bool = True, every: int = 1
    ) -> np.ndarray:
        """Return the torques (count, 3), measured each so many ticks; zero where none is."""
        live, robot, torques = self.live, self.robot, np.zeros((count, 3))
        state = np.zeros(robot.n)
        state[robot.joint_indices] = q
        zero, still = np.zeros(robot.n), np.zeros(3) if rates else None
        for k in range(count):
            self.now += PERIOD
            if k % every == 0:
                live.take_joints(self.now, self.now, self.now, np.asarray(q) + off, still)
                for place in range(4):
                    live.take_sensor(place, self.now, 0.0)
            torque = live.torque(self.now, 0.0, np.asarray(q), (state, zero, zero))
            if torque is not None:
                torques[k] = torque
            live.applied(torques[k])
        return torques


def test_gains_about_a_posture_are_made_anew_where_a_stream_has_gone(planner: Planner) -> None:
    bench = Bench(planner)
    assert not bench.ticks(1, START).any()
    assert bench.live.cause == 'no gains yet'
    bench.watch(START)
    bench.ticks(1000, START)
    assert bench.live.active
    assert bench.live.designs == 1
    bench.watch(START + 0.05)
    assert bench.live.designs == 1
    bench.watch(START + 0.15)
    assert bench.live.designs == 2
    # where nothing was shown there is no feedback
    assert not bench.ticks(5, START + 0.6, off=1e-3).any()
    assert bench.live.cause == 'no gains for this posture yet'
    bench.watch(START + 0.6)
    assert bench.ticks(800, START + 0.6, off=1e-5)[-1].any()


def test_joints_far_from_where_gains_hold_get_no_torque_and_begin_anew(planner: Planner) -> None:
    bench = Bench(planner)
    bench.watch(START)
    assert not bench.ticks(500, START, off=1.0).any()
    assert bench.live.cause.startswith('joints must be within 0.3 of where the gains are')
    # a robot that is set to where it is wanted
    assert not bench.ticks(500, START).any()
    assert bench.live.active


def test_gains_of_a_trajectory_are_taken_when_it_begins(planner: Planner) -> None:
    bench = Bench(planner)
    bench.watch(START)
    bench.ticks(1000, START)
    planned = tip_exact(4.0, 0.1)
    bench.offer(planned, bench.now + 0.5)
    bench.watch(START)
    assert bench.live.designs == 2
    bench.ticks(100, START)
    assert bench.live.postures == 1
    bench.ticks(500, START)
    assert bench.live.postures > 1
    # the estimate, and with it the feedback, went on
    assert bench.live.active
    assert bench.live.status().values['fallbacks'] == 0


def test_gains_of_a_trajectory_from_elsewhere_act_before_it_begins(planner: Planner) -> None:
    bench = Bench(planner)
    bench.watch(START + 0.6)
    bench.ticks(1000, START + 0.6)
    bench.offer(tip_exact(4.0, 0.1), bench.now + 2.0)
    bench.watch(START)
    assert bench.live.designs == 2
    bench.ticks(1000, START)
    assert bench.live.active
    assert bench.live.postures > 1


def test_joint_states_rarer_than_the_loop_knows_leave_the_plan_alone(planner: Planner) -> None:
    """Drives that are told as rarely hold a torque longer than the loop was proven stable for."""
    bench = Bench(planner)
    bench.watch(START)
    bench.ticks(1000, START, off=1e-5, every=2)
    assert bench.live.active
    bench.ticks(700, START, off=1e-5, every=5)
    assert 'joint states must come every' in bench.live.cause
    assert not bench.ticks(100, START, off=1e-5, every=5).any()
    bench.ticks(1000, START, off=1e-5)
    assert bench.live.active


def test_refused_gains_leave_the_plan_alone_and_say_why(planner: Planner) -> None:
    bench = Bench(planner)
    bench.watch(START)
    bench.ticks(1000, START)
    assert bench.live.active
    # at this posture the weights that were good at configure are not
    model = bench.live._model
    assert model is not None
    object.__setattr__(model, 'limits', np.zeros(3))
    refused = 'state feedback: effort limits must be finite and > 0, got [0.0, 0.0, 0.0]'
    bench.watch(START + 0.2)
    torques = bench.ticks(1000, START, off=1e-3)
    assert not torques[500:].any()
    status = bench.live.status()
    assert status.values['refused'] == refused
    assert status.values['fallbacks'] == 1
    assert refused in status.message


def test_changed_model_is_tried_where_the_robot_is_and_gets_new_gains(planner: Planner) -> None:
    bench = Bench(planner)
    bench.watch(START)
    bench.ticks(1000, START)
    bench.build(1.1)
    bench.ticks(1, START)
    assert bench.live.active
    bench.watch(START)
    assert bench.live.designs == 2
    bench.ticks(10, START)
    assert bench.live.active
    bench.build(1.0, feedback__integral_time=0.01)
    assert bench.ticks(10, START, off=1e-5)[-1].any()  # by the gains before, until it is tried
    assert bench.live.active
    bench.watch(START)
    bench.ticks(1, START)
    assert not bench.live.active
    assert 'must be stable for' in bench.live.status().values['refused']


def test_gains_that_are_no_good_are_refused_where_they_are_waited_for(planner: Planner) -> None:
    bench = Bench(planner)
    with pytest.raises(StateError, match='must be stable for'):
        bench.build(1.0, LONG, feedback__integral_time=0.01)


def steps(torques: np.ndarray, before: np.ndarray) -> float:
    """Return the largest change from one tick to the next [N m]."""
    return float(np.abs(np.diff(np.vstack((before, torques)), axis=0)).max())


@pytest.mark.long_cases('change0-True', 'change1-False', 'change2-False')
@pytest.mark.parametrize(
    ('change', 'ends'),
    [
        ({'feedback__state': 'off'}, True),
        ({'feedback__effort_share': 0.05}, False),
        ({'feedback__tip_error': 0.02}, False),
        ({'feedback__integral_time': 0.01}, True),  # refused
    ],
)
def test_what_leaves_does_not_jump_when_settings_change(
    planner: Planner, change: dict[str, Any], ends: bool
) -> None:
    bench = Bench(planner)
    bench.watch(START)
    torques = bench.ticks(2000, START, off=1e-5)
    usual, last = steps(torques[-1000:], torques[-1000]), torques[-1]
    size = np.abs(last).max()
    assert size > 0.05
    bench.build(1.0, **change)
    if change.get('feedback__state') != 'off':
        bench.watch(START)
    torques = bench.ticks(1000, START, off=1e-5)
    assert steps(torques, last) < usual + 0.01 * size  # the ramp of 0.5 s takes 500 ticks
    assert torques[-1].any() is not ends
    assert bench.live.wanted is (change.get('feedback__state') != 'off')
    bench.build(1.0)
    bench.watch(START)
    again = bench.ticks(2000, START, off=1e-5)
    assert steps(again, torques[-1]) < usual + 0.01 * size
    assert bench.live.active


def test_resting_forgets_and_comes_back_by_the_ramp(planner: Planner) -> None:
    bench = Bench(planner)
    bench.watch(START)
    assert bench.ticks(1000, START, off=1e-5)[-1].any()
    bench.live.rest()
    assert not bench.live.active
    again = bench.ticks(1000, START, off=1e-5)
    assert not again[:190].any()
    assert again[-1].any()


def test_ticks_without_joint_states_after_a_pause_cost_nothing(planner: Planner) -> None:
    bench = Bench(planner)
    bench.watch(START)
    bench.ticks(1000, START, off=1e-5)
    bench.now += 0.1  # the machine stood still: the loop is back before the robot
    state, zero = np.zeros(bench.robot.n), np.zeros(bench.robot.n)
    state[bench.robot.joint_indices] = START
    for _ in range(2):
        bench.now += PERIOD
        bench.live.wait(bench.now, 0.0, START, (state, zero, zero), np.zeros(3))
        assert not bench.live.active
        bench.live.applied(np.zeros(3))
    assert bench.ticks(1, START, off=1e-5).any()
    assert bench.live.active
    now = bench.live._now
    assert now is not None
    assert now.share == 1.0


def test_joints_without_rates_get_gains_of_their_own(planner: Planner) -> None:
    bench = Bench(planner)
    bench.watch(START)
    bench.ticks(10, START, rates=False)
    bench.watch(START)
    assert bench.live.designs == 2
    bench.ticks(1000, START, rates=False)
    assert bench.live.active
    gains = bench.live._now
    assert gains is not None
    assert not gains.schedule.gains[0].correction[:, 3:6].any()
    assert gains.schedule.slowest.modulus < 1.0


def test_torque_of_a_lower_rate_is_held_and_its_gains_are_for_that_rate(planner: Planner) -> None:
    bench = Bench(planner, feedback__rate=400.0)
    bench.watch(START)
    torques = bench.ticks(1000, START, off=1e-5)
    changes = np.flatnonzero(np.diff(torques[:, 0]))
    assert (np.diff(changes) % 2 == 0).all()
    assert len(changes) > 300
    assert bench.live._now is not None
    assert bench.live._now.schedule.settings.period == 2.0 * PERIOD
