"""One MCAP file of any program: its topics, and its messages in the order of their times.

The summary section leads to the messages. A file whose summary is missing, or does not lead to all
of them, is read from its first record to its last.
"""

from __future__ import annotations

import heapq
import struct
import zlib
from array import array
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import IO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import Summary, make_reader
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Schema

from denoc_ros.bags.metadata import Connection, connection
from denoc_ros.bags.storage import MAGIC, TORN, chunk_index
from denoc_ros.decompression import decompressed, require_bounded
from denoc_ros.types import Stamps

_RECORD = struct.Struct('<BQ')  # opcode and length
_MESSAGE = struct.Struct('<BQHIQQ')  # and channel, sequence, log time, publish time
_INDEX = struct.Struct('<BQHI')  # and channel, bytes of entries
_CHUNK = struct.Struct('<BQQQQ')  # and first time, last time, size of its content [bytes]
_ENTRY_BYTES = 16  # time and place of a message in an index
NO_CHANNEL = 'its channel must be in the file, got none'
_END = (Opcode.DATA_END, Opcode.FOOTER)
_LATEST = 2**64  # ns, later than any time in a file
Channels = Collection[int]
Indexes = dict[int, tuple[Stamps, Stamps]]  # times [ns] and places of messages, by channel


@dataclass
class McapContents:
    """Where the records of a file are."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    # each chunk, with its messages by channel
    chunks: list[tuple[ChunkIndex, Counter[int]]] = field(default_factory=list)
    attachments: list[int] = field(default_factory=list)  # offsets [bytes]
    # of messages outside all chunks: time [ns], offset [bytes] and channel of each
    loose: array[int] = field(default_factory=lambda: array('Q'))
    is_indexed: bool = False  # whether the file's own index leads to all messages

    @property
    def counts(self) -> Counter[int]:
        """Messages by channel."""
        found = Counter(self.loose[2::3])
        for _, counts in self.chunks:
            found.update(counts)
        return found

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last time of a message [ns]; None where there is none."""
        filled = [chunk for chunk, counts in self.chunks if counts]
        times = [chunk.message_start_time for chunk in filled] + self.loose[::3].tolist()
        ends = [chunk.message_end_time for chunk in filled] + self.loose[::3].tolist()
        return (min(times), max(ends)) if times else None


class McapSource:
    """Reads one finished MCAP file.

    Raises
    ------
    ValueError
        For chunks that would fill the memory, and records that do not end within the file.
    """

    def __init__(self, path: Path) -> None:
        self._stream = path.open('rb')
        try:
            self.contents = read_contents(self._stream)
        except BaseException:
            self.close()
            raise
        counts = self.contents.counts
        channels = self.contents.channels
        self.connections = [self._connection(channels[n], counts[n]) for n in channels]
        self.connections += [
            connection(
                number, f'(channel {number})', '', counts[number], '', ('', ''), '', NO_CHANNEL
            )
            for number in sorted(counts.keys() - channels.keys())
        ]
        self.span = self.contents.span

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def messages(self, wanted: Channels) -> Iterator[tuple[int, int, bytes]]:
        """Iterate over (channel, log time [ns], bytes) of the wanted messages, by log time."""
        if not self.contents.loose:
            return self._in_chunks(wanted)
        return heapq.merge(self._in_chunks(wanted), self._outside(wanted), key=itemgetter(1))

    def attachments(self) -> Iterator[Attachment]:
        """Iterate over the attachments."""
        for offset in self.contents.attachments:
            self._stream.seek(offset)
            code, length = _RECORD.unpack(self._stream.read(_RECORD.size))
            if code != Opcode.ATTACHMENT:
                raise ValueError('its index of attachments is damaged')
            yield Attachment.read(_content_stream(self._stream.read(length)))

    def picked(
        self, wanted: Mapping[int, str], pick: Callable[[str, Stamps], list[int]]
    ) -> Iterator[tuple[int, int, bytes]]:
        """Iterate over the messages that are picked by the file's index, as `messages`.

        Parameters
        ----------
        wanted : mapping of int to str
            Channels and their topics.
        pick : callable
            Returns which of a topic's next messages are wanted, by their times (k,) [ns].
        """
        chunks = [chunk for chunk, _ in self.contents.chunks]
        for chunk in sorted(chunks, key=lambda one: one.message_start_time):
            kept = []
            for channel, (times, places) in self._message_indexes(chunk, wanted).items():
                rows = pick(wanted[channel], times)
                kept += [(int(times[row]), int(places[row]), channel) for row in rows]
            if not kept:
                continue
            content = self._opened(chunk)
            for log_ns, place, channel in sorted(kept):
                yield channel, log_ns, _message_at(content, place, channel)

    def _connection(self, channel: Channel, messages: int) -> Connection:
        schema = self.contents.schemas.get(channel.schema_id)
        encoding, text = (schema.encoding, schema.data) if schema is not None else ('', b'')
        return connection(
            channel.id,
            channel.topic,
            schema.name if schema is not None else '',
            messages,
            channel.message_encoding,
            (encoding, text.decode(errors='replace')),
            channel.metadata.get('offered_qos_profiles', ''),
        )

    def _in_chunks(self, wanted: Channels) -> Iterator[tuple[int, int, bytes]]:
        chunks = [
            chunk for chunk, counts in self.contents.chunks if not counts.keys().isdisjoint(wanted)
        ]
        chunks.sort(key=lambda chunk: chunk.message_start_time)
        starts = [*(chunk.message_start_time for chunk in chunks), _LATEST]
        waiting: list[tuple[int, int, int, bytes]] = []
        for chunk, following in zip(chunks, starts[1:], strict=True):
            place = chunk.chunk_start_offset
            waiting += [
                (log, place, *rest) for log, *rest in _messages(self._opened(chunk), wanted)
            ]
            # Of messages of one time, the first in the file comes first.
            waiting.sort(key=itemgetter(0, 1))
            ready = bisect_left(waiting, following, key=itemgetter(0))
            yield from ((channel, log, raw) for log, _, channel, raw in waiting[:ready])
            del waiting[:ready]

    def _outside(self, wanted: Channels) -> Iterator[tuple[int, int, bytes]]:
        rows = np.frombuffer(self.contents.loose, dtype=np.uint64).reshape(-1, 3)
        rows = rows[np.isin(rows[:, 2], list(wanted))]
        for row in np.argsort(rows[:, 0], kind='stable'):
            log, offset, channel = map(int, rows[row])
            self._stream.seek(offset)
            length = _RECORD.unpack(self._stream.read(_RECORD.size))[1]
            yield channel, log, self._stream.read(length)[_MESSAGE.size - _RECORD.size :]

    def _opened(self, index: ChunkIndex) -> bytes:
        self._stream.seek(index.chunk_start_offset + _RECORD.size)
        return _chunk_content(Chunk.read(ReadDataStream(self._stream)))

    def _message_indexes(self, chunk: ChunkIndex, wanted: Channels) -> Indexes:
        """Return times, ascending, and places of a chunk's messages."""
        start = chunk.chunk_start_offset + chunk.chunk_length
        self._stream.seek(start)
        block = self._stream.read(chunk.message_index_length)
        found = {}
        for channel, offset in chunk.message_index_offsets.items():
            if channel not in wanted:
                continue
            code, _, indexed, size = _INDEX.unpack_from(block, offset - start)
            if (code, indexed) != (Opcode.MESSAGE_INDEX, channel) or offset < start:
                raise ValueError('its message index is damaged')
            at = offset - start + _INDEX.size
            entries = np.frombuffer(block[at : at + size], dtype='<u8').reshape(-1, 2)
            times = entries[:, 0].astype(np.int64)
            order = np.argsort(times, kind='stable')
            if len(times):
                found[channel] = times[order], entries[order, 1].astype(np.int64)
        return found


def _message_at(content: bytes, place: int, channel: int) -> bytes:
    """Return the message that an index says to be at a place in an opened chunk."""
    code, length, found, *_ = _MESSAGE.unpack_from(content, place)
    end = place + _RECORD.size + length
    if (code, found) != (Opcode.MESSAGE, channel) or end > len(content):
        raise ValueError('its message index is damaged')
    return content[place + _MESSAGE.size : end]


def read_contents(stream: IO[bytes]) -> McapContents:
    """Return where the records of a file are; errors as `McapSource`."""
    if stream.read(len(MAGIC)) != MAGIC:
        raise ValueError('a file of MCAP must begin as one, got another kind')
    stream.seek(0)
    try:
        summary = make_reader(stream).get_summary()
    except TORN:
        summary = None
    if summary is not None:
        # The bounds hold before anything is opened, whatever else the summary says.
        _require_bounded(summary.chunk_indexes)
        found = _by_summary(stream, summary)
        if found is not None:
            return found
    known = McapContents()
    if summary is not None:  # channels without messages may be in the summary alone
        known = McapContents({**summary.schemas}, {**summary.channels})
    found = _by_scan(stream, known)
    _require_bounded([chunk for chunk, _ in found.chunks])
    return found


def _require_bounded(chunks: Collection[ChunkIndex]) -> None:
    require_bounded(
        (one.message_start_time, one.message_end_time, one.uncompressed_size) for one in chunks
    )


def _by_summary(stream: IO[bytes], summary: Summary) -> McapContents | None:
    """Return what a summary says, None where it does not lead to all messages."""
    known = summary.statistics
    chunks = [(chunk, _indexed_counts(chunk)) for chunk in summary.chunk_indexes]
    found = McapContents(summary.schemas, summary.channels, chunks, is_indexed=True)
    found.attachments = [one.offset for one in summary.attachment_indexes]
    counts = found.counts
    is_whole = (
        known is not None
        and bool(chunks)
        and known.message_count == counts.total()
        and known.attachment_count == len(found.attachments)
        and counts.keys() <= found.channels.keys()
        and {one.schema_id for one in found.channels.values()} <= {0, *found.schemas}
        and all(_is_chunk(stream, chunk) for chunk, _ in chunks)
    )
    return found if is_whole else None


def _indexed_counts(chunk: ChunkIndex) -> Counter[int]:
    """Return the messages by channel of a chunk, by the sizes of its indexes."""
    places = sorted((offset, channel) for channel, offset in chunk.message_index_offsets.items())
    end = chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length
    ends = [*(offset for offset, _ in places), end][1:]
    counts = {
        channel: (following - offset - _INDEX.size) // _ENTRY_BYTES
        for (offset, channel), following in zip(places, ends, strict=True)
    }
    return Counter({channel: count for channel, count in counts.items() if count})


def _is_chunk(stream: IO[bytes], index: ChunkIndex) -> bool:
    """Say whether the chunk of an index is where the index says, with its times and size."""
    stream.seek(index.chunk_start_offset)
    head = stream.read(_CHUNK.size)
    return len(head) == _CHUNK.size and _CHUNK.unpack(head) == (
        Opcode.CHUNK,
        index.chunk_length - _RECORD.size,
        index.message_start_time,
        index.message_end_time,
        index.uncompressed_size,
    )


def _by_scan(stream: IO[bytes], found: McapContents) -> McapContents:
    """Add what the records of a file say, from the first to the last."""
    size = stream.seek(0, 2) - len(MAGIC)
    place = len(MAGIC)
    while place + _RECORD.size <= size:
        stream.seek(place)
        code, length = _RECORD.unpack(stream.read(_RECORD.size))
        end = place + _RECORD.size + length
        if end > size:
            raise ValueError('a record does not end within the file: run denoc recover')
        if code in _END:
            break
        if code == Opcode.CHUNK:
            chunk = Chunk.read(_content_stream(stream.read(length)))
            found.chunks.append(_scanned_chunk(found, chunk, place, end - place))
        elif code == Opcode.ATTACHMENT:
            found.attachments.append(place)
        elif code == Opcode.MESSAGE:
            _, _, channel, _, log_ns, _ = _MESSAGE.unpack(
                _RECORD.pack(code, length) + stream.read(_MESSAGE.size - _RECORD.size)
            )
            found.loose.extend((log_ns, place, channel))
        elif code in (Opcode.SCHEMA, Opcode.CHANNEL):
            _define(found, code, stream.read(length))
        place = end
    return found


def _scanned_chunk(
    found: McapContents, chunk: Chunk, place: int, length: int
) -> tuple[ChunkIndex, Counter[int]]:
    """Return the place of a chunk and what it holds, and take in what it defines."""
    content = _chunk_content(chunk)
    counts: Counter[int] = Counter()
    times = []
    for code, begin, end in _records(content):
        if code == Opcode.MESSAGE:
            _, _, channel, _, log_ns, _ = _MESSAGE.unpack_from(content, begin)
            counts[channel] += 1
            times.append(log_ns)
        elif code in (Opcode.SCHEMA, Opcode.CHANNEL):
            _define(found, code, content[begin + _RECORD.size : end])
    chunk.message_start_time = min(times, default=0)
    chunk.message_end_time = max(times, default=0)
    return chunk_index(chunk, place, length), counts


def _define(found: McapContents, code: int, content: bytes) -> None:
    if code == Opcode.SCHEMA:
        schema = Schema.read(_content_stream(content))
        found.schemas[schema.id] = schema
    else:
        channel = Channel.read(_content_stream(content))
        found.channels[channel.id] = channel


def _content_stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _chunk_content(chunk: Chunk) -> bytes:
    content = decompressed(chunk.data, chunk.compression, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError('a chunk must have the checksum that it claims: run denoc recover')
    return content


def _records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Iterate over (opcode, begin, end) of the records of an opened chunk."""
    place, size = 0, len(content)
    while place < size:
        code, length = _RECORD.unpack_from(content, place)
        end = place + _RECORD.size + length
        if end > size or (code == Opcode.MESSAGE and end < place + _MESSAGE.size):
            raise ValueError('a record must end within its chunk: run denoc recover')
        yield code, place, end
        place = end


def _messages(content: bytes, wanted: Channels) -> Iterator[tuple[int, int, bytes]]:
    """Iterate over (log time [ns], channel, bytes) of the wanted messages of a chunk."""
    for code, begin, end in _records(content):
        if code == Opcode.MESSAGE:
            _, _, channel, _, log_ns, _ = _MESSAGE.unpack_from(content, begin)
            if channel in wanted:
                yield log_ns, channel, content[begin + _MESSAGE.size : end]
