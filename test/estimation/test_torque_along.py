"""Terms of the torque: each is what its name says, and a new motion starts in equilibrium."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_bags import SimulatedBag
from truth_robots import truth_case

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import BagError
from denoc_ros.estimation.joint_motion import SmoothedMotion
from denoc_ros.estimation.torque_along import TorqueReplay, Torques
from denoc_ros.model.joint_friction import Friction
from denoc_ros.simulation.recorded.replay_bag import replay_bag
from denoc_ros.simulation.recorded.replay_settings import ReplaySettings
from denoc_ros.simulation.recorded.replay_summary import doubts
from denoc_ros.simulation.recorded.residual_friction import FrictionFit

ROWS = 30
STARTS = np.arange(ROWS) == 0


@pytest.fixture
def arm(repository: Path) -> Robot:
    """A rigid arm of six joints with friction."""
    robot = load_robot(repository / 'config/robots/puma.urdf')
    return robot.with_overrides(
        {
            'joint.joint_1.damping': 2.0,
            'joint.joint_2.friction': 3.0,
            'joint.joint_3.armature': 0.5,
        }
    )


def wild(robot: Robot, rates: float = 1.0, accelerations: float = 1.0) -> SmoothedMotion:
    rng = np.random.default_rng(4)
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, ROWS, len(robot.joint_names)))
    return SmoothedMotion(q, rates * qd, accelerations * qdd)


def terms(robot: Robot, motion: SmoothedMotion, friction: Friction | None = None) -> Torques:
    t = 0.01 * np.arange(ROWS, dtype=np.float64)
    return TorqueReplay(robot, robot.joint_names, friction=friction).torques(t, motion, STARTS)


def test_terms_are_what_their_names_say(arm: Robot) -> None:
    motion = wild(arm)
    parts = terms(arm, motion).parts
    zero = np.zeros(motion.q.shape)
    np.testing.assert_allclose(parts['gravity'], arm.inverse_dynamics(motion.q, zero, zero))
    inertia = np.einsum('kij,kj->ki', arm.inertia_matrix(motion.q), motion.qdd)
    # rounding of differences of torques of some hundred N m
    np.testing.assert_allclose(parts['inertia'], inertia, atol=1e-10)
    expected = 2.0 * motion.qd[:, 0]
    np.testing.assert_allclose(parts['friction'][:, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(parts['friction'][:, 1], 3.0 * np.sign(motion.qd[:, 1]), rtol=1e-6)
    # centrifugal and Coriolis torques go with the square of the rates
    double = terms(arm, wild(arm, rates=2.0)).parts['coriolis']
    np.testing.assert_allclose(double, 4.0 * parts['coriolis'], atol=1e-9)
    whole = arm.inverse_dynamics(motion.q, motion.qd, motion.qdd)
    np.testing.assert_allclose(np.sum(list(parts.values()), axis=0), whole, atol=1e-10)


def test_given_friction_stands_for_the_robot_s_own(arm: Robot) -> None:
    joints = len(arm.joint_names)
    law = Friction(np.full(joints, 0.7), np.full(joints, 0.2), np.linspace(-1.0, 1.0, joints))
    motion = wild(arm)
    own, given = terms(arm, motion), terms(arm, motion, law)
    expected = own.best - own.parts['friction'] + law.force(motion.qd) + law.offset
    np.testing.assert_allclose(given.best, expected, atol=1e-10)


def test_a_new_motion_starts_in_equilibrium(simulated_bag: SimulatedBag) -> None:
    robot = simulated_bag.robot
    t = 0.004 * np.arange(ROWS, dtype=np.float64)
    q = np.column_stack([np.sin(9.0 * t), 0.3 * np.cos(9.0 * t)])
    motion = SmoothedMotion(q, np.gradient(q, t, axis=0), -81.0 * q)
    model = TorqueReplay(robot, robot.joint_names)
    found = model.torques(t, motion, STARTS | (np.arange(ROWS) == 20)).amplitudes
    assert found is not None
    rest = robot.static_deflection(q)
    off = np.abs(found[0] - rest).max(axis=1)
    # the tolerance of the iteration that finds an equilibrium
    assert max(off[0], off[20]) < 1e-9
    # in between the joints' accelerations bend the links
    assert (off[[10, 19, 29]] > 1e-4).all()


def test_lost_samples_do_not_pile_up_in_the_amplitudes(simulated_bag: SimulatedBag) -> None:
    robot, run = simulated_bag.robot, simulated_bag.run
    rng = np.random.default_rng(7)
    kept = np.sort(np.concatenate([[0, 1], 2 + rng.choice(497, 150, replace=False)]))
    t, joints = run.t[kept], robot.joint_indices
    # accelerations that are worth nothing: the amplitudes must not go by them
    motion = SmoothedMotion(
        run.q[kept][:, joints], run.qd[kept][:, joints], np.zeros((len(kept), 2))
    )
    found = TorqueReplay(robot, robot.joint_names).torques(t, motion, np.arange(len(kept)) == 0)
    assert found.amplitudes is not None
    off = found.amplitudes[0] - run.q[kept]
    # up to 60 ms between samples of joints that turn at 3 rad/s
    assert np.abs(off).max() < 2e-3 * np.abs(run.q[:, robot.flexible_indices]).max()


def test_stamps_of_the_log_serve_where_those_of_messages_stand_still(tmp_path: Path) -> None:
    path = tmp_path / 'still.mcap'
    robot = load_robot(
        '<robot name="one"><link name="base"/><link name="arm"><inertial><mass value="1"/>'
        '<origin xyz="1 0 0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="j" type="continuous"><parent link="base"/>'
        '<child link="arm"/><axis xyz="0 0 1"/></joint></robot>'
    )
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(60):
            header = {'stamp': {'sec': 7, 'nanosec': 0}}
            t = 0.01 * k
            row = {'position': [t * t], 'velocity': [2.0 * t], 'effort': [2.0]}
            bag.write_message('/joint_states', 10**9 + k * 10**7, header=header, name=['j'], **row)
    with pytest.raises(BagError, match='59 not rising; stamps may be those of the log'):
        replay_bag(path, robot)
    found = replay_bag(path, robot, None, ReplaySettings(stamp='log'))
    # 1 kg at 1 m, 2 rad/s^2
    np.testing.assert_allclose(found.torque['rigid'].rms, 0.0, atol=1e-9)


def test_friction_that_drives_a_joint_is_doubtful(simulated_bag: SimulatedBag) -> None:
    found = replay_bag(simulated_bag.path, simulated_bag.robot)
    errors, size = np.full((2, 3), 0.1), np.ones((2, 3))
    law = Friction(np.array([-0.15, 1.0]), np.array([1.0, -0.3]), np.array([-9.0, 0.0]))
    one, count = np.ones(2), np.full(2, 500)
    fit = FrictionFit(law, errors, errors, size, one, one, one, count)
    # -0.15 may be chance, an offset may have either sign
    assert doubts(replace(found, friction=fit)) == [
        'joint_2: coulomb friction must be >= 0, the fit gives -0.3'
    ]
    small = replace(fit, size=1e-3 * size)
    assert doubts(replace(found, friction=small)) == []


def test_calls_for_many_rows_are_steps_one_by_one() -> None:
    """Two blocks of a motion of one of two joints, with a new start in each."""
    robot = truth_case(99).robot
    draw = np.random.default_rng(8)
    t = np.cumsum(draw.uniform(1e-3, 8e-3, 2 * ROWS))
    q = draw.uniform(-0.2, 0.2, 1) * np.sin(np.outer(9.0 * t, [1.0]))
    motion = SmoothedMotion(q, 9.0 * q, -81.0 * q)
    starts = np.isin(np.arange(2 * ROWS), [0, 7, ROWS + 4])
    found = []
    for is_one_by_one in (False, True):
        replay = TorqueReplay(robot, ['joint_2'], step=5e-4)
        assert replay._along is not None
        if is_one_by_one:
            replay._along = None
        blocks = []
        for rows in (slice(0, ROWS), slice(ROWS, 2 * ROWS)):
            part = SmoothedMotion(motion.q[rows], motion.qd[rows], motion.qdd[rows])
            blocks.append(replay.states(t[rows], part, starts[rows]))
        found.append(
            [np.concatenate(each, axis=each[0].ndim - 2) for each in zip(*blocks, strict=True)]
        )
    for own, other in zip(*found, strict=True):
        assert np.abs(other).max() > 1e-3
        # sums in another order
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())
