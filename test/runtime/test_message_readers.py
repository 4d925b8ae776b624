"""Bytes in, arrays out; and the prebuilt bytes that go out. No graph."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from small_robots import ARM
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.bags.sensor_messages import JointStateValues
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.model import tree as sensor_types
from denoc_ros.nodes.base.messages import (
    CommandMessage,
    FloatMessage,
    InertialMessage,
    PoseMessage,
    TrajectoryPointMessage,
)
from denoc_ros.nodes.sensor_inputs import Member, reader_of
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_readers import CommandReader, JointStateReader, MessageReader
from denoc_ros.runtime.inputs.trajectory_messages import has_many_points, read_trajectory

pytestmark = pytest.mark.ros

NAME = st.text(st.characters(codec='utf-8', exclude_characters='\0,'), min_size=1, max_size=12)
FINITE = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=100, deadline=None)
@given(
    names=st.lists(NAME, min_size=1, max_size=7, unique=True),
    frame=st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9),
    data=st.data(),
)
def test_joint_state_is_read_by_name_whatever_its_layout(
    names: list[str], frame: str, data: st.DataObject
) -> None:
    count = len(names)
    values = st.lists(FINITE, min_size=count, max_size=count)
    message = JointState(name=names, position=data.draw(values))
    message.header.frame_id = frame
    message.header.stamp.sec = 7
    message.velocity = data.draw(st.one_of(st.just([]), values))
    message.effort = data.draw(st.one_of(st.just([]), values))
    order = data.draw(st.permutations(names))
    reader = JointStateReader(order)
    for _ in range(2):  # learning the layout, and knowing it
        reader.read(serialize_message(message))
        places = [names.index(name) for name in order]
        np.testing.assert_array_equal(reader.position, np.array(message.position)[places])
        assert reader.has_velocity == bool(message.velocity)
        if message.velocity:
            np.testing.assert_array_equal(reader.velocity, np.array(message.velocity)[places])
        assert reader.stamp_ns == 7_000_000_000


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.booleans())
def test_random_bytes_are_refused_not_believed(noise: bytes, encapsulated: bool) -> None:
    raw = (b'\x00\x01\x00\x00' if encapsulated else b'') + noise
    readers: list[Any] = [
        JointStateReader(['a']).read,
        CommandReader(['a']).read,
        lambda each: read_trajectory(each, ['a']),
    ]
    for read in readers:
        with pytest.raises(InputError):
            read(raw)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10_000))
def test_a_cut_message_is_malformed(cut: int) -> None:
    message = JointState(name=['a', 'b'], position=[1.0, 2.0], velocity=[3.0, 4.0])
    raw = bytes(serialize_message(message))[: 4 + cut % 60]
    with pytest.raises(InputError):
        JointStateReader(['a', 'b']).read(raw)


def test_joints_of_the_robot_that_are_not_driven_may_come_along() -> None:
    message = JointState(name=['finger', 'b', 'a'], position=[9.0, 2.0, 1.0])
    reader = JointStateReader(['a', 'b'], known=['a', 'b', 'finger'])
    reader.read(serialize_message(message))
    assert reader.position.tolist() == [1.0, 2.0]
    message.name[0] = 'gripper'
    with pytest.raises(InputError, match='gripper'):
        reader.read(serialize_message(message))
    extra = JointStateReader(['a', 'b'], allow_extra=True)
    extra.read(serialize_message(message))
    assert extra.position.tolist() == [1.0, 2.0]


def test_velocity_or_effort_of_nan_counts_as_none() -> None:
    nan = float('nan')
    message = JointState(name=['b', 'a', 'finger'], position=[2.0, 1.0, nan])
    message.velocity, message.effort = [0.2, nan, 0.0], [3.0, 4.0, nan]
    reader = JointStateReader(['a', 'b'], allow_extra=True)
    reader.read(serialize_message(message), with_effort=True)
    assert (reader.has_velocity, reader.has_effort) == (False, True)
    assert reader.velocity.tolist() == [0.0, 0.0]
    assert reader.effort.tolist() == [4.0, 3.0]
    message.effort = [nan, nan, nan]
    reader.read(serialize_message(message))
    assert not reader.has_effort
    with pytest.raises(InputError, match='effort must be given, got NaN') as caught:
        reader.read(serialize_message(message), with_effort=True)
    assert caught.value.cause == 'missing_effort'
    for values in ('position', 'velocity', 'effort'):
        bad = JointState(name=['a', 'b'], position=[1.0, 2.0])
        setattr(bad, values, [1.0, nan if values == 'position' else float('inf')])
        with pytest.raises(InputError, match=f'{values} must be finite'):
            reader.read(serialize_message(bad))


def test_a_sensor_in_a_joint_state_is_read_as_effort_where_it_has_no_position() -> None:
    message = JointState(name=['a', 'cell'], position=[1.0, float('nan')], effort=[2.0, 3.0])

    def value() -> float:
        return JointStateValues()(MessageReader, serialize_message(message), ('cell', '', 0))[1]

    assert value() == 3.0
    message.position = [1.0, 5.0]
    assert value() == 5.0
    message.position, message.effort = [1.0, float('nan')], []
    assert np.isnan(value())


def test_sensor_of_a_new_type_takes_its_part_of_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    gyroscope = sensor_types.InertialSensorKind(('gyro',), 'sensor_msgs/msg/Imu')
    monkeypatch.setitem(sensor_types.INERTIAL_SENSORS, 'gyroscope', gyroscope)
    robot = load_robot(
        ARM.replace('<sensor', '<sensor name="g" type="gyroscope" link="tool"/><sensor', 1)
    )
    (sensor,) = robot.tree.inertial_sensors
    message = InertialMessage('sensor_msgs/msg/Imu', 'g', {})
    message.write(np.arange(6.0))
    member = Member(sensor, 0)
    assert member.types == ('sensor_msgs/msg/Imu',)
    assert reader_of(*member.types)(message.bytes(7), member) == (7, [0.0, 1.0, 2.0])


def test_big_endian_is_read_too() -> None:
    raw = b'\x00\x00\x00\x00' + struct.pack('>iI', 3, 500_000_000)
    assert MessageReader(raw).stamp_ns() == 3_500_000_000
    with pytest.raises(InputError, match='plain CDR'):
        MessageReader(b'\x00\x07\x00\x00')


def point(seconds: int, *rows: list[float]) -> JointTrajectoryPoint:
    names = ('positions', 'velocities', 'accelerations', 'effort')
    made = JointTrajectoryPoint(**dict(zip(names, rows, strict=False)))
    made.time_from_start.sec = seconds
    return made


def test_numbers_of_a_joint_state_in_big_endian_are_those_of_its_machine() -> None:
    head = struct.pack('>iI', 3, 5) + struct.pack('>Ix3x', 1)  # stamp, no frame
    names = struct.pack('>II2s2x', 1, 2, b'a\0')
    numbers = struct.pack('>Id', 1, 1.5) + struct.pack('>IId', 0, 1, 2.5)  # no velocity
    reader = JointStateReader(['a'])
    reader.read(b'\x00\x00\x00\x00' + head + names + numbers)
    assert reader.stamp_ns == 3_000_000_005
    assert (reader.position.tolist(), reader.effort.tolist()) == ([1.5], [2.5])
    assert (reader.has_velocity, reader.has_effort) == (False, True)
    assert reader.position.dtype == np.dtype(np.float64)  # kernels take no other


def test_who_takes_an_array_of_a_message_may_keep_it() -> None:
    reader = JointStateReader(['a', 'b'])
    kept = []
    for value in (1.0, 2.0):
        message = JointState(name=['b', 'a'], position=[value] * 2, velocity=[value] * 2)
        reader.read(serialize_message(message))
        kept += [reader.position, reader.velocity]
    assert [each.tolist() for each in kept] == [[1.0] * 2] * 2 + [[2.0] * 2] * 2


def test_points_of_a_trajectory_are_counted_without_reading_them() -> None:
    message = JointTrajectory(joint_names=['a'], points=[point(0, [1.0])])
    message.header.frame_id = 'base'
    assert not has_many_points(serialize_message(message))
    message.points = [point(0, [1.0]), point(1, [2.0])]
    raw = serialize_message(message)
    assert has_many_points(raw)
    assert not has_many_points(raw[:20])


def test_trajectory_is_read_in_the_nodes_joint_order() -> None:
    message = JointTrajectory(joint_names=['b', 'a'])
    message.points = [point(0, [2.0, 1.0], [4.0, 3.0]), point(2, [6.0, 5.0], [8.0, 7.0])]
    read = read_trajectory(serialize_message(message), ['a', 'b'])
    assert read.times.tolist() == [0.0, 2.0]
    assert read.positions.tolist() == [[1.0, 2.0], [5.0, 6.0]]
    assert read.velocities is not None
    assert read.velocities.tolist() == [[3.0, 4.0], [7.0, 8.0]]
    assert read.accelerations is None
    assert not read.is_streamed


def test_trajectory_may_name_some_joints_or_have_no_points_where_that_is_allowed() -> None:
    message = JointTrajectory(joint_names=['c', 'a'], points=[point(1, [3.0, 1.0], [0.3, 0.1])])
    raw = serialize_message(message)
    read = read_trajectory(raw, ['a', 'b', 'c', 'd'], partial=True)
    assert read.held == (1, 3)
    assert read.positions.tolist() == [[1.0, 0.0, 3.0, 0.0]]
    assert read.velocities is not None
    assert read.velocities.tolist() == [[0.1, 0.0, 0.3, 0.0]]
    whole = read.holding(np.array([9.0, 8.0, 7.0, 6.0]))
    assert whole.positions.tolist() == [[1.0, 8.0, 3.0, 6.0]]
    for names, cause in ((['x', 'a'], 'unknown_joint'), ([], 'missing_joint')):
        message.joint_names = names
        with pytest.raises(InputError) as caught:
            read_trajectory(serialize_message(message), ['a', 'b'], partial=True)
        assert caught.value.cause == cause
    none = read_trajectory(serialize_message(JointTrajectory()), ['a', 'b'], partial=True)
    assert none.is_cancel
    assert not read.is_cancel


BAD_TRAJECTORIES = {
    'empty': JointTrajectory(joint_names=['a']),
    'unknown_joint': JointTrajectory(joint_names=['a', 'x'], points=[point(0, [1.0, 1.0])]),
    'missing_joint': JointTrajectory(joint_names=[], points=[point(0, [])]),
    'repeated_joint': JointTrajectory(joint_names=['a', 'a'], points=[point(0, [1.0, 1.0])]),
    'wrong_length': JointTrajectory(joint_names=['a'], points=[point(0, [1.0], [1.0, 2.0])]),
    'non_finite': JointTrajectory(joint_names=['a'], points=[point(0, [1.0], [float('inf')])]),
    'times_not_increasing': JointTrajectory(
        joint_names=['a'], points=[point(1, [1.0]), point(1, [1.0])]
    ),
}


@pytest.mark.parametrize('cause', BAD_TRAJECTORIES)
def test_a_bad_trajectory_is_refused_by_cause(cause: str) -> None:
    with pytest.raises(InputError) as caught:
        read_trajectory(serialize_message(BAD_TRAJECTORIES[cause]), ['a'])
    assert caught.value.cause == cause


def command(label: str, values: list[float]) -> bytes:
    message = Float64MultiArray(data=values)
    if label:
        message.layout.dim = [MultiArrayDimension(label=label, size=len(values))]
    return bytes(serialize_message(message))


def test_commands_are_read_by_label() -> None:
    reader = CommandReader(['a', 'b', 'c'])
    for _ in range(2):
        reader.read(command('c,a', [3.0, 1.0]))
        assert reader.values.tolist() == [1.0, 0.0, 3.0]
    good = command('c,a', [3.0, 1.0])
    for bad, cause in ((command('c,a', [3.0]), 'wrong_length'), (good[:-8], 'malformed')):
        with pytest.raises(InputError) as caught:
            reader.read(bad)
        assert caught.value.cause == cause
        reader.read(good)
    reader.read(command('b', [4.0]))
    assert reader.values.tolist() == [0.0, 4.0, 0.0]


@pytest.mark.parametrize(
    ('cause', 'label', 'values'),
    [
        ('unnamed', '', [1.0]),
        ('unknown_joint', 'a,x', [1.0, 2.0]),
        ('repeated_joint', 'a,a', [1.0, 2.0]),
        ('wrong_length', 'a,b', [1.0]),
        ('non_finite', 'a', [float('nan')]),
    ],
)
def test_bad_commands_are_refused_by_cause(cause: str, label: str, values: list[float]) -> None:
    reader = CommandReader(['a', 'b'])
    with pytest.raises(InputError) as caught:
        reader.read(command(label, values))
    assert caught.value.cause == cause
    assert reader.values.tolist() == [0.0, 0.0]


def test_prebuilt_messages_say_what_is_written_into_them() -> None:
    state = JointStateMessage(['a', 'longer name', 'c'], ('position', 'effort'), 'base')
    state.position[:] = 1.0, 2.0, 3.0
    state.effort[:] = 4.0, 5.0, 6.0
    read = deserialize_message(state.bytes(1_234_567_891_011), JointState)
    assert (read.name, read.header.frame_id) == (['a', 'longer name', 'c'], 'base')
    assert list(read.position) + list(read.effort) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert list(read.velocity) == []
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (1234, 567891011)

    commands = CommandMessage(['a', 'b'])
    commands.values[:] = 7.0, 8.0
    array = deserialize_message(commands.bytes(), Float64MultiArray)
    assert (array.layout.dim[0].label, list(array.data)) == ('a,b', [7.0, 8.0])

    single = TrajectoryPointMessage(['a', 'b'])
    single.accelerations[:] = 9.0, 10.0
    single.effort[:] = 11.0, 12.0
    trajectory = deserialize_message(single.bytes(), JointTrajectory)
    assert list(trajectory.points[0].accelerations) == [9.0, 10.0]
    assert list(trajectory.points[0].effort) == [11.0, 12.0]
    assert list(trajectory.points[0].positions) == [0.0, 0.0]

    number = FloatMessage()
    number.values[0] = 13.0
    assert deserialize_message(number.bytes(), Float64).data == 13.0

    pose = PoseMessage('base')
    pose.values[:3] = 1.0, 2.0, 3.0
    read_pose = deserialize_message(pose.bytes(), PoseStamped).pose
    assert (read_pose.position.z, read_pose.orientation.w) == (3.0, 1.0)
