"""Chunks and messages that hold more than they claim: refused, within the memory of the claim."""

from __future__ import annotations

import resource
import sqlite3
from collections.abc import Callable
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin, Writer
from test_yaml_text import ALIASES, MERGES

from denoc_ros.bags.definitions import encode, message_types
from denoc_ros.bags.metadata import Topic
from denoc_ros.bags.reader import read_bag, read_raw, read_thinned
from denoc_ros.bags.recover import recover
from denoc_ros.bags.series import read_joint_states
from denoc_ros.bags.storage import (
    LARGEST_CHUNK,
    MOST_AT_ONCE,
    McapFile,
    decompressed,
    decompressed_message,
    require_bounded,
)
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
PACK: dict[str, Callable[[bytes], bytes]] = {
    'lz4': lz4.frame.compress,
    'zstd': lambda data: zstandard.ZstdCompressor(write_content_size=False).compress(data),
}
HUGE = 300 << 20  # bytes


@pytest.mark.parametrize('kind', PACK)
def test_a_chunk_is_opened_whole_and_to_its_claim_only(kind: str) -> None:
    content = bytes(range(256)) * 1000
    packed = PACK[kind](content)
    assert decompressed(packed, kind, len(content)) == content
    for claim, got in ((1000, 'more'), (len(content) + 1, '256000')):
        with pytest.raises(ValueError, match=f'the {claim} bytes that it claims, got {got}'):
            decompressed(packed, kind, claim)
    for end in range(0, len(packed) - 1, max(1, len(packed) // 40)):
        with pytest.raises(ValueError, match='chunk must') as told:
            decompressed(packed[:end], kind, len(content))
        assert str(told.value).strip()


def test_bounds_hold_for_one_chunk_and_for_all_of_a_time() -> None:
    with pytest.raises(
        ValueError, match=f'at most {LARGEST_CHUNK} bytes, got {LARGEST_CHUNK + 1}'
    ):
        decompressed(b'', '', LARGEST_CHUNK + 1)
    with pytest.raises(ValueError, match=f'at most {LARGEST_CHUNK} bytes'):
        decompressed_message(zstandard.compress(bytes(LARGEST_CHUNK + 1)))
    many = 2 * MOST_AT_ONCE // LARGEST_CHUNK
    require_bounded((10 * k, 10 * k + 9, LARGEST_CHUNK) for k in range(many))
    with pytest.raises(ValueError, match=f'same time must hold at most {MOST_AT_ONCE}'):
        require_bounded((k, 10 * many, LARGEST_CHUNK) for k in range(many))


def bomb(path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a bag whose chunk claims the size of a small message and holds HUGE bytes."""
    packed = PACK[kind](bytes(HUGE))
    library = 'lz4.frame' if kind == 'lz4' else 'zstandard'
    with monkeypatch.context() as patch:
        patch.setattr(f'{library}.compress', lambda _: packed)
        with BagWriter(path, kind) as writer:
            writer.add_topic('/joint_states', JOINT_STATE)
            writer.write_message('/joint_states', 1, name=['a'], position=[1.0])
    return next(path.glob('*.mcap'))


@pytest.mark.parametrize('kind', PACK)
def test_a_small_file_does_not_fill_the_memory(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a chunk took 2 GB where 256 MiB were the limit."""
    file = bomb(tmp_path / kind, kind, monkeypatch)
    assert file.stat().st_size < HUGE / 100
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for read in (
        lambda: list(read_bag(file)),
        lambda: read_joint_states(file, '/joint_states'),
        lambda: list(read_thinned(file, ['/joint_states'], 1)),
    ):
        with pytest.raises(BagError, match='bytes that it claims, got more'):
            read()  # type: ignore[no-untyped-call]
    assert recover(file, tmp_path / 'whole').damaged_chunks == 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB


@pytest.mark.parametrize('text', [ALIASES, MERGES], ids=['aliases', 'merge keys'])
def test_yaml_of_a_bag_has_the_bounds_of_all_yaml(tmp_path: Path, text: str) -> None:
    file = McapFile(tmp_path / 'a.mcap', 'none')
    file.add_topic(Topic('/a', 'std_msgs/msg/String', text), 'string data')
    file.write(('/a', 'std_msgs/msg/String'), 1, b'\x00\x01\x00\x00\x02\x00\x00\x00a\x00', 1)
    file.finish()
    with pytest.raises(BagError, match='aliases must repeat at most'):
        list(read_bag(file.path))
    (tmp_path / 'metadata.yaml').write_text(text)
    with pytest.raises(BagError, match='aliases must repeat at most'):
        list(read_bag(tmp_path))


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Return a bag of sqlite with three joint states."""
    folder = tmp_path / 'bag'
    raw = encode(JOINT_STATE, 1, {'name': ['a'], 'position': [1.0]})
    with Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection('/joint_states', JOINT_STATE, typestore=message_types())
        for k in range(3):
            writer.write(topic, k + 1, raw)
    return next(folder.glob('*.db3'))


@pytest.mark.parametrize('value', [3, 'text', 2.5])
def test_a_database_whose_cells_are_no_messages_is_one_error(
    database: Path, value: object, capsys: pytest.CaptureFixture[str]
) -> None:
    """Integers and texts ended report and replay with a traceback."""
    assert len(list(read_bag(database))) == 3
    with sqlite3.connect(database) as connection:
        connection.execute('UPDATE messages SET data = ? WHERE id = 2', (value,))
    for read in (
        lambda: list(read_bag(database)),
        lambda: list(read_raw(database)),
        lambda: read_joint_states(database, '/joint_states'),
    ):
        with pytest.raises(BagError, match='/joint_states: message must be bytes, got'):
            read()  # type: ignore[no-untyped-call]
    out = ['-o', str(database.parent / 'out')]
    for verb in (['report', *out], ['identify', 'info'], ['replay', *out]):
        assert main([*verb, str(database)]) == 1
        said = capsys.readouterr().err
        assert str(database) in said
        assert 'Traceback' not in said


@pytest.mark.parametrize(
    ('table', 'column'),
    [
        ('messages', 'timestamp'),
        ('topics', 'name'),
        ('topics', 'type'),
        ('topics', 'offered_qos_profiles'),
    ],
)
@pytest.mark.parametrize('value', [-3, 'text', 2.5, b'\xff'])
def test_other_cells_of_a_database_never_make_a_traceback(
    database: Path, table: str, column: str, value: object, capsys: pytest.CaptureFixture[str]
) -> None:
    with sqlite3.connect(database) as connection:
        connection.execute(f'UPDATE {table} SET {column} = ?', (value,))
    out = ['-o', str(database.parent / 'out')]
    for verb in (['report', *out], ['identify', 'info'], ['replay', *out]):
        assert main([*verb, str(database)]) in (0, 1)
        assert 'Traceback' not in capsys.readouterr().err
