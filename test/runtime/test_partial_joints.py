"""Joint states of an arm and of its gripper in messages of their own, joined by joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor
from denoc_ros.runtime.inputs.joint_gate import JointSample
from denoc_ros.runtime.inputs.joint_input import JointInput
from denoc_ros.runtime.inputs.partial_joints import MOST_PARTS
from denoc_ros.runtime.safety.motion_bounds import MotionBounds

LINK = (
    '<link name="{0}"><inertial><mass value="1"/><origin xyz="0.1 0 0"/><inertia ixx="0.1" '
    'ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'
)
JOINT = (
    '<joint name="{2}" type="{3}"><parent link="{0}"/><child link="{1}"/><axis xyz="0 0 1"/>'
    '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
)
ROBOT = load_robot(
    '<robot name="arm"><link name="base"/>'
    + ''.join(map(LINK.format, ('upper', 'fore', 'tip')))
    + JOINT.format('base', 'upper', 'shoulder', 'revolute')
    + JOINT.format('upper', 'fore', 'elbow', 'revolute')
    + JOINT.format('fore', 'tip', 'finger', 'prismatic')
    + '</robot>'
)
JOINTS = ('shoulder', 'elbow', 'finger')
TIMEOUT = 0.1
BEGIN = 100.0


class Taker:
    """Joint states of the robot, taken message by message."""

    def __init__(self, joints: Sequence[str] = JOINTS) -> None:
        limits = [ROBOT.tree.joints[name].limits for name in joints]
        bounds = MotionBounds(joints, limits, 0.1, 1e3, 2.0)
        self.input = JointInput(ROBOT, joints, bounds, False, timeout=lambda: TIMEOUT)
        self.monitor = InputMonitor('joint_states')
        self.samples: list[JointSample] = []
        self.refused: list[str] = []

    def take(self, t: float, stamped: float | None = None, **joints: tuple[float, ...]) -> None:
        """Take a message at a time [s]: position, velocity, effort by joint, as far as given."""
        count = len(next(iter(joints.values())))
        fields = ('position', 'velocity', 'effort')[:count]
        columns = [np.array(column) for column in zip(*joints.values(), strict=True)]
        stamp_ns = round(1e9 * (BEGIN + (t if stamped is None else stamped)))
        raw = JointStateMessage(list(joints), fields).encode(stamp_ns, *columns)
        try:
            self.samples += self.input.take(raw, BEGIN + t, self.monitor, lambda *_: None)
        except InputError as error:
            self.refused.append(error.cause)


def test_states_of_the_arm_have_the_gripper_where_its_last_messages_lead_it() -> None:
    taker = Taker()
    for k in range(100):
        t = 0.004 * k
        if k % 10 == 0:
            taker.take(t, finger=(0.5 * t,))
        taker.take(t, shoulder=(np.sin(t), np.cos(t)), elbow=(np.cos(t), -np.sin(t)))
    # nothing counts before all joints have come; each message of the arm after that makes a state
    assert taker.refused == ['missing_joint']
    assert taker.monitor.accepted == len(taker.samples) == 100
    for k, sample in enumerate(taker.samples):
        t = 0.004 * k
        assert sample.time == pytest.approx(BEGIN + t)
        np.testing.assert_allclose(sample.position[:2], [np.sin(t), np.cos(t)])
        assert sample.velocity is not None
        np.testing.assert_allclose(sample.velocity[:2], [np.cos(t), -np.sin(t)])
        if k >= 10:
            np.testing.assert_allclose(sample.position[2], 0.5 * t, atol=1e-6)
            np.testing.assert_allclose(sample.velocity[2], 0.5, atol=1e-4)


def test_a_state_is_refused_while_a_joint_s_last_message_is_stale() -> None:
    taker = Taker()
    taker.take(0.0, finger=(0.0, 0.0))
    for k in range(100):
        taker.take(0.004 * k, shoulder=(0.0, 0.0), elbow=(0.0, 0.0))
    assert 24 <= len(taker.samples) <= 26
    assert set(taker.refused[1:]) == {'missing_joint'}
    taker.take(0.4, finger=(0.0, 0.0))
    before = len(taker.samples)
    taker.take(0.401, shoulder=(0.0, 0.0), elbow=(0.0, 0.0))
    assert len(taker.samples) == before + 1


def test_efforts_count_where_each_joint_has_one() -> None:
    taker = Taker()
    for k in range(5):
        taker.take(0.004 * k, finger=(0.0, 0.0, 3.0) if k > 2 else (0.0, 0.0))
        taker.take(0.004 * k, elbow=(0.0, 0.0, 1.0), shoulder=(0.0, 0.0, 2.0))
    efforts = [sample.effort for sample in taker.samples]
    assert efforts[:3] == [None] * 3
    for effort in efforts[3:]:
        assert effort is not None
        np.testing.assert_array_equal(effort, [2.0, 1.0, 3.0])


def test_whole_messages_pass_as_they_are() -> None:
    taker = Taker()
    for k in range(10):
        taker.take(0.004 * k, elbow=(0.1, 0.0), finger=(0.2, 0.0), shoulder=(0.3, 0.0))
    assert not taker.refused
    for sample in taker.samples:
        np.testing.assert_array_equal(sample.position, [0.3, 0.1, 0.2])


def test_messages_of_joints_that_do_not_count_are_left_alone() -> None:
    taker = Taker(('shoulder', 'elbow'))
    for k in range(10):
        taker.take(0.004 * k, elbow=(0.1, 0.0), shoulder=(0.3, 0.0))
        taker.take(0.004 * k, finger=(0.1, 0.0))
    assert not taker.refused
    assert len(taker.samples) == 10


@pytest.mark.parametrize(
    ('later', 'joints', 'cause'),
    [
        (0.1, {'wheel': (0.0,)}, 'unknown_joint'),
        (0.1, {'finger': (np.nan,)}, 'non_finite'),
        (0.0, {'finger': (0.0,)}, 'duplicate'),
        (-0.1, {'finger': (0.0,)}, 'backwards_stamp'),
    ],
)
def test_a_wrong_part_is_refused_and_changes_nothing(
    later: float, joints: dict[str, tuple[float, ...]], cause: str
) -> None:
    taker = Taker()
    taker.take(0.0, shoulder=(0.0, 0.0), elbow=(0.0, 0.0))
    taker.take(0.0, finger=(0.2, 0.0))
    taker.take(0.01, stamped=later, **joints)
    assert taker.refused == ['missing_joint', cause]
    taker.take(0.02, shoulder=(0.0, 0.0), elbow=(0.0, 0.0))
    np.testing.assert_array_equal(taker.samples[-1].position, [0.0, 0.0, 0.2])


def test_a_part_beyond_the_bounds_makes_no_state() -> None:
    taker = Taker()
    taker.take(0.0, finger=(50.0, 0.0))
    taker.take(0.01, shoulder=(0.0, 0.0), elbow=(0.0, 0.0))
    assert taker.refused == ['missing_joint', 'out_of_range']
    assert not taker.samples


def test_messages_of_ever_new_sets_of_joints_keep_nobody_out() -> None:
    taker = Taker()
    bounds = MotionBounds(JOINTS, [ROBOT.tree.joints[name].limits for name in JOINTS], 0.1, 1e3, 2)
    taker.input = JointInput(ROBOT, JOINTS, bounds, True, timeout=lambda: TIMEOUT)
    for k in range(3 * MOST_PARTS):
        taker.take(0.001 * k, 0.001 * k, **{'finger': (0.0,), f'other_{k}': (0.0,)})
    taker.take(0.04, finger=(0.0, 0.0))
    taker.take(0.05, shoulder=(0.0, 0.0), elbow=(0.0, 0.0))
    assert len(taker.samples) == 1
