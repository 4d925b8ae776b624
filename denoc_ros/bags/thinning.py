"""Thinned reading of a bag: messages in between are neither opened nor parsed."""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.reader import Summary, make_reader
from mcap.records import Chunk, ChunkIndex

from denoc_ros.bags.decompression import decompressed
from denoc_ros.bags.reader import mcap_files, only_bag_errors, read_raw, require_readable
from denoc_ros.bags.storage import require_bounded_chunks
from denoc_ros.errors import BagError
from denoc_ros.types import Stamps

RawMessage = tuple[str, str, int, bytes]  # topic, type, log time [ns], CDR

_RECORD = struct.Struct('<BQ')  # opcode and length
_MESSAGE = struct.Struct('<BQHIQQ')  # and channel, sequence, log time, publish time
_INDEX = struct.Struct('<BQHI')  # and channel, bytes of entries
_MESSAGE_CODE, _INDEX_CODE = 5, 7


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
    topics : collection of str
        Topics of the bag.
    step_ns : int
        Mean time between the messages kept of a topic, where it has more [ns]. The first message
        of each topic is always kept.
    early_ns, late_ns : float
        What is kept lies between them, since the first message of these topics [ns].

    Raises
    ------
    BagError
        As `read_raw`.
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
