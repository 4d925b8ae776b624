"""Bags of other programs: each topic is read as an independent reader reads it, or named."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import zstandard
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from denoc_ros.bags.definitions import encode, message_definition, message_types
from denoc_ros.bags.mcap_source import read_contents
from denoc_ros.bags.reader import bag_contents, read_attachment, read_bag, read_raw, read_thinned
from denoc_ros.bags.recover import recover
from denoc_ros.cli.main import main
from denoc_ros.cli.verbs import verbs
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
FLOAT = 'std_msgs/msg/Float64'
JOINTS, STRAIN, OTHER = '/joint_states', '/strain', '/other'
ROWS = 60
MS = 1_000_000
BASE_NS = 1_700_000_000_000_000_000
UNKNOWN_RECORD = b'\x9a' + struct.pack('<Q', 5) + b'12345'
GAUGE = 'float64 data'


def joint_state(row: int) -> bytes:
    fields = {'name': ['shoulder'], 'position': [0.01 * row]}
    return encode(JOINT_STATE, BASE_NS + row * MS, fields)


def strain(row: int) -> bytes:
    return encode(FLOAT, 0, {'data': 1e-6 * row})


class Foreign:
    """Writes a file of MCAP as other programs do."""

    def __init__(self, path: Path, profile: str = 'ros2', **options: Any) -> None:
        self.stream = path.open('wb')
        options = {'chunk_size': 2000, 'compression': CompressionType.NONE} | options
        self.writer = Writer(self.stream, **options)
        self.writer.start(profile, 'another program')

    def channel(
        self, topic: str, kind: str, text: str | None = None, encoding: str = 'cdr'
    ) -> int:
        text = message_definition(kind) if text is None else text
        form = {'cdr': 'ros2msg', 'ros1': 'ros1msg', 'json': 'jsonschema'}.get(encoding, encoding)
        schema = self.writer.register_schema(kind, form, text.encode())
        number: int = self.writer.register_channel(topic, encoding, schema)
        return number

    def add(self, channel: int, row: int, raw: bytes) -> None:
        stamp = BASE_NS + row * MS
        self.writer.add_message(channel, stamp, raw, stamp)

    def rows(self, *others: tuple[int, bytes], rows: Iterator[int] | range = range(ROWS)) -> None:
        """Write the common topics, and the same message on other channels."""
        joints, gauge = self.channel(JOINTS, JOINT_STATE), self.channel(STRAIN, FLOAT)
        for row in rows:
            self.add(joints, row, joint_state(row))
            self.add(gauge, row, strain(row))
            for channel, raw in others:
                self.add(channel, row, raw)

    def finish(self) -> None:
        self.writer.finish()
        self.stream.close()


class Kind(NamedTuple):
    write: Callable[[Path], Path]  # into an empty folder
    left_out: str = ''  # what is said of topics that are not read
    refused: str = ''  # what is said of the file
    topics: tuple[str, ...] = (JOINTS, STRAIN)  # those that are read


def plain(profile: str, **options: Any) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        file = Foreign(folder / 'a.mcap', profile, **options)
        file.rows()
        file.finish()
        return folder / 'a.mcap'

    return write


def beside(kind: str, text: str | None, encoding: str, raw: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        file = Foreign(folder / 'a.mcap', '')
        file.rows((file.channel(OTHER, kind, text, encoding), raw))
        file.finish()
        return folder / 'a.mcap'

    return write


def without_schema(folder: Path) -> Path:
    file = Foreign(folder / 'a.mcap')
    file.rows((file.writer.register_channel(OTHER, 'cdr', 0), strain(1)))
    file.finish()
    return folder / 'a.mcap'


def two_of_one_name(folder: Path) -> Path:
    """The type of a topic has changed its fields between two parts that were merged."""
    file = Foreign(folder / 'a.mcap')
    first = file.channel('/first', 'rig_msgs/msg/Gauge', 'float64 data')
    second = file.channel('/second', 'rig_msgs/msg/Gauge', 'int32 count\nfloat64 data')
    file.rows((first, strain(3)), (second, strain(3)[:4] + struct.pack('<iid', 7, 0, 5.0)))
    file.finish()
    return folder / 'a.mcap'


def short_name(folder: Path) -> Path:
    """The type has the name of ROS 1, and its definition lacks what it consists of."""
    file = Foreign(folder / 'a.mcap')
    text = message_definition(JOINT_STATE).split('=' * 20)[0]
    channel = file.channel(OTHER, 'sensor_msgs/JointState', text)
    file.rows((channel, joint_state(4)))
    file.finish()
    return folder / 'a.mcap'


def no_chunks(folder: Path) -> Path:
    file = Foreign(folder / 'a.mcap', '', use_chunking=False)
    file.rows(rows=iter([*range(30, ROWS), *range(30)]))
    file.finish()
    return folder / 'a.mcap'


def extras(folder: Path) -> Path:
    file = Foreign(folder / 'a.mcap')
    file.writer.add_attachment(1, 1, 'note.txt', 'text/plain', b'of the rig')
    file.writer.add_metadata('rig', {'name': 'left'})
    file.rows()
    file.finish()
    return folder / 'a.mcap'


def unknown_records(folder: Path) -> Path:
    """Records of a later version are in the file, before and after all others."""
    path = plain('ros2')(folder)
    raw = path.read_bytes()
    head = 17 + struct.unpack_from('<Q', raw, 9)[0]
    path.write_bytes(raw[:head] + UNKNOWN_RECORD + raw[head:-37] + UNKNOWN_RECORD + raw[-37:])
    return path


def wrong_summary(folder: Path) -> Path:
    """The file was edited: what its summary says of the chunks is of another one."""
    path = plain('ros2')(folder)
    raw = bytearray(path.read_bytes())
    start = struct.unpack_from('<Q', raw, len(raw) - 28)[0]
    place = raw.index(b'\x08', start)
    while raw[place] != 8 or struct.unpack_from('<Q', raw, place + 1)[0] > 200:
        place = raw.index(b'\x08', place + 1)
    struct.pack_into('<Q', raw, place + 25, 12345)
    path.write_bytes(raw)
    return path


def messages_behind(folder: Path) -> Path:
    """Messages follow the last chunk, as of a writer that flushes its chunk when it is full."""
    path = plain('ros2')(folder)
    raw = path.read_bytes()
    start = struct.unpack_from('<Q', raw, len(raw) - 28)[0]
    end = start - 13  # of the data section
    assert raw[end] == 0x0F
    stamp = BASE_NS + ROWS * MS
    body = struct.pack('<HIQQ', 2, 0, stamp, stamp) + strain(ROWS)
    loose = b'\x05' + struct.pack('<Q', len(body)) + body
    footer = b'\x02' + struct.pack('<QQQI', 20, 0, 0, 0)
    path.write_bytes(raw[:end] + loose + raw[end:start] + footer + raw[-8:])
    return path


def by_mcap_ros2(folder: Path) -> Path:
    with (folder / 'a.mcap').open('wb') as stream:
        writer = Ros2Writer(stream)
        joints = writer.register_msgdef(JOINT_STATE, message_definition(JOINT_STATE))
        gauge = writer.register_msgdef(FLOAT, message_definition(FLOAT))
        for row in range(ROWS):
            stamp = BASE_NS + row * MS
            header = {'stamp': {'sec': stamp // 10**9, 'nanosec': stamp % 10**9}, 'frame_id': ''}
            fields = {'name': ['shoulder'], 'position': [0.01 * row]}
            message = {'header': header, **fields, 'velocity': [], 'effort': []}
            writer.write_message(JOINTS, joints, message, stamp, stamp)
            writer.write_message(STRAIN, gauge, {'data': 1e-6 * row}, stamp, stamp)
        writer.finish()
    return folder / 'a.mcap'


def by_rosbags(plugin: StoragePlugin) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        with RosbagsWriter(folder / 'bag', version=9, storage_plugin=plugin) as writer:
            joints = writer.add_connection(JOINTS, JOINT_STATE, typestore=message_types())
            gauge = writer.add_connection(STRAIN, FLOAT, typestore=message_types())
            for row in range(ROWS):
                writer.write(joints, BASE_NS + row * MS, joint_state(row))
                writer.write(gauge, BASE_NS + row * MS, strain(row))
        return folder / 'bag'

    return write


def compressed_folder(folder: Path) -> Path:
    bag = by_rosbags(StoragePlugin.MCAP)(folder)
    (file,) = bag.glob('*.mcap')
    file.with_name(f'{file.name}.zstd').write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    text = (bag / 'metadata.yaml').read_text().replace(file.name, f'{file.name}.zstd')
    text = text.replace("compression_format: ''", 'compression_format: zstd')
    text = text.replace("compression_mode: ''", 'compression_mode: FILE')
    (bag / 'metadata.yaml').write_text(text)
    return bag


def compressed_file(folder: Path) -> Path:
    path = plain('ros2')(folder)
    path.with_name('a.mcap.zstd').write_bytes(zstandard.compress(path.read_bytes()))
    path.unlink()
    return path.with_name('a.mcap.zstd')


def database_of_others(folder: Path) -> Path:
    """rosbag2 notes a definition that it could not find, and a format of its own, by name."""
    bag = by_rosbags(StoragePlugin.SQLITE3)(folder)
    (file,) = bag.glob('*.db3')
    with sqlite3.connect(file) as database:
        database.execute("UPDATE message_definitions SET encoding = 'unknown'")
        database.execute(
            "INSERT INTO topics SELECT 9, '/other', type, 'protobuf', '', '' FROM topics LIMIT 1"
        )
    return bag


def folder_of_others(folder: Path) -> Path:
    """The folder's metadata.yaml names the format of all topics."""
    beside('rig.Gauge', '', 'protobuf', b'\x08\x01')(folder)
    return recover(folder / 'a.mcap', folder / 'bag').path


KINDS = {
    'profile empty': Kind(plain('')),
    'profile of another program': Kind(plain('x-rig')),
    'protobuf beside': Kind(beside('rig.Gauge', '', 'protobuf', b'\x08\x01'), "got 'protobuf'"),
    'json beside': Kind(beside('Gauge', '{}', 'json', b'{"a": 1}'), "got 'json'"),
    'ros1 beside': Kind(beside('std_msgs/Float64', GAUGE, 'ros1', bytes(8)), "got 'ros1'"),
    'definition that is none': Kind(
        beside('rig_msgs/msg/Gauge', '}{ no definition', 'cdr', strain(1)),
        'definition must be valid',
    ),
    'definition with a part that is nowhere': Kind(
        beside('rig_msgs/msg/Gauge', 'rig_msgs/Part part', 'cdr', strain(1)),
        'definition must be whole, got one without rig_msgs/msg/Part:',
    ),
    'definition without common parts': Kind(short_name, topics=(JOINTS, STRAIN, OTHER)),
    'two definitions of one name': Kind(
        two_of_one_name, topics=(JOINTS, STRAIN, '/first', '/second')
    ),
    'topic without schema': Kind(without_schema, 'it must have a schema'),
    'chunks without message indexes': Kind(plain('ros2', index_types=IndexType.CHUNK)),
    'no index of chunks': Kind(plain('ros2', index_types=IndexType.MESSAGE)),
    'no summary': Kind(
        plain(
            'ros2',
            index_types=IndexType.NONE,
            repeat_channels=False,
            repeat_schemas=False,
            use_statistics=False,
            use_summary_offsets=False,
        )
    ),
    'no statistics': Kind(plain('ros2', use_statistics=False, use_summary_offsets=False)),
    'schemas in the data only': Kind(plain('ros2', repeat_schemas=False)),
    'lz4': Kind(plain('ros2', compression=CompressionType.LZ4)),
    'wrong summary': Kind(wrong_summary),
    'no chunks, times out of order': Kind(no_chunks),
    'messages behind the chunks': Kind(messages_behind),
    'attachments and metadata': Kind(extras),
    'records of a later version': Kind(unknown_records),
    'by mcap-ros2-support': Kind(by_mcap_ros2),
    'by rosbags': Kind(by_rosbags(StoragePlugin.MCAP)),
    'by rosbags, sqlite': Kind(by_rosbags(StoragePlugin.SQLITE3)),
    'sqlite with other formats': Kind(database_of_others, "got 'protobuf'"),
    'folder with other formats': Kind(folder_of_others, "got 'protobuf'"),
    'compressed folder': Kind(compressed_folder),
    'compressed file': Kind(compressed_file),
    'ros1 alone': Kind(
        lambda folder: _alone(folder), refused="/a .1 messages.: its messages must .* got 'ros1'"
    ),
}


def _alone(folder: Path) -> Path:
    file = Foreign(folder / 'a.mcap', 'ros1')
    file.add(file.channel('/a', 'std_msgs/Float64', GAUGE, 'ros1'), 1, bytes(8))
    file.finish()
    return folder / 'a.mcap'


class Row(NamedTuple):
    topic: str
    log_ns: int
    raw: bytes
    value: float


def value_of(message: Any) -> float:
    return float(message.data if hasattr(message, 'data') else message.position[0])


def independent(path: Path, topics: tuple[str, ...]) -> list[Row]:
    """Return what mcap and mcap-ros2-support read of topics, whatever the summary says."""
    rows = []
    with path.open('rb') as stream:
        for schema, channel, message in NonSeekingReader(stream).iter_messages():
            if channel.topic in topics:
                value = 0.0  # of a definition that lacks common parts, which it does not know
                if channel.topic != OTHER:
                    decoder = DecoderFactory().decoder_for('cdr', schema)
                    assert decoder is not None
                    value = value_of(decoder(message.data))
                rows.append(Row(channel.topic, message.log_time, message.data, value))
    return rows


@pytest.fixture(params=KINDS)
def case(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Kind, Path]:
    kind = KINDS[request.param]
    return kind, kind.write(tmp_path)


def test_each_topic_is_read_or_named(
    case: tuple[Kind, Path], caplog: pytest.LogCaptureFixture
) -> None:
    kind, path = case
    if kind.refused:
        with pytest.raises(BagError, match=kind.refused):
            list(read_bag(path))
        return
    for _ in range(2):
        found = list(read_bag(path))
    assert {one.topic for one in found} == set(kind.topics)
    rows = ROWS + any(one.log_ns == BASE_NS + ROWS * MS for one in found)
    for topic, expected in ((JOINTS, range(ROWS)), (STRAIN, range(rows))):
        read = [(one.log_ns, value_of(one.message)) for one in found if one.topic == topic]
        scale = 0.01 if topic == JOINTS else 1e-6
        assert read == [(BASE_NS + row * MS, scale * row) for row in expected]
    if kind.left_out:
        (said,) = {record.message for record in caplog.records}
        assert kind.left_out in said
        assert f'{OTHER}' in said
        assert len(caplog.records) == 1  # once, however often the bag is opened
    else:
        assert not caplog.records
    contents = bag_contents(path)
    assert (contents.start_ns, contents.end_ns) == (BASE_NS, BASE_NS + (rows - 1) * MS)
    counts = {topic.name: topic.messages for topic in contents.topics}
    assert {topic: counts[topic] for topic in (JOINTS, STRAIN)} == {JOINTS: ROWS, STRAIN: rows}


def test_values_are_those_of_an_independent_reader(case: tuple[Kind, Path]) -> None:
    kind, path = case
    if kind.refused or path.suffix != '.mcap':
        return
    read = [
        Row(one.topic, one.log_ns, one.raw, value_of(one.message) if one.topic != OTHER else 0.0)
        for one in read_bag(path)
    ]
    assert sorted(read) == sorted(independent(path, kind.topics))
    assert [row.log_ns for row in read] == sorted(row.log_ns for row in read)


def test_thinning_keeps_the_messages_of_the_steps(case: tuple[Kind, Path]) -> None:
    kind, path = case
    if kind.refused:
        return
    thin = list(read_thinned(path, [JOINTS], 10 * MS))
    assert [log_ns for _, _, log_ns, _ in thin] == [BASE_NS + k * 10 * MS for k in range(6)]
    assert {(JOINTS, JOINT_STATE)} == {(topic, kind) for topic, kind, *_ in thin}
    whole = [row for row in read_raw(path, [JOINTS]) if (row[2] - BASE_NS) % (10 * MS) == 0]
    assert thin == whole


def test_a_recovered_bag_has_the_same_messages(case: tuple[Kind, Path], tmp_path: Path) -> None:
    kind, path = case
    if not (path.suffix == '.mcap' or list(path.glob('*.mcap'))):
        with pytest.raises(BagError, match=r'must be a \.mcap file|unpack it'):
            recover(path, tmp_path / 'whole')
        return
    result = recover(path, tmp_path / 'whole')
    assert not result.torn
    assert not result.damaged_chunks
    if kind.refused:
        return
    assert sorted(read_raw(tmp_path / 'whole')) == sorted(read_raw(path))


def test_messages_of_a_channel_that_is_nowhere_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    path = messages_behind(tmp_path)
    raw = path.read_bytes()
    loose = raw.rindex(b'\x05' + struct.pack('<QH', 34, 2))
    path.write_bytes(raw[: loose + 9] + struct.pack('<H', 77) + raw[loose + 11 :])
    assert len(list(read_raw(path))) == 2 * ROWS
    assert '(channel 77) (1 messages): its channel must be in the file' in caplog.text
    assert recover(path, tmp_path / 'whole').unknown_messages == 1
    assert main(['recover', str(path), '-o', str(tmp_path / 'again')]) == 2
    assert '1 messages were left out' in capsys.readouterr().out


def test_every_verb_ends_with_a_result_or_one_message(
    case: tuple[Kind, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kind, path = case
    asked = (['identify', 'info'], ['replay', '-o', str(tmp_path / 'out')])
    for words in (words for words in asked if words[0] in verbs()):
        status = main([*words, str(path)])
        shown = capsys.readouterr()
        assert 'Traceback' not in shown.err
        if kind.refused or words[0] == 'replay':  # a robot is in none of them
            assert status == 1
            assert len([line for line in shown.err.splitlines() if 'denoc ' in line]) == 1
        else:
            assert status == 0
            assert 'shoulder' in shown.out


def test_a_report_is_made_of_the_topics_that_are_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = KINDS['protobuf beside'].write(tmp_path)
    if 'report' in verbs():
        assert main(['report', str(path), '-o', str(tmp_path / 'out')]) == 0
    assert 'Traceback' not in capsys.readouterr().err


def test_a_topic_that_cannot_be_read_says_why_when_it_is_wanted(tmp_path: Path) -> None:
    path = KINDS['protobuf beside'].write(tmp_path)
    with pytest.raises(BagError, match=r"got /other: its messages must be .* got 'protobuf'"):
        list(read_bag(path, [OTHER]))
    path = KINDS['definition that is none'].write(tmp_path)
    with pytest.raises(BagError, match='/other: rig_msgs/msg/Gauge: definition must be valid'):
        list(read_bag(path, [OTHER]))
    assert len(list(read_raw(path, [OTHER]))) == ROWS


@pytest.mark.parametrize('kind', ['profile empty', 'by mcap-ros2-support', 'wrong summary'])
def test_a_sound_index_is_used_and_a_wrong_one_is_not(tmp_path: Path, kind: str) -> None:
    with KINDS[kind].write(tmp_path).open('rb') as stream:
        assert read_contents(stream).is_indexed == (kind != 'wrong summary')


def test_attachments_are_read_without_a_summary(tmp_path: Path) -> None:
    path = KINDS['attachments and metadata'].write(tmp_path)
    assert read_attachment(path, 'note.txt') == b'of the rig'
    raw = path.read_bytes()
    start = struct.unpack_from('<Q', raw, len(raw) - 28)[0]
    path.write_bytes(raw[:start] + b'\x02' + struct.pack('<QQQI', 20, 0, 0, 0) + raw[-8:])
    assert read_attachment(path, 'note.txt') == b'of the rig'
