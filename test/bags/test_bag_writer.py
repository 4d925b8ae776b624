"""What is written is what others read."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from denoc_ros.bags.definitions import encode, message_definition
from denoc_ros.bags.metadata import Qos
from denoc_ros.bags.reader import bag_contents, read_attachment, read_bag
from denoc_ros.bags.recover import recover
from denoc_ros.bags.run import read_run
from denoc_ros.bags.storage import DiskFile
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
FLOAT, TEXT = 'std_msgs/msg/Float64', 'std_msgs/msg/String'
VALUES: dict[str, Any] = {FLOAT: 2.5, TEXT: 'two'}
START_NS = 1_700_000_000_123_456_789


def joint_state(index: int) -> dict[str, Any]:
    """Return the fields of a message that its index tells from all others."""
    return {'name': ['j1', 'j2'], 'position': [index, 0.5], 'velocity': [], 'effort': [-1.0, 2e-3]}


def write_joint_states(writer: BagWriter, count: int, step_ns: int = 1_000_000) -> None:
    """Write messages 1 ms apart."""
    writer.add_topic('/joint_states', JOINT_STATE)
    for index in range(count):
        writer.write_message('/joint_states', START_NS + index * step_ns, **joint_state(index))


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_bytes_come_back_as_written_through_rosbags(tmp_path: Path, compression: str) -> None:
    raw = encode(JOINT_STATE, 5, joint_state(7)) + b'\xaa\xbb'  # rclpy may append such bytes
    with BagWriter(tmp_path / 'run', compression) as writer:
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.write('/joint_states', START_NS, raw, publish_ns=START_NS - 5)
    with Reader(tmp_path / 'run') as reader:
        [(connection, log_ns, found)] = reader.messages()
    assert (connection.topic, connection.msgtype, log_ns) == (
        '/joint_states',
        JOINT_STATE,
        START_NS,
    )
    assert found == raw


def test_fields_come_back_as_written_through_mcap_ros2_support(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run.mcap') as writer:
        write_joint_states(writer, 3)
        writer.add_topic('/commands', 'std_msgs/msg/Float64MultiArray')
        layout = {'dim': [{'label': 'j1,j2', 'size': 2, 'stride': 2}]}
        writer.write_message('/commands', START_NS, layout=layout, data=np.array([1.5, -2.5]))
    with (tmp_path / 'run.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = [
            (row.channel.topic, row.decoded_message) for row in reader.iter_decoded_messages()
        ]
        assert reader.get_header().profile == 'ros2'
        assert reader.get_header().library.startswith('denoc_ros ')
    states = [message for topic, message in found if topic == '/joint_states']
    [command] = [message for topic, message in found if topic == '/commands']
    assert [list(state.position) for state in states] == [[0, 0.5], [1, 0.5], [2, 0.5]]
    assert states[2].header.stamp.sec == 1_700_000_000
    assert states[2].header.stamp.nanosec == 125_456_789
    assert list(command.data) == [1.5, -2.5]
    assert command.layout.dim[0].label == 'j1,j2'


@pytest.mark.parametrize(
    'type_name',
    [
        JOINT_STATE,
        'std_msgs/msg/Float64MultiArray',
        'trajectory_msgs/msg/JointTrajectory',
        'visualization_msgs/msg/MarkerArray',
        'diagnostic_msgs/msg/DiagnosticArray',
        'geometry_msgs/msg/PoseStamped',
    ],
)
def test_definition_holds_every_type_it_needs(type_name: str) -> None:
    sections = message_definition(type_name).split('=' * 80 + '\n')
    defined = {section.splitlines()[0].removeprefix('MSG: ') for section in sections[1:]}
    used = {
        line.split()[0].split('[')[0]
        for section in sections
        for line in section.splitlines()
        if '/' in line.split()[0]
    }
    assert used == defined


def test_empty_message_of_every_used_type_is_read_by_both(tmp_path: Path) -> None:
    types = ['std_msgs/msg/String', 'visualization_msgs/msg/MarkerArray', 'std_msgs/msg/Empty']
    types += ['diagnostic_msgs/msg/DiagnosticArray', 'geometry_msgs/msg/PoseWithCovarianceStamped']
    with BagWriter(tmp_path / 'run') as writer:
        for type_name in types:
            writer.add_topic(f'/{type_name}', type_name)
            writer.write_message(f'/{type_name}', START_NS)
    with AnyReader([tmp_path / 'run']) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        rows = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        assert len(list(rows)) == len(types)


def test_user_type_comes_from_the_ament_prefix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / 'install' / 'share' / 'gripper_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Grip.msg').write_text('std_msgs/Header header\nFinger[] fingers\nint32 MAX=3\n')
    (folder / 'Finger.msg').write_text('# one finger\nfloat64 force 1.0\nstring<=8 side\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'install'))
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic('/grip', 'gripper_msgs/msg/Grip')
        writer.write_message('/grip', START_NS, fingers=[{'force': 2.0, 'side': 'left'}])
    [item] = read_bag(tmp_path / 'run')
    assert item.message.fingers[0].force == 2.0
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        assert next(decoded).decoded_message.fingers[0].side == 'left'


def test_metadata_is_in_the_form_that_ros2_bag_wants(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as writer:
        write_joint_states(writer, 4)
        assert not (tmp_path / 'run' / 'metadata.yaml').exists()
    text = (tmp_path / 'run' / 'metadata.yaml').read_text()
    found = yaml.safe_load(text)['rosbag2_bagfile_information']
    # the keys and kinds that rosbag2_storage's yaml.hpp converts at version 5
    assert found['version'] == 5
    assert found['storage_identifier'] == 'mcap'
    assert found['duration'] == {'nanoseconds': 3_000_000}
    assert found['starting_time'] == {'nanoseconds_since_epoch': START_NS}
    assert found['message_count'] == 4
    assert found['compression_format'] == found['compression_mode'] == ''
    assert found['relative_file_paths'] == ['run_0.mcap']
    assert found['files'] == [
        {
            'path': 'run_0.mcap',
            'starting_time': {'nanoseconds_since_epoch': START_NS},
            'duration': {'nanoseconds': 3_000_000},
            'message_count': 4,
        }
    ]
    [topic] = found['topics_with_message_count']
    assert topic['message_count'] == 4
    assert topic['topic_metadata']['serialization_format'] == 'cdr'
    assert isinstance(topic['topic_metadata']['offered_qos_profiles'], str)


def test_offered_qos_is_integers_in_channel_and_metadata(tmp_path: Path) -> None:
    latched = Qos(depth=1, durability=1)
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic(
            '/robot_description', 'std_msgs/msg/String', (latched, Qos(reliability=2))
        )
        writer.write_message('/robot_description', START_NS, data='<robot/>')
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        [channel] = make_reader(stream).get_summary().channels.values()
    first, second = yaml.safe_load(channel.metadata['offered_qos_profiles'])
    assert (first['durability'], first['reliability'], first['depth']) == (1, 1, 1)
    assert second['reliability'] == 2
    with Reader(tmp_path / 'run') as reader:
        [connection] = reader.connections
        names = [profile.durability.name for profile in connection.ext.offered_qos_profiles]
    assert names == ['TRANSIENT_LOCAL', 'VOLATILE']


def test_split_by_duration_loses_nothing_and_each_file_stands_alone(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run', max_bag_duration=0.1) as writer:
        writer.attach('robot_description.urdf', '<robot name="arm"/>')
        write_joint_states(writer, 250)
        assert [part.messages for part in writer.files] == [100, 100, 50]
    positions = [item.message.position[0] for item in read_bag(tmp_path / 'run')]
    assert positions == list(range(250))
    for part in sorted((tmp_path / 'run').glob('*.mcap')):
        assert len(list(read_bag(part))) in (50, 100)
        assert read_attachment(part, 'robot_description.urdf') == b'<robot name="arm"/>'


def test_split_by_size_bounds_the_files(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run', 'none', max_bag_size=200_000) as writer:
        write_joint_states(writer, 5000)
    sizes = [part.stat().st_size for part in (tmp_path / 'run').glob('*.mcap')]
    assert len(sizes) >= 3
    # a chunk of an eighth, its index and the summary come on top
    assert max(sizes) < 1.3 * 200_000
    assert len(list(read_bag(tmp_path / 'run'))) == 5000


@pytest.mark.parametrize('name', ['run', 'run.mcap'])
def test_existing_output_is_never_overwritten(tmp_path: Path, name: str) -> None:
    with BagWriter(tmp_path / name) as writer:
        write_joint_states(writer, 1)
    with pytest.raises(BagError, match='must not exist yet'):
        BagWriter(tmp_path / name)
    assert len(list(read_bag(tmp_path / name))) == 1


def test_empty_bag_is_a_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic('/joint_states', JOINT_STATE)
    assert list(read_bag(tmp_path / 'run')) == []


@pytest.mark.parametrize(
    ('arguments', 'match'),
    [
        ({'compression': 'gzip'}, "compression must be one of none, lz4, zstd, got 'gzip'"),
        ({'max_bag_size': -1}, 'must be >= 0'),
        ({'max_bag_duration': float('nan')}, 'must be >= 0'),
    ],
)
def test_bad_argument_is_refused(tmp_path: Path, arguments: dict[str, Any], match: str) -> None:
    with pytest.raises(BagError, match=match):
        BagWriter(tmp_path / 'run', **arguments)
    assert not (tmp_path / 'run').exists()


def test_bare_file_cannot_split(tmp_path: Path) -> None:
    with pytest.raises(BagError, match='must be a folder'):
        BagWriter(tmp_path / 'run.mcap', max_bag_size=1000)
    with (
        BagWriter(tmp_path / 'run.mcap') as writer,
        pytest.raises(BagError, match='must be a folder'),
    ):
        writer.split()


def test_a_topic_has_a_channel_for_each_of_its_types(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as writer:
        for stamp_ns, kind in enumerate([FLOAT, FLOAT, TEXT, FLOAT], 1):
            writer.add_topic('/a', kind)
            writer.write_message('/a', stamp_ns, data=VALUES[kind])
        writer.split()
        writer.write('/a', 5, encode(TEXT, 5, {'data': VALUES[TEXT]}), type_name=TEXT)
    cut = tmp_path / 'cut'
    shutil.copytree(tmp_path / 'run', cut)
    for path in (tmp_path / 'run', recover(cut).path):
        kept = [(item.type, item.message.data) for item in read_bag(path)]
        assert kept == [(kind, VALUES[kind]) for kind in (FLOAT, FLOAT, TEXT, FLOAT, TEXT)]
        with Reader(path) as reader:
            counts = {each.msgtype: each.msgcount for each in reader.connections}
            assert (counts, reader.message_count) == ({FLOAT: 3, TEXT: 2}, 5)
        assert {each.type: each.messages for each in bag_contents(path).topics} == counts


def test_a_report_has_the_joint_states_of_a_topic_with_other_types(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as writer:
        for kind in (TEXT, JOINT_STATE, TEXT):
            writer.add_topic('/joint_states', kind)
            writer.write('/joint_states', 1, encode(kind, 1, {}), type_name=kind)
    run = read_run(tmp_path / 'run')
    assert len(run.joint_states['/joint_states'].t) == 1
    assert run.counts == {'/joint_states': 3}


def test_unwritable_place_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='output must be writable'):
        BagWriter(tmp_path / 'file' / 'run')


def test_wrong_use_says_what_must_hold(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic('/a', JOINT_STATE)
        writer.add_topic('/a', JOINT_STATE)
        with pytest.raises(BagError, match='topic /a must be added as std_msgs/msg/String before'):
            writer.write('/a', 0, b'', type_name='std_msgs/msg/String')
        with pytest.raises(BagError, match='definition must be installed'):
            writer.add_topic('/b', 'nobody_msgs/msg/Nothing')
        with pytest.raises(BagError, match='must be added before'):
            writer.write('/c', 0, b'')
        with pytest.raises(BagError, match='must be added before'):
            writer.write_message('/c', 0)
        with pytest.raises(BagError, match='must be >= 0 ns'):
            writer.write('/a', -1, b'')
        with pytest.raises(BagError, match='fields must be among'):
            writer.write_message('/a', 0, positions=[1.0])
        with pytest.raises(BagError, match='fields must fit'):
            writer.write_message('/a', 0, name=[3])
    writer.close()
    with pytest.raises(BagError, match='must be open for writing'):
        writer.flush()


FILL_UP = """
import resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from test_bag_writer import write_joint_states
from denoc_ros.bags.storage import DiskFile
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
with BagWriter(Path(sys.argv[1]), 'none') as writer:
    try:
        for start in range(100):
            write_joint_states(writer, 100)
            writer.flush()
    except BagError as error:
        print(error)
"""


@pytest.mark.parametrize('limit', [100_000, 100_010, 104_321])
def test_refusing_disk_leaves_a_whole_bag_up_to_the_last_flush(tmp_path: Path, limit: int) -> None:
    script = [sys.executable, '-c', FILL_UP, str(tmp_path / 'run'), str(Path(__file__).parent)]
    done = subprocess.run([*script, str(limit)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert 'disk must take what is recorded, got: File too large' in done.stdout
    count = len(list(read_bag(tmp_path / 'run')))
    assert count > 200
    assert count % 100 == 0
    assert f'closed with {count} messages, the last 100 are lost' in done.stdout
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def refuse_writes(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Let the disk take no byte of files of a name."""
    write = DiskFile.write

    def refuse(disk: DiskFile, block: bytes) -> int:
        if Path(f'/proc/self/fd/{disk._descriptor}').readlink().name == name:
            raise OSError(errno.ENOSPC, 'No space left on device')
        return write(disk, block)

    monkeypatch.setattr(DiskFile, 'write', refuse)


def open_files() -> int:
    return len(os.listdir('/proc/self/fd'))


@pytest.mark.parametrize('name', ['run_0.mcap', 'run.mcap'])
def test_a_disk_without_room_for_a_first_file_keeps_nothing_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    refuse_writes(monkeypatch, name)
    before = open_files()
    with pytest.raises(BagError, match='output must be writable, got: No space left on device'):
        BagWriter(tmp_path / ('run' if '_' in name else name))
    assert list(tmp_path.iterdir()) == []
    assert open_files() == before


def test_a_disk_that_is_full_at_a_split_keeps_a_whole_bag_and_no_stub(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = open_files()
    writer = BagWriter(tmp_path / 'run')
    write_joint_states(writer, 10)
    refuse_writes(monkeypatch, 'run_1.mcap')
    with pytest.raises(BagError, match='closed with 10 messages, the last 0 are lost'):
        writer.split()
    assert open_files() == before
    assert {file.name for file in (tmp_path / 'run').iterdir()} == {'run_0.mcap', 'metadata.yaml'}
    assert len(list(read_bag(tmp_path / 'run'))) == 10


def test_a_finished_file_and_its_name_are_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[tuple[str, int]] = []

    def note(descriptor: int) -> None:
        path = Path(f'/proc/self/fd/{descriptor}').readlink()
        synced.append((path.name, path.stat().st_size))

    monkeypatch.setattr(os, 'fsync', note)
    run = tmp_path / 'run'
    with BagWriter(run) as writer:
        write_joint_states(writer, 10)
        writer.split()
        assert synced == [('run_0.mcap', (run / 'run_0.mcap').stat().st_size)]
        synced.clear()
    names = [name for name, _ in synced]
    # Metadata come first: a process that is killed while the disk is slow keeps a whole bag.
    assert names == ['.metadata.yaml.tmp', 'run', 'run_1.mcap']
    assert synced[-1][1] == (run / 'run_1.mcap').stat().st_size


@pytest.mark.parametrize('end', ['split', 'close'])
def test_a_disk_that_fails_to_keep_a_finished_file_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str
) -> None:
    before = open_files()
    writer = BagWriter(tmp_path / 'run')
    write_joint_states(writer, 10)

    def fail(_descriptor: int) -> None:
        raise OSError(errno.EIO, 'Input/output error')

    monkeypatch.setattr(os, 'fsync', fail)
    with pytest.raises(BagError, match='disk must take what is recorded, got: Input/output error'):
        getattr(writer, end)()
    assert open_files() == before
    assert not (tmp_path / 'run' / '.metadata.yaml.tmp').exists()
