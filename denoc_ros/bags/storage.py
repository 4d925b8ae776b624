"""One MCAP file: written so that a kill or a full disk leaves its complete part readable.

Its end is written anew after the disk refused a part of it; files that are deleted, moved,
replaced or cut during the recording are noticed.
"""

from __future__ import annotations

import dataclasses
import os
import struct
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Message,
    MessageIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from denoc_ros.bags.metadata import ChannelKey, FileContents, Topic
from denoc_ros.decompression import decompressed

COMPRESSIONS = {
    'none': CompressionType.NONE,
    'lz4': CompressionType.LZ4,
    'zstd': CompressionType.ZSTD,
}
_CHUNK_SIZE = 1 << 20
# what reading torn bytes raises: mcap's own errors (an end too early, a wrong magic, a length
# beyond the file), half a number (struct), and ValueError: names that are no UTF-8, a wrong
# checksum, a chunk that cannot be opened; lengths that no memory has (Overflow-, MemoryError).
# Errors of the disk and of this program pass.
TORN = (McapError, struct.error, ValueError, OverflowError, MemoryError)
MOVED = 'a moved or renamed one'
MAGIC = b'\x89MCAP0\r\n'
_HEAD = struct.Struct('<BQ')
CLOSED_DESCRIPTOR = -1  # descriptor of a file that is closed


def library_name() -> str:
    """Return name and version of this library, for the header of a file."""
    return f'denoc_ros {version("denoc_ros")}'


class DiskFile:
    """A new unbuffered file: each `write` reaches the kernel."""

    def __init__(self, path: Path) -> None:
        # appending: a file that somebody cut stays short, so that it is noticed
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
        self._descriptor = os.open(path, flags, 0o644)
        self._position = 0

    def write(self, block: bytes) -> int:
        """Write all of a block, or raise OSError."""
        rest = memoryview(block)
        while rest:
            written = os.write(self._descriptor, rest)
            self._position += written
            rest = rest[written:]
        return len(block)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._position

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def truncate(self, size: int) -> None:
        """Cut the file back to a size [bytes] and go on from there."""
        os.ftruncate(self._descriptor, size)
        os.lseek(self._descriptor, size, os.SEEK_SET)
        self._position = size

    def status(self) -> os.stat_result:
        """Return the system's status of the file, wherever it is now."""
        return os.fstat(self._descriptor)

    def close(self, synced: bool = True) -> None:
        """Close the file, and wait until the disk has it; closing again does nothing.

        Parameters
        ----------
        synced : bool
            Whether to wait: a loss of power then loses nothing.
        """
        descriptor, self._descriptor = self._descriptor, CLOSED_DESCRIPTOR
        if descriptor == CLOSED_DESCRIPTOR:
            return
        try:
            if synced:
                os.fsync(descriptor)
        finally:
            os.close(descriptor)


class McapFile:
    """Writes one MCAP file of profile ros2.

    Parameters
    ----------
    path : Path
        A file that does not exist yet.
    chunk_size : int
        Largest chunk [bytes] before compression; a flush ends a chunk earlier.

    Raises
    ------
    OSError
        The disk does not take a new file; no part of it stays.
    """

    def __init__(self, path: Path, compression: str, chunk_size: int = _CHUNK_SIZE) -> None:
        self.path = path
        self.contents = FileContents(path.name)
        self._disk = DiskFile(path)
        self._writer = Writer(
            self._disk, chunk_size=chunk_size, compression=COMPRESSIONS[compression]
        )
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[ChannelKey, Channel] = {}
        self._complete = 0
        try:
            self._writer.start('ros2', library_name())
            self.flush()
        except BaseException:
            self._disk.close(synced=False)
            path.unlink(missing_ok=True)
            raise

    @property
    def size(self) -> int:
        """Bytes on disk; up to a chunk more may wait in memory."""
        return self._disk.tell()

    def add_topic(self, topic: Topic, definition: str) -> None:
        """Register a topic with the ros2msg text of its type."""
        if topic.type not in self._schemas:
            content = definition.encode()
            number = self._writer.register_schema(topic.type, 'ros2msg', content)
            self._schemas[topic.type] = Schema(
                id=number, name=topic.type, encoding='ros2msg', data=content
            )
        schema = self._schemas[topic.type].id
        metadata = {'offered_qos_profiles': topic.qos}
        number = self._writer.register_channel(topic.name, topic.encoding, schema, metadata)
        self._channels[topic.key] = Channel(
            id=number,
            topic=topic.name,
            message_encoding=topic.encoding,
            metadata=metadata,
            schema_id=schema,
        )

    def write(self, channel: ChannelKey, stamp_ns: int, raw: bytes, publish_ns: int) -> None:
        """Append one message as it came from the wire."""
        sequence = self.contents.counts[channel] & 0xFFFFFFFF
        self._writer.add_message(self._channels[channel].id, stamp_ns, raw, publish_ns, sequence)
        self.contents.add(channel, stamp_ns)

    def attach(self, name: str, media_type: str, content: bytes, stamp_ns: int) -> None:
        """Append an attachment."""
        self._writer.add_attachment(stamp_ns, stamp_ns, name, media_type, content)

    def flush(self) -> None:
        """End the chunk: a process killed after this loses nothing written before."""
        self._writer.flush()
        self._complete = self._disk.tell()

    def finish(self) -> None:
        """Write the summary; `close` must follow."""
        self.flush()
        self._writer.finish()
        self.contents.size = self._disk.tell()

    def close(self) -> None:
        """Close a finished file when the disk has it."""
        self._disk.close()

    def displacement(self) -> str:
        """Fate of the file: deleted, replaced, cut; '' when it is as written."""
        status = self._disk.status()
        if not status.st_nlink:
            return 'one replaced by another' if self.path.exists() else 'a deleted one'
        if status.st_size != self._disk.tell():
            return cut(status.st_size, self._disk.tell())
        return '' if Identity.of(status).is_at(self.path) else MOVED

    def abandon(self, cause: str) -> None:
        """Close a displaced file; one that was only moved is finished, whole, where it is."""
        with suppress(OSError):
            if cause == MOVED:
                self.finish()
        self.contents.size = self._disk.tell()
        with suppress(OSError):
            self._disk.close(synced=cause == MOVED)

    def salvage(self) -> None:
        """Close the file after a failed write, whole up to the last flush.

        The summary needs room too: as many chunks go as that takes.
        """
        try:
            layout = read_layout(self.path, self._complete)
            while not self._try_ending(layout) and layout.chunks:
                layout.drop_last_chunk()
        finally:
            self._disk.close()
        self.contents = count_messages(self.path)

    def _try_ending(self, layout: McapIndex) -> bool:
        self._disk.truncate(layout.end)
        try:
            self._disk.write(layout.ending([*self._schemas.values()], [*self._channels.values()]))
        except OSError:
            # without an end, but all records complete: denoc recover reads it
            self._disk.truncate(layout.end)
            return False
        return True


class CompleteRecords:
    """Iterates over the complete records, those in chunks included, of a file that may be torn.

    Attributes
    ----------
    damaged_chunks : int
        Chunks left out so far because their content is not what was written.
    finished : bool
        Whether the file begins as one of MCAP, and its own end was reached.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self.damaged_chunks = 0
        self.finished = False
        # no record is longer than its file
        size = stream.seek(0, os.SEEK_END)
        stream.seek(0)
        self._begins = stream.read(len(MAGIC)) == MAGIC
        # The records of a file whose first bytes are damaged are as good as those of another.
        self._records = StreamReader(
            stream, skip_magic=True, emit_chunks=True, record_size_limit=size
        ).records

    def __iter__(self) -> Iterator[McapRecord]:
        """Yield records until the file ends or is torn."""
        while (record := self._next()) is not None:
            if isinstance(record, Chunk):
                yield from self._opened(record)
            else:
                yield record

    def _next(self) -> McapRecord | None:
        try:
            return next(self._records)
        except StopIteration:
            self.finished = self._begins
        except TORN:
            pass
        return None

    def _opened(self, chunk: Chunk) -> list[McapRecord]:
        try:
            content = decompressed(chunk.data, chunk.compression, chunk.uncompressed_size)
            opened = dataclasses.replace(chunk, compression='', data=content)
            return list(breakup_chunk(opened, validate_crc=True))
        except TORN:
            self.damaged_chunks += 1
            return []


def is_mcap(path: Path) -> bool:
    """Say whether a file is one of MCAP, though it be empty, cut off or damaged at its start."""
    with path.open('rb') as stream:
        start, code = stream.read(len(MAGIC)), stream.read(1)
    return MAGIC.startswith(start) or code == bytes([Opcode.HEADER])


def count_messages(path: Path) -> FileContents:
    """Return the content of the complete part of a file."""
    contents = FileContents(path.name)
    types: dict[int, str] = {}
    channels: dict[int, ChannelKey] = {}
    with path.open('rb') as stream:
        for record in CompleteRecords(stream):
            if isinstance(record, Schema):
                types[record.id] = record.name
            elif isinstance(record, Channel):
                channels[record.id] = record.topic, types.get(record.schema_id, '')
            elif isinstance(record, Message) and record.channel_id in channels:
                contents.add(channels[record.channel_id], record.log_time)
    return contents


@dataclass(frozen=True)
class Identity:
    """Which file or folder a path led to when it was made."""

    device: int
    number: int

    @classmethod
    def of(cls, status: os.stat_result) -> Identity:
        """Return the identity that a status tells."""
        return cls(status.st_dev, status.st_ino)

    def is_at(self, path: Path) -> bool:
        """Say whether a path leads there still; True where the system does not tell."""
        try:
            return Identity.of(path.stat()) == self
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            return True


def displacement(path: Path, size: int) -> str:
    """Fate of a finished file of a size [bytes]: deleted, moved, cut; '' when unchanged."""
    try:
        found = path.stat().st_size
    except (FileNotFoundError, NotADirectoryError):
        return 'a deleted or moved one'
    except OSError:  # the system does not tell
        return ''
    return '' if found == size else cut(found, size)


def cut(found: int, written: int) -> str:
    """Say that a file does not have the bytes that were written."""
    return f'one of {found} bytes instead of {written}'


@dataclass(frozen=True)
class Loss:
    """A file of a bag that was moved, deleted or damaged during the recording."""

    path: Path  # where it was
    cause: str  # what became of it
    contents: FileContents  # what had been written to it
    next_path: Path | None = None  # the file in which the recording goes on

    def __str__(self) -> str:
        """Return the event and the loss as a message to the user."""
        held = self.contents
        text = (
            f'{self.path}: file must stay as it is written, got {self.cause}; '
            f'{held.messages} messages, {held.size} bytes'
        )
        if held.messages:
            begin = datetime.fromtimestamp(held.start_ns // 10**9, timezone.utc)
            span = 1e-9 * (held.end_ns - held.start_ns)
            text += f', {span:.2f} s from {begin:%Y-%m-%d %H:%M:%S} UTC'
        text += ' are whole in it, not in this bag' if self.cause == MOVED else ' are lost'
        return f'{text}; goes on in {self.next_path}' if self.next_path else text


def free_paths(path: Path, suffix: str) -> Iterator[Path]:
    """Yield paths for a recording whose folder or file is gone: names by time."""
    name = f'{path.name.removesuffix(suffix)}_{time.strftime("%Y%m%d_%H%M%S")}'
    yield path.with_name(f'{name}{suffix}')
    for number in count(2):
        yield path.with_name(f'{name}_{number}{suffix}')


@dataclass
class McapIndex:
    """Where the chunks and attachments of a file lie."""

    end: int  # offset after the last of them [bytes]
    chunks: list[ChunkIndex] = field(default_factory=list)  # in file order
    counts: list[Counter[int]] = field(default_factory=list)  # messages by channel of each chunk
    attachments: list[AttachmentIndex] = field(default_factory=list)  # in file order

    def drop_last_chunk(self) -> None:
        """Leave out the last chunk and everything after it."""
        self.end = self.chunks.pop().chunk_start_offset
        self.counts.pop()
        self.attachments = [index for index in self.attachments if index.offset < self.end]

    def ending(self, schemas: Sequence[Schema], channels: Sequence[Channel]) -> bytes:
        """Return the bytes that belong after `end`: summary, footer and magic."""
        records = RecordBuilder()
        DataEnd(0).write(records)
        start = self.end + records.count
        for record in (*schemas, *channels, self._statistics(schemas, channels)):
            record.write(records)
        for record in (*self.chunks, *self.attachments):
            record.write(records)
        Footer(start, 0, 0).write(records)
        return bytes(records.end()) + MAGIC

    def _statistics(self, schemas: Sequence[Schema], channels: Sequence[Channel]) -> Statistics:
        counts = sum(self.counts, Counter[int]())
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(channels),
            channel_message_counts=dict(counts),
            chunk_count=len(self.chunks),
            message_count=sum(counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self.chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self.chunks), default=0),
            metadata_count=0,
            schema_count=len(schemas),
        )


def read_layout(path: Path, end: int) -> McapIndex:
    """Return the layout of the part of a file before an offset where a record ends."""
    layout = McapIndex(end)
    with path.open('rb') as stream:
        offset = len(MAGIC)
        while offset < end:
            stream.seek(offset)
            opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
            _add_record(layout, stream, opcode, offset, _HEAD.size + length)
            offset += _HEAD.size + length
    return layout


def _add_record(
    layout: McapIndex, stream: IO[bytes], opcode: int, offset: int, length: int
) -> None:
    content = ReadDataStream(stream)
    if opcode == Opcode.CHUNK:
        layout.chunks.append(chunk_index(Chunk.read(content), offset, length))
        layout.counts.append(Counter())
    elif opcode == Opcode.MESSAGE_INDEX:
        index = MessageIndex.read(content)
        layout.chunks[-1].message_index_offsets[index.channel_id] = offset
        layout.chunks[-1].message_index_length += length
        layout.counts[-1][index.channel_id] = len(index.records)
    elif opcode == Opcode.ATTACHMENT:
        found = Attachment.read(content)
        layout.attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                log_time=found.log_time,
                create_time=found.create_time,
                data_size=len(found.data),
                name=found.name,
                media_type=found.media_type,
            )
        )


def chunk_index(chunk: Chunk, offset: int, length: int) -> ChunkIndex:
    """Return the index of a chunk record at an offset, of a length [bytes]."""
    return ChunkIndex(
        chunk_length=length,
        chunk_start_offset=offset,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )
