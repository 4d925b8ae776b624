"""The end of an MCAP file, written anew after the disk refused a part of it."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    MessageIndex,
    Schema,
    Statistics,
)

MAGIC = b'\x89MCAP0\r\n'
_HEAD = struct.Struct('<BQ')


@dataclass
class McapIndex:
    """Where the chunks and attachments of a file lie.

    Attributes
    ----------
    end : int
        Offset after the last of them [bytes].
    chunks : list of ChunkIndex
        In file order.
    counts : list of Counter
        Messages by channel of each chunk.
    attachments : list of AttachmentIndex
        In file order.
    """

    end: int
    chunks: list[ChunkIndex] = field(default_factory=list)
    counts: list[Counter[int]] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)

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
        layout.chunks.append(_chunk_index(Chunk.read(content), offset, length))
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


def _chunk_index(chunk: Chunk, offset: int, length: int) -> ChunkIndex:
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
