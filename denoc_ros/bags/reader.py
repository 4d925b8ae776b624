"""Bags in: MCAP and db3, with or without metadata.yaml, message by message."""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.reader import Summary, make_reader
from mcap.records import Chunk, ChunkIndex
from rosbags.interfaces import MessageDefinitionFormat

from denoc_ros.bags.definitions import decode, message_types
from denoc_ros.bags.metadata import METADATA_NAME, ChannelKey, Qos, named_files
from denoc_ros.bags.rosbags_bounds import AnyReader
from denoc_ros.bags.storage import MAGIC, is_mcap, require_bounded_chunks
from denoc_ros.decompression import decompressed
from denoc_ros.errors import BagError, ConfigError
from denoc_ros.settings import parameter
from denoc_ros.types import Stamps

Stamp = Literal['header', 'log']
STAMP = parameter(
    'stamp',
    'header',
    'times of a bag: header stamps, or the times of recording (log)',
    choices=('header', 'log'),
)

DESCRIPTION_ATTACHMENT = 'robot_description.urdf'
SESSION_ATTACHMENT = 'session.json'  # what a simulated run was
DESCRIPTION_TOPIC = 'robot_description'
SESSION_DESCRIPTION_TOPIC = '/up/robot_description'  # of the nodes of a session alone
TEXT = 'std_msgs/msg/String'
RawMessage = tuple[str, str, int, bytes]  # topic, type, log time [ns], CDR

_RECORD = struct.Struct('<BQ')  # opcode and length
_MESSAGE = struct.Struct('<BQHIQQ')  # and channel, sequence, log time, publish time
_INDEX = struct.Struct('<BQHI')  # and channel, bytes of entries
_MESSAGE_CODE, _INDEX_CODE = 5, 7


@dataclass(frozen=True)
class BagMessage:
    """One message of a bag."""

    # its topic and message type, `package/msg/Name`
    topic: str
    type: str
    stamp_ns: int  # time by the stamp that was asked for [ns]
    log_ns: int  # when it was recorded [ns]
    raw: bytes  # its CDR bytes
    message: Any  # its fields, as attributes


@dataclass(frozen=True)
class RecordedTopic:
    """A topic as a bag holds it."""

    # the topic and its message type, `package/msg/Name`
    name: str
    type: str
    messages: int  # how many
    definition: str  # ros2msg text with all dependencies, '' where the bag does not carry it
    qos: tuple[Qos, ...]  # what its publishers offered


@dataclass(frozen=True)
class BagContents:
    """Content of a bag: topics, number of messages, first and last log time [ns].

    A topic whose type changed is there once for each type.
    """

    topics: tuple[RecordedTopic, ...]
    messages: int
    start_ns: int
    end_ns: int


def read_bag(
    path: str | Path, topics: Collection[str] | None = None, stamp: Stamp = 'header'
) -> Iterator[BagMessage]:
    """Iterate over the messages of a bag in the order of their log times.

    Parameters
    ----------
    path : str or Path
        A rosbag2 folder, a bare `.mcap` or a bare `.db3` file.
    topics : collection of str, optional
        Only these; each must be in the bag.
    stamp : {'header', 'log'}
        Where `stamp_ns` comes from. A message with no header, or a zero stamp in it, has its
        log time.

    Raises
    ------
    BagError
        When the bag cannot be read; for an unfinished recording it says how to recover it.
    """
    require_stamp(path, stamp)
    return _messages(Path(path), topics, stamp)


def require_stamp(path: str | Path, stamp: Stamp) -> None:
    """Raise BagError unless stamps are asked for that a bag has."""
    if stamp not in STAMP.choices:
        raise BagError(f'{path}: stamp must be header or log, got {stamp!r}')


def read_raw(path: str | Path, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Iterate over (topic, type, log time [ns], CDR bytes) of the messages, by log time.

    For those who take all of a long bag, or all of some topics, in one go: nothing is decoded.
    Arguments and errors as `read_bag`.
    """
    with _open(Path(path)) as reader:
        chosen = _connections(Path(path), reader, topics)
        if not chosen:
            return
        for connection, log_ns, raw in _raw_messages(path, reader, chosen):
            yield connection.topic, connection.msgtype, log_ns, raw


def bag_contents(path: str | Path) -> BagContents:
    """Return the contents of a bag without reading its messages; errors as `read_bag`."""
    with _open(Path(path)) as reader:
        topics: dict[ChannelKey, RecordedTopic] = {}
        for connection in reader.connections:
            key = connection.topic, connection.msgtype
            known = topics.get(key)
            topics[key] = _recorded(connection, known.messages if known else 0)
        spans = reader.message_count > 0
        return BagContents(
            tuple(topics.values()),
            reader.message_count,
            reader.start_time if spans else 0,
            reader.end_time if spans else 0,
        )


def bag_topics(path: str | Path) -> dict[str, str]:
    """Return the message type of each topic of a bag, the last one of a topic that has several.

    Errors as `read_bag`.
    """
    return {topic.name: topic.type for topic in bag_contents(path).topics}


def read_attachment(path: str | Path, name: str) -> bytes:
    """Return a file attached to a bag of MCAP, e.g. `robot_description.urdf`.

    Raises
    ------
    BagError
        When the bag cannot be read or has no such attachment.
    """
    source = require_readable(Path(path))
    found: set[str] = set()
    for part in mcap_files(source):
        with only_bag_errors(source), part.open('rb') as stream:
            for attachment in make_reader(stream).iter_attachments():
                if attachment.name == name:
                    return bytes(attachment.data)
                found.add(attachment.name)
    raise BagError(
        f'{path}: attachment must be one of {", ".join(sorted(found)) or "(none)"}, got {name!r}'
    )


def read_description(path: str | Path) -> str:
    """Return the robot's URDF as attached or as published last, '' if the bag has none.

    Errors as `read_bag`.
    """
    try:
        return read_attachment(path, DESCRIPTION_ATTACHMENT).decode()
    except BagError:
        topics = [topic for topic in bag_topics(path) if topic.endswith(DESCRIPTION_TOPIC)]
        if SESSION_DESCRIPTION_TOPIC in topics:
            topics = [SESSION_DESCRIPTION_TOPIC]
        items = read_bag(path, topics) if topics else iter(())
        published = [str(item.message.data) for item in items if item.type == TEXT]
        return published[-1] if published else ''


def _messages(path: Path, topics: Collection[str] | None, stamp: Stamp) -> Iterator[BagMessage]:
    with _open(path) as reader:
        chosen = _connections(path, reader, topics)
        if not chosen:
            return
        for connection, log_ns, raw in _raw_messages(path, reader, chosen):
            message, _ = decode(reader.typestore, connection.msgtype, raw)
            stamp_ns = (header_stamp_ns(message) if stamp == 'header' else 0) or log_ns
            yield BagMessage(
                connection.topic, connection.msgtype, stamp_ns, log_ns, bytes(raw), message
            )


def _raw_messages(
    path: str | Path, reader: Any, chosen: list[Any]
) -> Iterator[tuple[Any, int, bytes]]:
    """Yield (connection, log time [ns], CDR bytes); a database may hold anything else."""
    for connection, log_ns, raw in reader.messages(chosen):
        if not isinstance(raw, bytes):
            raise BagError(
                f'{path}: {connection.topic}: message must be bytes, got {type(raw).__name__}'
            )
        if not isinstance(log_ns, int):
            raise BagError(
                f'{path}: {connection.topic}: time of a message must be a whole number of ns, '
                f'got {log_ns!r}'
            )
        yield connection, log_ns, raw


def header_stamp_ns(message: Any) -> int:
    """Return the time in a message's header [ns], 0 when it has none."""
    stamp = getattr(getattr(message, 'header', None), 'stamp', None)
    return 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _recorded(connection: Any, before: int) -> RecordedTopic:
    text = connection.msgdef
    profiles = [
        Qos(
            profile.history.value,
            profile.depth,
            profile.reliability.value,
            profile.durability.value,
            profile.liveliness.value,
        )
        for profile in connection.ext.offered_qos_profiles
    ]
    return RecordedTopic(
        connection.topic,
        connection.msgtype,
        before + connection.msgcount,
        text.data if text.format is MessageDefinitionFormat.MSG else '',
        tuple(profiles),
    )


def _connections(path: Path, reader: Any, topics: Collection[str] | None) -> list[Any]:
    if topics is None:
        return list(reader.connections)
    present = {connection.topic for connection in reader.connections}
    missing = sorted(set(topics) - present)
    if missing:
        raise BagError(
            f'{path}: topics must be among {", ".join(sorted(present)) or "(none)"}, '
            f'got {", ".join(missing)}'
        )
    return [connection for connection in reader.connections if connection.topic in topics]


class _CommonTypes:
    """Types for bags that hold no definitions: built for those only, as it takes a while."""

    @property
    def fielddefs(self) -> Any:
        return message_types().fielddefs


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    source = require_readable(path)
    types = _CommonTypes()
    with only_bag_errors(path), AnyReader([source], default_typestore=types) as reader:
        for one in reader.connections:
            if not (isinstance(one.topic, str) and isinstance(one.msgtype, str)):
                rule = f'name and type of a topic must be text, got {one.topic!r}'
                raise BagError(f'{path}: {rule}, {one.msgtype!r}')
        yield reader


@contextmanager
def only_bag_errors(path: Path) -> Iterator[None]:
    """Convert every exception during the reading of a bag into a BagError that names it."""
    # damaged files lead the readers below to errors of nearly every kind
    try:
        yield
    except (BagError, GeneratorExit):
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise BagError(f'{path}: bag must be readable, got: {reason}') from error


def require_readable(path: Path) -> Path:
    """Return the path to open for a bag: a finished folder or a file.

    Raises
    ------
    BagError
        When there is none; for an unfinished recording it says how to recover it.
    """
    if not path.exists():
        raise BagError(f'{path}: bag must exist, got nothing there')
    if path.is_dir():
        return _require_finished_folder(path)
    if not path.is_file():
        raise BagError(f'{path}: bag must be a folder or a regular file, got another kind')
    if path.suffix not in ('.mcap', '.db3'):
        raise BagError(f'{path}: bag must be a rosbag2 folder, a .mcap or a .db3 file')
    # What does not even begin as MCAP is not unfinished but something else.
    if path.suffix == '.mcap' and is_mcap(path) and not _is_finished(path):
        raise BagError(_unfinished(path))
    return path


def mcap_files(source: Path) -> list[Path]:
    """Return the MCAP files of a bag: those that metadata.yaml names, or all in the folder."""
    if not source.is_dir():
        return [source]
    # Opening a pipe would wait for ever.
    found = sorted(part for part in source.glob('*.mcap') if part.is_file())
    try:
        named = named_files(source)
    except ConfigError:
        return found
    # the recorder leaves out what somebody spoiled
    return [part for part in found if part.name in named] or found


def _require_finished_folder(folder: Path) -> Path:
    parts = mcap_files(folder)
    unfinished = [part for part in parts if not _is_finished(part)]
    if (folder / METADATA_NAME).is_file() and not unfinished:
        try:
            named_files(folder)
        except ConfigError as error:
            raise BagError(
                f'{error}; run: denoc recover {folder}' if parts else str(error)
            ) from error
        return folder
    if parts:
        raise BagError(_unfinished(folder))
    databases = sorted(file for file in folder.glob('*.db3') if file.is_file())
    if len(databases) == 1:
        return databases[0]
    raise BagError(
        f'{folder}: bag folder must hold {METADATA_NAME} or one .db3 file, '
        f'got {len(databases)} of those'
    )


def _unfinished(path: Path) -> str:
    return (
        f'{path}: bag must be finished, got one that was cut off or damaged; '
        f'run: denoc recover {path}'
    )


def _is_finished(path: Path) -> bool:
    try:
        with path.open('rb') as stream:
            start = stream.read(len(MAGIC))
            stream.seek(max(path.stat().st_size - len(MAGIC), 0))
            return start == stream.read() == MAGIC
    except OSError as error:
        raise BagError(f'{path}: bag must be readable, got: {error.strerror}') from error


def read_thinned(
    path: str | Path,
    topics: Collection[str],
    step_ns: int,
    early_ns: float = -math.inf,
    late_ns: float = math.inf,
) -> Iterator[RawMessage]:
    """Iterate over (topic, type, log time [ns], CDR bytes) of about one message per step.

    Parameters
    ----------
    path : str or Path
        A bag that `read_raw` reads. The index of an MCAP file leads from one message to the next
        that is wanted; bags without one are read whole.
    step_ns : int
        Mean time between the messages kept of a topic, where it has more [ns]. The first message
        of each topic is always kept.
    early_ns, late_ns : float
        What is kept lies between them, since the first message of these topics [ns].
    """
    source = require_readable(Path(path))
    parts = mcap_files(source)
    picker = _Picker(step_ns, early_ns, late_ns)
    with only_bag_errors(source):
        indexed = [part.suffix == '.mcap' and _begin(part) for part in parts]
    if not parts or any(begin is None or begin is False for begin in indexed):
        for topic, kind, log_ns, raw in read_raw(path, topics):
            if len(picker.pick(topic, np.array([log_ns]))):
                yield topic, kind, log_ns, raw
        return
    for _, part in sorted(zip(indexed, parts, strict=True), key=lambda entry: entry[0] or 0):
        with only_bag_errors(source), part.open('rb') as stream:
            yield from _picked(stream, topics, picker)


class _Picker:
    """Decides which messages are kept."""

    def __init__(self, step_ns: int, early_ns: float, late_ns: float) -> None:
        self._step = max(step_ns, 1)
        self._early, self._late = early_ns, late_ns
        self._due: dict[str, int] = {}
        self._first = -1

    def pick(self, topic: str, times: Stamps) -> list[int]:
        """Return which of a topic's next messages are kept, by their log times (k,) [ns]."""
        kept: list[int] = []
        if self._first < 0:
            self._first = int(times[0])
        if topic not in self._due:
            self._keep(topic, int(times[0]))
            kept.append(0)
        row = max(len(kept), int(np.searchsorted(times, self._first + self._early)))
        while row < len(times):
            row = max(row, int(np.searchsorted(times, self._due[topic])))
            if row == len(times) or times[row] - self._first > self._late:
                break
            self._keep(topic, int(times[row]))
            kept.append(row)
            row += 1
        return kept

    def _keep(self, topic: str, log_ns: int) -> None:
        due = self._due.get(topic, log_ns)
        # a message that comes a little late does not put off those after it
        self._due[topic] = (due if log_ns - due <= self._step // 2 else log_ns) + self._step


def _begin(part: Path) -> int | None:
    """Return when a file's messages begin [ns], None where no index leads to all of them."""
    require_bounded_chunks(part)
    with part.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        return None
    if not all(chunk.message_index_offsets for chunk in summary.chunk_indexes):
        return None
    return summary.statistics.message_start_time if summary.chunk_indexes else None


def _picked(stream: IO[bytes], topics: Collection[str], picker: _Picker) -> Iterator[RawMessage]:
    summary = make_reader(stream).get_summary()
    assert summary is not None
    known = _channels(summary, topics)
    for chunk in sorted(summary.chunk_indexes, key=lambda index: index.message_start_time):
        kept = []
        for channel, (times, places) in _message_indexes(stream, chunk, set(known)).items():
            rows = picker.pick(known[channel][0], times)
            kept += [(int(times[row]), int(places[row]), channel) for row in rows]
        if not kept:
            continue
        content = _content(stream, chunk)
        for log_ns, place, channel in sorted(kept):
            yield *known[channel], log_ns, _message(content, place, channel)


def _channels(summary: Summary, topics: Collection[str]) -> dict[int, tuple[str, str]]:
    """Return topic and type of the channels that are wanted."""
    return {
        number: (channel.topic, summary.schemas[channel.schema_id].name)
        for number, channel in summary.channels.items()
        if channel.topic in topics
    }


def _message_indexes(
    stream: IO[bytes], chunk: ChunkIndex, wanted: set[int]
) -> dict[int, tuple[Stamps, Stamps]]:
    """Return log times [ns], ascending, and places in a chunk of its messages, by channel."""
    start = chunk.chunk_start_offset + chunk.chunk_length
    stream.seek(start)
    block = stream.read(chunk.message_index_length)
    found = {}
    for channel, offset in chunk.message_index_offsets.items():
        if channel not in wanted:
            continue
        code, _, indexed, size = _INDEX.unpack_from(block, offset - start)
        if (code, indexed) != (_INDEX_CODE, channel) or offset < start:
            raise BagError('its message index is damaged')
        at = offset - start + _INDEX.size
        entries = np.frombuffer(block[at : at + size], dtype='<u8').reshape(-1, 2)
        times = entries[:, 0].astype(np.int64)
        order = np.argsort(times, kind='stable')
        if len(times):
            found[channel] = times[order], entries[order, 1].astype(np.int64)
    return found


def _content(stream: IO[bytes], index: ChunkIndex) -> bytes:
    """Return a chunk's records, opened."""
    stream.seek(index.chunk_start_offset + _RECORD.size)
    chunk = Chunk.read(ReadDataStream(stream))
    return decompressed(chunk.data, chunk.compression, chunk.uncompressed_size)


def _message(content: bytes, place: int, channel: int) -> bytes:
    code, length, found, *_ = _MESSAGE.unpack_from(content, place)
    end = place + _RECORD.size + length
    if (code, found) != (_MESSAGE_CODE, channel) or end > len(content):
        raise BagError('its message index is damaged')
    return content[place + _MESSAGE.size : end]
