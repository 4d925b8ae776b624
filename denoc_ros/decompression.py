"""Decompression with bounds: every compressed file that a stranger may have written.

A size that a file declares bounds nothing. All bounds are checked on the bytes that come out,
piece by piece, so that a file of a few kilobytes fills neither memory nor disk.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO

import lz4.frame  # type: ignore[import-untyped]
import zstandard

LARGEST_CHUNK = 1 << 28  # bytes when opened: writers make chunks of a MiB or a few
MOST_AT_ONCE = 1 << 30  # bytes of chunks whose times overlap: they are open together
WINDOW_BITS = 27  # zstd frames may ask for a window of 2^27 bytes, as zstd's own tools allow
# Numbers of a recorded robot compress to a tenth at best; one that rests, to a fortieth.
LARGEST_RATIO = 100  # of a compressed file's content to its size
PIECE_BYTES = 1 << 20  # that are unpacked at once
_LOCAL_HEADER = struct.Struct('<26x2H')  # sizes of an entry's name and extra field
_RAW_DEFLATE = -15  # zlib's window bits for a stream without header, as zip archives have it


def decompressed(data: bytes, compression: str, size: int) -> bytes:
    """Return the content of a chunk.

    Raises
    ------
    ValueError
        The chunk is too large, damaged, or holds another number of bytes than it claims.
    """
    if size > LARGEST_CHUNK:
        raise ValueError(f'chunk must hold at most {LARGEST_CHUNK} bytes, got {size}')
    content = _opened(data, compression, size + 1)
    if len(content) != size:
        got = 'more' if len(content) > size else str(len(content))
        raise ValueError(f'chunk must hold the {size} bytes that it claims, got {got}')
    return content


def decompressed_message(data: bytes) -> bytes:
    """Return a message of a bag in which each one is compressed; errors as `decompressed`."""
    content = _opened(data, 'zstd', LARGEST_CHUNK + 1)
    if len(content) > LARGEST_CHUNK:
        raise ValueError(f'message must be at most {LARGEST_CHUNK} bytes, got more')
    return content


def _opened(data: bytes, compression: str, most: int) -> bytes:
    """Return the content, cut off where it is longer than `most` bytes."""
    if not compression:
        return data
    if compression not in ('lz4', 'zstd'):
        raise ValueError(f'compression must be none, lz4 or zstd, got {compression!r}')
    try:
        if compression == 'lz4':
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most))
        bounded = zstandard.ZstdDecompressor(max_window_size=1 << WINDOW_BITS)
        return bounded.stream_reader(data, read_across_frames=True).read(most)
    except (RuntimeError, EOFError, zstandard.ZstdError) as error:
        reason = str(error) or type(error).__name__
        raise ValueError(f'{compression} chunk must be whole, got: {reason}') from error


class ByteBudget:
    """Bytes that the files of one bag may still unpack to.

    Parameters
    ----------
    compressed : int
        Size of the files as they are on the disk [bytes].
    """

    def __init__(self, compressed: int) -> None:
        self.most = self.left = max(LARGEST_CHUNK, LARGEST_RATIO * compressed)

    def spend(self, size: int) -> None:
        """Count bytes that were unpacked; ValueError where they are too many."""
        self.left -= size
        if self.left < 0:
            raise ValueError(
                f'compressed files must unpack to at most {self.most} bytes, got more: '
                'unpack them with zstd if they are sound'
            )


class BudgetedFile(io.RawIOBase):
    """A file that is unpacked while it is read, within a budget."""

    def __init__(self, file: IO[bytes], budget: ByteBudget) -> None:
        self._file = file
        self._budget = budget

    def readable(self) -> bool:
        """Say that the file can be read."""
        return True

    def readinto(self, target: bytearray | memoryview) -> int:  # type: ignore[override]
        """Fill a buffer; return the number of bytes, 0 at the end."""
        content = self._file.read(len(target))
        self._budget.spend(len(content))
        target[: len(content)] = content
        return len(content)


def require_bounded(chunks: Iterable[tuple[int, int, int]]) -> None:
    """Refuse chunks that would fill the memory; (first time, last time, size [bytes]) of each."""
    steps = []
    for begin, end, size in chunks:
        if size > LARGEST_CHUNK:
            raise ValueError(f'chunk must hold at most {LARGEST_CHUNK} bytes, got {size}')
        steps += [(begin, 0, size), (max(begin, end), 1, -size)]
    together = 0
    for _, _, change in sorted(steps):
        together += change
        if together > MOST_AT_ONCE:
            raise ValueError(
                f'chunks of the same time must hold at most {MOST_AT_ONCE} bytes, got more'
            )


def inflated_size(pieces: Iterable[bytes], most: int, window_bits: int = zlib.MAX_WBITS) -> int:
    """Return the size [bytes] of the content of a deflate stream; counting ends beyond `most`."""
    unpacker, size = zlib.decompressobj(window_bits), 0
    for packed in pieces:
        while packed and size <= most and not unpacker.eof:
            size += len(unpacker.decompress(packed, PIECE_BYTES))
            packed = unpacker.unconsumed_tail
    while not unpacker.eof and size <= most and (rest := unpacker.decompress(b'', PIECE_BYTES)):
        size += len(rest)
    return size


def require_bounded_archive(path: Path, most: int) -> None:
    """Refuse a zip archive whose entries hold more bytes than allowed, or than they declare.

    Readers of archives trust the declared size: they unpack an entry whole and cut it off then.

    Raises
    ------
    ValueError
        For such an archive, and for compressions that cannot be read in pieces.
    zipfile.BadZipFile, OSError
        For a file that is no archive or not readable.
    """
    left = most
    with zipfile.ZipFile(path) as archive, Path(path).open('rb') as stream:
        for entry in archive.infolist():
            size = _entry_size(stream, entry, left)
            left -= size
            if left < 0:
                raise ValueError(f'content must be at most {most >> 20} MiB, got more')
            if size != entry.file_size:
                raise ValueError(
                    f'entry {entry.filename!r} must hold the {entry.file_size} bytes that it '
                    f'declares, got {size}'
                )


def _entry_size(stream: IO[bytes], entry: zipfile.ZipInfo, most: int) -> int:
    if entry.compress_type == zipfile.ZIP_STORED:
        return entry.compress_size
    if entry.compress_type != zipfile.ZIP_DEFLATED:
        raise ValueError(
            f'entry {entry.filename!r} must be stored or deflated, got compression '
            f'{entry.compress_type}'
        )
    stream.seek(entry.header_offset)
    header = stream.read(_LOCAL_HEADER.size)
    if len(header) < _LOCAL_HEADER.size:
        raise zipfile.BadZipFile('an entry begins behind the end')
    stream.seek(sum(_LOCAL_HEADER.unpack(header)), io.SEEK_CUR)
    try:
        return inflated_size(_pieces(stream, entry.compress_size), most, _RAW_DEFLATE)
    except zlib.error as error:
        raise zipfile.BadZipFile(str(error)) from error


def _pieces(stream: IO[bytes], size: int) -> Iterator[bytes]:
    while size > 0 and (piece := stream.read(min(size, PIECE_BYTES))):
        size -= len(piece)
        yield piece
