"""Joint states in bulk: the same arrays as message by message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from denoc_ros.bags.definitions import encode
from denoc_ros.bags.joint_state import FIELDS
from denoc_ros.bags.reader import read_bag, read_raw
from denoc_ros.bags.series import JointSeries, JointStateColumns
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
# What a publisher may do from one message to the next: drop a field, name others, turn them round.
SHAPES = [
    (['j1', 'j2', 'j3'], ('position', 'velocity', 'effort')),
    (['j1', 'j2', 'j3'], ('position',)),
    (['j3', 'j1', 'j2'], ('position', 'effort')),
    (['a_longer_name', 'j1'], ('velocity',)),
    ([], ()),
]


def in_bulk(path: Path) -> JointSeries:
    columns = JointStateColumns('/joint_states')
    for _, _, log_ns, raw in read_raw(path):
        columns.append(raw, log_ns)
    return columns.series()


def message_by_message(path: Path) -> list[tuple[int, dict[str, dict[str, float]]]]:
    """Return stamp and values by joint and field of each message, as it is decoded."""
    found = []
    for item in read_bag(path):
        joints: dict[str, dict[str, float]] = {name: {} for name in item.message.name}
        for field in FIELDS:
            for name, value in zip(item.message.name, getattr(item.message, field), strict=False):
                joints[name][field] = float(value)
        found.append((item.stamp_ns, joints))
    return found


def test_arrays_are_those_of_message_by_message(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    path = tmp_path / 'bag.mcap'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(60):
            names, present = SHAPES[random.integers(len(SHAPES))]
            fields = {field: random.normal(size=len(names)) for field in present}
            bag.write_message('/joint_states', 10**9 + k * 10**6, name=names, **fields)
    single = message_by_message(path)
    for bulk in (in_bulk(path),):
        assert set(bulk.names) == {name for _, told in single for name in told}
        assert bulk.stamp_ns.tolist() == [stamp for stamp, _ in single]
        for row, (_, told) in enumerate(single):
            for column, name in enumerate(bulk.names):
                for field in FIELDS:
                    expected = told.get(name, {}).get(field, np.nan)
                    found = getattr(bulk, field)[row, column]
                    assert found == expected or np.isnan([found, expected]).all()


def test_bytes_behind_the_message_are_passed_over() -> None:
    columns = JointStateColumns('/joint_states')
    raw = encode(JOINT_STATE, 5, {'name': ['j1'], 'position': [1.5]})
    columns.append(raw + b'\x07' * 8, 0)
    columns.append(raw, 0)
    np.testing.assert_array_equal(columns.series().position, [[1.5], [1.5]])


@pytest.mark.parametrize('cut', [3, 11, 20, 30, 60])
def test_a_cut_off_message_is_refused(cut: int) -> None:
    raw = encode(JOINT_STATE, 5, {'name': ['j1', 'j2'], 'position': [1.5, 2.5]})
    with pytest.raises(BagError, match=r'/joint_states: message must be a whole .* got \d+ bytes'):
        JointStateColumns('/joint_states').append(raw[:cut], 0)


def test_a_field_of_another_length_is_refused() -> None:
    raw = encode(JOINT_STATE, 5, {'name': ['j1', 'j2'], 'position': [1.5]})
    with pytest.raises(BagError, match=r'position must have as many values as name has \(2\)'):
        JointStateColumns('/joint_states').append(raw, 0)
