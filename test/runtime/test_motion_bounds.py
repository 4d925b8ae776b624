"""What a robot's joints cannot have is refused at the border, by its cause. No graph."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.model.tree import Limits
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_readers import CommandReader, JointStateReader
from denoc_ros.runtime.inputs.trajectory_messages import has_many_points, read_trajectory
from denoc_ros.runtime.reference.reference import FiniteDifferencer
from denoc_ros.runtime.safety.motion_bounds import MotionBounds

pytestmark = pytest.mark.ros
JOINTS = ['a', 'b', 'c']
# with limits; continuous; limits and rate that leave no motion, as in many files
LIMITS = [Limits(-3.0, 3.0, 2.0), Limits(), Limits(0.0, 0.0, 0.0)]


def bounds() -> MotionBounds:
    return MotionBounds(JOINTS, LIMITS, margin=1.0, farthest=1e6, factor=10.0)


def state(position: list[float], velocity: list[float] | None = None) -> bytes:
    message = JointState(name=JOINTS, position=position, velocity=velocity or [])
    return bytes(serialize_message(message))


def trajectory(*rows: tuple[float, Any], names: list[str] = JOINTS) -> bytes:
    message = JointTrajectory(joint_names=names)
    for seconds, values in rows:
        made = JointTrajectoryPoint(**dict(zip(('positions', 'velocities', 'accelerations'),
                                               values, strict=False)))  # fmt: skip
        made.time_from_start.sec = int(seconds)
        made.time_from_start.nanosec = round(1e9 * (seconds - int(seconds)))
        message.points.append(made)
    return bytes(serialize_message(message))


def test_a_robot_may_sit_somewhat_beyond_its_limits() -> None:
    reader = JointStateReader(JOINTS, bounds=bounds())
    for position in ([3.9, 9e5, -9e5], [-3.9, -9e5, 9e5]):
        reader.read(state(position, [19.0, 9e3, -9e3]))
        assert reader.position.tolist() == position


@pytest.mark.parametrize(
    ('position', 'velocity', 'says'),
    [
        ([4.1, 0.0, 0.0], [], 'a: position must be from -4 to 4, got 4.1'),
        ([0.0, 1.7e308, 1.7e308], [], 'b: position must be from -1e+06 to 1e+06'),
        ([0.0] * 3, [0.0, 0.0, -1e5], 'c: velocity must be from -10000 to 10000'),
        ([0.0] * 3, [21.0, 0.0, 0.0], 'a: velocity must be from -20 to 20, got 21'),
    ],
)
def test_joint_states_that_the_robot_cannot_have_are_refused(
    position: list[float], velocity: list[float], says: str
) -> None:
    reader = JointStateReader(JOINTS, bounds=bounds())
    reader.read(state([0.1, 0.2, 0.3]))
    with pytest.raises(InputError, match='must be') as refused:
        reader.read(state(position, velocity))
    assert refused.value.cause == 'out_of_range'
    assert says in str(refused.value)
    assert reader.position.tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ('rows', 'what'),
    [
        ([(0.0, [[1e4, 0.0, 0.0]])], 'position'),
        ([(0.0, [[0.0] * 3]), (1.0, [[0.0, 1e300, 0.0]])], 'position'),
        ([(0.0, [[0.0] * 3, [0.0, 1e5, 0.0]])], 'velocity'),
        ([(0.0, [[0.0] * 3] * 2 + [[0.0, 0.0, 2e6]])], 'acceleration'),
        # there and back within reach, faster than any of its joints
        ([(0.0, [[0.0] * 3]), (1.0, [[0.0, 5e5, 0.0]])], 'mean velocity'),
    ],
)
def test_references_that_the_robot_cannot_follow_are_refused(rows: Any, what: str) -> None:
    with pytest.raises(InputError, match=what) as refused:
        read_trajectory(trajectory(*rows), JOINTS, bounds())
    assert refused.value.cause == 'out_of_range'


def test_points_too_close_in_time_have_no_rates_to_difference() -> None:
    stream = FiniteDifferencer(3, 0.2, bounds=bounds())
    stream.complete(1.0, np.zeros(3), None, None)
    with pytest.raises(InputError, match='velocity'):
        stream.complete(1.0 + 1e-9, np.ones(3), None, None)
    _, rate, _ = stream.complete(1.1, np.ones(3), None, None)  # against the good one
    np.testing.assert_allclose(rate, 10.0)


def test_commands_that_no_robot_has_are_refused() -> None:
    reader = CommandReader(['a'])
    message = Float64MultiArray(data=[1e300])
    message.layout.dim = [MultiArrayDimension(label='a', size=1)]
    with pytest.raises(InputError, match='within 1e') as refused:
        reader.read(bytes(serialize_message(message)))
    assert refused.value.cause == 'out_of_range'


def test_every_way_to_lay_points_out_is_read() -> None:
    rng = np.random.default_rng(3)
    for names in (['a'], ['ab', 'c'], ['a', 'b', 'c']):
        for columns in (1, 2, 3):
            for count in (1, 2, 3, 40):
                values = rng.normal(size=(count, columns, len(names)))
                times = np.cumsum(rng.integers(1, 10**9, count)) * 1e-9
                rows = [(float(t), each.tolist()) for t, each in zip(times, values, strict=True)]
                read = read_trajectory(trajectory(*rows, names=names), names)
                np.testing.assert_allclose(read.times, times, atol=1e-9)
                found = [read.positions, read.velocities, read.accelerations]
                for column, expected in enumerate(np.moveaxis(values, 1, 0)):
                    np.testing.assert_array_equal(found[column], expected)
                assert all(each is None for each in found[columns:])


@pytest.mark.parametrize('bad', [1, 2, 7])
def test_one_point_of_another_length_is_found(bad: int) -> None:
    rows = [(float(k), [[0.0] * 3, [0.0] * (2 if k == bad else 3)]) for k in range(8)]
    with pytest.raises(InputError, match='velocities must have 3 elements, got 2') as refused:
        read_trajectory(trajectory(*rows), JOINTS)
    assert refused.value.cause == 'wrong_length'
    cut = trajectory(*((float(k), [[0.0] * 3]) for k in range(8)))
    with pytest.raises(InputError, match='must have 8 whole points'):
        read_trajectory(cut[: len(cut) // 2], JOINTS)


def cause_of(read: Callable[[], object]) -> str:
    """Return why a message is refused, '' if it is not."""
    try:
        read()
    except InputError as error:
        return error.cause
    return ''


def test_reading_is_quick_whatever_comes() -> None:
    names = [f'joint_{k}' for k in range(300_000)]
    many = bytes(serialize_message(JointState(name=names)))
    long = trajectory(*((1e-3 * k, [[0.0] * 3]) for k in range(2000)))
    # 170 ms, 340 ms and 30 ms when they were read one by one
    for read, cause in (
        (lambda: JointStateReader(JOINTS, allow_extra=True).read(many), 'too_many_joints'),
        (lambda: read_trajectory(many, JOINTS), 'too_many_joints'),
        (lambda: read_trajectory(long, JOINTS, bounds()), ''),
        (lambda: has_many_points(many), ''),
    ):
        best = math.inf
        for _ in range(5):
            begin = time.thread_time()
            assert cause_of(read) == cause
            best = min(best, time.thread_time() - begin)
        assert best < 5e-3


def test_a_refusal_is_short_whatever_it_is_about() -> None:
    with pytest.raises(InputError, match='joint must be one of') as refused:
        JointStateReader(['a']).read(bytes(serialize_message(JointState(name=['x' * 10**6]))))
    assert len(str(refused.value)) <= 500
