"""Chunks of a bag opened within bounds: of their claimed size, and never beyond it."""

from __future__ import annotations

from collections.abc import Iterable

import lz4.frame  # type: ignore[import-untyped]
import zstandard

LARGEST_CHUNK = 1 << 28  # bytes when opened: writers make chunks of a MiB or a few
MOST_AT_ONCE = 1 << 30  # bytes of chunks whose times overlap: they are open together
LARGEST_WINDOW = 1 << 27  # bytes that a zstd frame may ask for, as zstd's own tools allow


def decompressed(data: bytes, compression: str, size: int) -> bytes:
    """Return the content of a chunk.

    Parameters
    ----------
    data : bytes
        As in the file.
    compression : {'', 'lz4', 'zstd'}
    size : int
        Of the content [bytes], as the chunk claims. No more memory is taken.

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


def _opened(data: bytes, compression: str, most: int) -> bytes:
    """Return the content, cut off where it is longer than `most` bytes."""
    if not compression:
        return data
    if compression not in ('lz4', 'zstd'):
        raise ValueError(f'compression must be none, lz4 or zstd, got {compression!r}')
    try:
        if compression == 'lz4':
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most))
        bounded = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW)
        return bounded.stream_reader(data, read_across_frames=True).read(most)
    except (RuntimeError, EOFError, zstandard.ZstdError) as error:
        reason = str(error) or type(error).__name__
        raise ValueError(f'{compression} chunk must be whole, got: {reason}') from error


def require_bounded(chunks: Iterable[tuple[int, int, int]]) -> None:
    """Refuse chunks that would fill the memory; (first time, last time, size [bytes]) of each.

    Raises
    ------
    ValueError
        With the size of one, or of all that are open at once.
    """
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


def decompressed_message(data: bytes) -> bytes:
    """Return a message of a bag in which each one is compressed; errors as `decompressed`."""
    content = _opened(data, 'zstd', LARGEST_CHUNK + 1)
    if len(content) > LARGEST_CHUNK:
        raise ValueError(f'message must be at most {LARGEST_CHUNK} bytes, got more')
    return content
