"""Bags of others, and what must not be taken for a bag."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from data_files import PANDA_BAG, UR10_BAG
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from denoc_ros.bags.definitions import encode, exact_cdr
from denoc_ros.bags.reader import bag_topics, read_attachment, read_bag
from denoc_ros.bags.recover import recover
from denoc_ros.bags.run import statuses
from denoc_ros.bags.series import read_arrays, read_joint_states
from denoc_ros.bags.writer import BagWriter
from denoc_ros.decompression import LARGEST_CHUNK
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
# each example overwrites the file of the one before
FUZZ = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def small_bag(tmp_path: Path) -> Path:
    """Return a bag with one message on each of three topics."""
    with BagWriter(tmp_path / 'small') as writer:
        writer.attach('robot_description.urdf', '<robot/>')
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.add_topic('/commands', 'std_msgs/msg/Float64MultiArray')
        writer.add_topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        header = {'stamp': {'sec': 3, 'nanosec': 7}}
        writer.write_message('/joint_states', 100, header=header, name=['a'], position=[1.0])
        writer.write_message('/joint_states', 200, header={}, name=['b', 'a'], effort=[2.0, 3.0])
        layout = {'dim': [{'label': 'a,b', 'size': 2}]}
        writer.write_message('/commands', 150, layout=layout, data=[4.0, 5.0])
        pairs = [{'key': 'overruns', 'value': '3'}]
        status = {'level': 1, 'name': 'loop', 'message': 'late', 'values': pairs}
        writer.write_message('/diagnostics', 250, status=[status, {'name': 'other'}])
    return tmp_path / 'small'


@pytest.mark.parametrize(('bag', 'count', 'joints'), [(UR10_BAG, 3441, 6), (PANDA_BAG, 727, 7)])
def test_bare_db3_of_a_real_robot_is_read(bag: Path, count: int, joints: int) -> None:
    assert bag_topics(bag) == {'/joint_states': JOINT_STATE}
    series = read_joint_states(bag)
    assert series.position.shape == series.effort.shape == (count, joints)
    assert np.isfinite([series.position, series.velocity, series.effort]).all()
    assert (np.diff(series.t) > 0).all()
    by_log_time = read_joint_states(bag, stamp='log')
    np.testing.assert_array_equal(series.stamp_ns, by_log_time.stamp_ns)


def test_folder_with_one_db3_and_no_metadata_is_read(tmp_path: Path) -> None:
    shutil.copy(PANDA_BAG, tmp_path / 'a.db3')
    assert len(list(read_bag(tmp_path))) == 727


def test_stamp_is_the_headers_or_the_log_time(small_bag: Path) -> None:
    topics = ['/joint_states', '/commands']
    by_header = [item.stamp_ns for item in read_bag(small_bag, topics)]
    by_log = [item.stamp_ns for item in read_bag(small_bag, topics, stamp='log')]
    # no header, or a zero stamp: the log time
    assert by_header == [3_000_000_007, 150, 200]
    assert by_log == [100, 150, 200]


def test_joints_are_matched_by_name_and_missing_fields_are_nan(small_bag: Path) -> None:
    series = read_joint_states(small_bag, names=['b', 'a'])
    np.testing.assert_array_equal(series.position, [[np.nan, 1.0], [np.nan, np.nan]])
    np.testing.assert_array_equal(series.effort, [[np.nan, np.nan], [2.0, 3.0]])
    assert np.isnan(series.velocity).all()
    assert read_joint_states(small_bag).names == ('a', 'b')


def test_joint_states_are_read_without_a_message_object_each(
    small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = read_joint_states(small_bag)
    monkeypatch.setattr('denoc_ros.bags.reader.decode', None)  # takes most of the time of a bag
    again = read_joint_states(small_bag, names=['a', 'b'])
    np.testing.assert_array_equal(again.effort, expected.effort)


def test_arrays_and_diagnostics_are_read(small_bag: Path) -> None:
    _, arrays = read_arrays(small_bag, '/commands')
    assert arrays.names == ('a', 'b')
    np.testing.assert_array_equal(arrays.values, [[4.0, 5.0]])
    (item,) = read_bag(small_bag, ['/diagnostics'])
    first, second = statuses(item.stamp_ns, item.message)
    assert (first.name, first.level, first.values) == ('loop', 1, {'overruns': '3'})
    assert second.name == 'other'


def test_attachment_is_read_by_name(small_bag: Path) -> None:
    assert read_attachment(small_bag, 'robot_description.urdf') == b'<robot/>'
    with pytest.raises(BagError, match=r'one of robot_description\.urdf, got'):
        read_attachment(small_bag, 'other')


def test_wrong_requests_say_what_must_hold(small_bag: Path, tmp_path: Path) -> None:
    with pytest.raises(BagError, match='topics must be among /commands, /diagnostics'):
        list(read_bag(small_bag, ['/nothing']))
    with pytest.raises(BagError, match='stamp must be header or log'):
        read_bag(small_bag, stamp='now')  # type: ignore[arg-type]
    with pytest.raises(BagError, match='joints on /joint_states must be among a, b, got c'):
        read_joint_states(small_bag, names=['c'])
    with pytest.raises(BagError, match='must be of type sensor_msgs'):
        read_joint_states(small_bag, '/commands')
    with pytest.raises(BagError, match='must exist'):
        list(read_bag(tmp_path / 'none'))
    (tmp_path / 'text.txt').write_text('no bag')
    with pytest.raises(BagError, match=r'a \.mcap or a \.db3'):
        list(read_bag(tmp_path / 'text.txt'))
    (tmp_path / 'empty').mkdir()
    with pytest.raises(BagError, match=r'must hold metadata\.yaml'):
        list(read_bag(tmp_path / 'empty'))


def test_lengths_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.write_message('/joint_states', 1, name=['a', 'b'], position=[1.0])
        writer.add_topic('/commands', 'std_msgs/msg/Float64MultiArray')
        writer.write_message('/commands', 1, data=[1.0])
        writer.write_message('/commands', 2, data=[1.0, 2.0])
    with pytest.raises(BagError, match=r'as many values as name has \(2\) or none, got 1'):
        read_joint_states(tmp_path / 'run')
    with pytest.raises(BagError, match=r'must keep their length, got \[1, 2\]'):
        read_arrays(tmp_path / 'run', '/commands')


def test_bytes_that_rclpy_appends_are_passed_over(tmp_path: Path) -> None:
    raw = encode(JOINT_STATE, 5, {'name': ['a'], 'position': [1.5]})
    assert exact_cdr(JOINT_STATE, raw + 8 * b'\xa3') == raw
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.write('/joint_states', 1, raw + 8 * b'\xa3')
    np.testing.assert_array_equal(read_joint_states(tmp_path / 'run').position, [[1.5]])
    with pytest.raises(BagError, match='must begin as plain CDR, got 0900'):
        exact_cdr(JOINT_STATE, b'\x09\x00')


def test_unfinished_recording_names_the_way_out(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'run')
    writer.add_topic('/joint_states', JOINT_STATE)
    writer.write_message('/joint_states', 1, name=['a'])
    writer.flush()
    for path in (tmp_path / 'run', tmp_path / 'run' / 'run_0.mcap'):
        with pytest.raises(BagError, match=f'run: denoc recover {path}'):
            list(read_bag(path))
    writer.close()


def only_bag_errors(path: Path) -> None:
    """Read everything there is; anything but BagError fails the test."""
    with suppress(BagError):
        list(read_bag(path))
    with suppress(BagError):
        read_attachment(path, 'robot_description.urdf')


@settings(FUZZ, max_examples=60)
@given(
    content=st.binary(max_size=300), suffix=st.sampled_from(['.mcap', '.db3']), magic=st.booleans()
)
def test_random_bytes_raise_only_bag_errors(
    tmp_path: Path, content: bytes, suffix: str, magic: bool
) -> None:
    kind = b'\x89MCAP0\r\n' if suffix == '.mcap' else b'SQLite format 3\x00'
    path = tmp_path / f'bag{suffix}'
    path.write_bytes(kind + content + kind if magic else content)
    only_bag_errors(path)


@settings(FUZZ, max_examples=150)
@given(data=st.data())
def test_flipped_bytes_raise_only_bag_errors(small_bag: Path, data: st.DataObject) -> None:
    content = bytearray((small_bag / 'small_0.mcap').read_bytes())
    spots = st.integers(0, len(content) - 1)
    for spot in data.draw(st.lists(spots, min_size=1, max_size=6)):
        content[spot] = data.draw(st.integers(0, 255))
    path = small_bag.parent / 'flipped.mcap'
    path.write_bytes(content)
    only_bag_errors(path)


def test_a_chunk_that_would_fill_the_memory_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bomb', 'zstd') as writer:
        writer.add_topic('/a', 'std_msgs/msg/String')
        writer.write('/a', 1, b'\x00\x01\x00\x00' + bytes(LARGEST_CHUNK))
    assert (tmp_path / 'bomb' / 'bomb_0.mcap').stat().st_size < 100_000
    for read in (bag_topics, lambda path: list(read_bag(path))):
        with pytest.raises(BagError, match=f'at most {LARGEST_CHUNK} bytes, got 2684'):
            read(tmp_path / 'bomb')
    found = recover(tmp_path / 'bomb')
    assert (found.messages, found.damaged_chunks) == (0, 1)
