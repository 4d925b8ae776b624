"""Rows and columns of a series keep together, whatever part of it is taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from denoc_ros.bags.run import read_run
from denoc_ros.bags.series import (
    ODOMETRY_NUMBERS,
    POSE_NUMBERS,
    Series,
    joint_state_blocks,
    read_joint_states,
    read_numbers,
)
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
STAMPS = (10, 20, 20, 15, 30, 40)  # ms
FIRST = [1.0, 2.0, 3.0, 4.0, np.nan, 6.0]


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / 'run.mcap'
    with BagWriter(path) as writer:
        for topic in ('/joint_states', '/late'):
            writer.add_topic(topic, JOINT_STATE)
        for k, (stamp, first) in enumerate(zip(STAMPS, FIRST, strict=True)):
            header = {'stamp': {'sec': 0, 'nanosec': 10**6 * stamp}}
            fields = {'header': header, 'name': ['a', 'b'], 'position': [first, -first]}
            writer.write_message('/joint_states', 10**6 * (10 + 6 * k), **fields)
        writer.write_message('/late', 35 * 10**6, name=['c'], effort=[1.0])
    return path


def test_a_row_is_taken_whole(bag: Path) -> None:
    series = read_joint_states(bag)
    rising = series.rising()
    np.testing.assert_array_equal(rising.position[:, 0], [1.0, 2.0, np.nan, 6.0])
    np.testing.assert_allclose(rising.t, [0.0, 0.01, 0.02, 0.03])
    assert rising.complete().position.tolist() == [[1.0, -1.0], [2.0, -2.0], [6.0, -6.0]]
    assert series.ascending().position[:3, 0].tolist() == [1.0, 4.0, 2.0]
    part = series.since(0).between(0.015, 0.02)
    assert part.position[:, 0].tolist() == [2.0, 3.0, 4.0]
    assert part.stamp_ns.tolist() == [20_000_000, 20_000_000, 15_000_000]


def test_a_column_that_is_not_there_is_nan(bag: Path) -> None:
    chosen = read_joint_states(bag).select(['b', 'c'])
    assert chosen.names == ('b', 'c')
    assert chosen.position[0, 0] == -1.0
    assert np.isnan(chosen.position[:, 1]).all()
    called = read_joint_states(bag).renamed({'a': 'left_a'})
    assert called.names == ('left_a', 'b')


def test_values_between_samples_are_on_the_line_and_none_beyond() -> None:
    series = Series(np.array([1.0, 0.0]), ('x',), np.array([[4.0], [2.0]]))
    np.testing.assert_allclose(series.at(np.array([0.5, 1.0, 1.5])), [[3.0], [4.0], [np.nan]])


def test_blocks_behind_each_other_are_the_whole(bag: Path) -> None:
    topics = ['/joint_states', '/late']
    blocks = list(joint_state_blocks(bag, topics, 4))
    assert [len(block['/joint_states'].t) for block in blocks] == [4, 2]
    (whole,) = joint_state_blocks(bag, topics)
    for topic in topics:
        joined = blocks[0][topic].followed_by(blocks[1][topic])
        np.testing.assert_array_equal(joined.position, whole[topic].position)
        np.testing.assert_array_equal(joined.stamp_ns, whole[topic].stamp_ns)


def test_all_topics_of_a_run_have_one_origin(bag: Path) -> None:
    run = read_run(bag)
    late = run.series('late', 'effort')
    assert late is not None
    assert late.t.tolist() == pytest.approx([0.025])
    assert run.series('late') is None
    assert run.counts == {'/joint_states': 6, '/late': 1}
    part = read_run(bag, ['joint_states'], (0.005, 0.025), rate=1e3)
    assert {len(part.joint_states[topic].t) for topic in part.joint_states} == {4}


def test_numbers_of_a_topic_of_another_type_are_refused(bag: Path) -> None:
    with pytest.raises(
        BagError, match=r'must be geometry_msgs/msg/.* or nav_msgs.* got sensor_msgs'
    ):
        read_numbers(bag, 'joint_states', POSE_NUMBERS | ODOMETRY_NUMBERS)
