"""Chunks and messages that hold more than they claim: refused, within the memory of the claim."""

from __future__ import annotations

import os
import re
import resource
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import IO

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
from denoc_ros.bags.storage import McapFile
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.cli.verbs import verbs
from denoc_ros.decompression import (
    LARGEST_CHUNK,
    LARGEST_RATIO,
    MOST_AT_ONCE,
    decompressed,
    decompressed_message,
    require_bounded,
)
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
    """The error is one line for the reader, and for each verb that is there."""
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
    asked = (['report', *out], ['identify', 'info'], ['replay', *out])
    for verb in (words for words in asked if words[0] in verbs()):
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
    asked = (['report', *out], ['identify', 'info'], ['replay', *out])
    for verb in (words for words in asked if words[0] in verbs()):
        assert main([*verb, str(database)]) in (0, 1)
        assert 'Traceback' not in capsys.readouterr().err


def compressed_bag(folder: Path, content: bytes, database: Path) -> Path:
    """Write a bag of which each file is compressed: its first is a database, then zeros."""
    packed = zstandard.compress(database.read_bytes()) + zstandard.compress(content)
    folder.mkdir()
    (folder / f'{database.name}.zstd').write_bytes(packed)
    text = (database.parent / 'metadata.yaml').read_text()
    text = text.replace(f'- {database.name}', f'- {database.name}.zstd')
    text = text.replace("compression_format: ''", 'compression_format: zstd')
    text = text.replace("compression_mode: ''", 'compression_mode: FILE')
    assert 'mode: FILE' in text
    (folder / 'metadata.yaml').write_text(text)
    return folder


@pytest.mark.parametrize('files', [1, 3])
def test_a_small_compressed_bag_does_not_fill_the_disk(
    tmp_path: Path, database: Path, files: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag of 98 kB filled TMPDIR with 3 GB; many small files share one bound."""
    written = 0

    def count(source: IO[bytes], target: IO[bytes]) -> None:
        nonlocal written
        while piece := source.read(1 << 20):
            written += len(piece)

    share = LARGEST_CHUNK // files + (1 << 20)
    bag = compressed_bag(tmp_path / 'small', bytes(share), database)
    for k in range(1, files):
        name = f'{k}_{database.name}.zstd'
        (bag / name).write_bytes(zstandard.compress(bytes(share)))
        text = (bag / 'metadata.yaml').read_text()
        listed = f'- {database.name}.zstd'
        spaces = text[: text.index(listed)].rpartition('\n')[2]
        text = text.replace(listed, f'{listed}\n{spaces}- {name}')
        (bag / 'metadata.yaml').write_text(text)
    assert sum(file.stat().st_size for file in bag.iterdir()) < LARGEST_CHUNK / LARGEST_RATIO
    monkeypatch.setattr('shutil.copyfileobj', count)
    with pytest.raises(BagError, match=f'unpack to at most {LARGEST_CHUNK} bytes, got more'):
        list(read_bag(bag))
    assert written <= LARGEST_CHUNK


def test_a_compressed_bag_has_the_messages_of_the_plain_one(
    tmp_path: Path, database: Path
) -> None:
    bag = compressed_bag(tmp_path / 'bag_of_files', b'', database)
    plain = [(one.log_ns, one.raw) for one in read_bag(database.parent)]
    assert [(one.log_ns, one.raw) for one in read_bag(bag)] == plain
    packed = next(bag.glob('*.zstd'))
    packed.write_bytes(packed.read_bytes()[:-5])
    with pytest.raises(BagError, match='bag must be readable'):
        list(read_bag(bag))


def test_chunks_in_a_compressed_file_have_the_bounds_of_all_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / 'zstd'
    file = bomb(folder, 'zstd', monkeypatch)
    seen: list[int] = []
    monkeypatch.setattr(
        'denoc_ros.bags.mcap_source.require_bounded', lambda chunks: seen.append(len([*chunks]))
    )
    (folder / f'{file.name}.zstd').write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    text = (folder / 'metadata.yaml').read_text().replace(file.name, f'{file.name}.zstd')
    text = re.sub('compression_format: .*', 'compression_format: zstd', text)
    text = re.sub('compression_mode: .*', 'compression_mode: FILE', text)
    (folder / 'metadata.yaml').write_text(text)
    with pytest.raises(BagError, match='bytes that it claims, got more'):
        list(read_bag(folder))
    assert seen == [1]


def test_a_database_that_computes_its_messages_is_refused(database: Path) -> None:
    with sqlite3.connect(database) as connection:
        connection.executescript(
            'DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, '
            'timestamp, data BLOB AS (zeroblob(400000000)));'
            'INSERT INTO messages(topic_id, timestamp) VALUES (1, 1);'
        )
    with pytest.raises(BagError, match="must hold plain tables, got 'messages'"):
        list(read_bag(database))


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_a_pipe_is_no_bag(tmp_path: Path, database: Path, suffix: str) -> None:
    """Opening a pipe to which nobody writes waits for ever."""
    pipe = tmp_path / f'a{suffix}'
    os.mkfifo(pipe)
    with pytest.raises(BagError, match='must be'):
        list(read_bag(pipe))
    database.unlink()
    os.mkfifo(database)
    with pytest.raises(BagError, match='must be'):
        list(read_bag(database.parent))
    for verb in ('recover', 'report'):
        assert main([verb, str(pipe)]) == 1
