"""Plain CDR, as messages are written in: read in order, little or big endian."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from denoc_ros.types import Array

ENCAPSULATION = 4  # bytes before the payload; alignment counts from its end
MOST_SECONDS = (1 << 31) - 1  # that a stamp can say
_STAMP = struct.Struct('<iI')
_INTEGERS = {
    1: ('<', struct.Struct('<I'), struct.Struct('<i')),
    0: ('>', struct.Struct('>I'), struct.Struct('>i')),
}


class CdrError(ValueError):
    """Bytes are no message."""


def aligned(at: int, size: int) -> int:
    """Return the next position that is a multiple of size, counted behind the encapsulation."""
    return at + -(at - ENCAPSULATION) % size


def stamp_fields(stamp_ns: int) -> tuple[int, int]:
    """Return seconds and nanoseconds of a stamp [ns].

    One that a message cannot say, as a clock that anybody publishes may show, becomes the nearest
    that it can.
    """
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return min(max(seconds, -MOST_SECONDS), MOST_SECONDS), nanoseconds


@lru_cache(maxsize=8)
def stamp_bytes(stamp_ns: int) -> bytes:
    """Return a stamp [ns] as little-endian bytes; the messages of a tick have the same one."""
    return _STAMP.pack(*stamp_fields(stamp_ns))


class CdrReader:
    """Reads plain CDR in order.

    Attributes
    ----------
    order : {'<', '>'}
        Of the bytes of a number.
    """

    def __init__(self, raw: bytes) -> None:
        if len(raw) < ENCAPSULATION or raw[0] != 0 or raw[1] not in (0, 1):
            self.fail(f'encapsulation must be plain CDR, got {raw[:4].hex()}')
        self.raw = raw
        self.order, self._uint, self._int = _INTEGERS[raw[1]]
        self.position = ENCAPSULATION

    def fail(self, rule: str, _cause: str = 'malformed') -> NoReturn:
        """Raise the error that callers expect, here for bytes that are no message."""
        raise CdrError(rule)

    def _end(self, size: int) -> int:
        end = self.position + size
        if end > len(self.raw):
            self.fail(f'message must not end at byte {len(self.raw)}')
        return end

    def _take(self, layout: struct.Struct) -> int:
        self.position = aligned(self.position, 4)
        end = self._end(4)
        (value,) = layout.unpack_from(self.raw, self.position)
        self.position = end
        return int(value)

    def uint32(self) -> int:
        """Read an unsigned integer."""
        return self._take(self._uint)

    def int32(self) -> int:
        """Read a signed integer."""
        return self._take(self._int)

    def stamp_ns(self) -> int:
        """Read a time or duration as nanoseconds."""
        seconds = self.int32()
        return seconds * 1_000_000_000 + self.uint32()

    def count(self) -> int:
        """Read the length of a sequence."""
        count = self.uint32()
        if count > len(self.raw):
            self.fail(f'sequence must fit its message, got {count} elements')
        return count

    def string(self) -> str:
        """Read a string."""
        length = self.count()
        end = self._end(length)
        text = bytes(self.raw[self.position : end - 1 if length else end])
        self.position = end
        return text.decode('utf-8', 'replace')

    def strings(self) -> list[str]:
        """Read a sequence of strings."""
        return [self.string() for _ in range(self.count())]

    def names(self) -> list[str]:
        """Read the joint names of a message."""
        return self.strings()

    def rows(self, count: int, stride: int) -> NDArray[np.uint8]:
        """Return the next bytes as rows (count or less, stride), as many as there are."""
        there = min(count, (len(self.raw) - self.position) // stride)
        flat = np.frombuffer(self.raw, np.uint8, there * stride, self.position)
        return flat.reshape(there, stride)

    def float64(self) -> float:
        """Read a double."""
        start = self._block(1)
        return float(np.frombuffer(self.raw, self.order + 'f8', 1, start)[0])

    def block(self) -> tuple[int, int]:
        """Pass over a sequence of doubles; return its first byte and their number."""
        count = self.count()
        return (self._block(count) if count else self.position), count

    def doubles(self) -> Array:
        """Read a sequence of doubles (a view into the message)."""
        start, count = self.block()
        return np.frombuffer(self.raw, self.order + 'f8', count, start) if count else np.empty(0)

    def _block(self, count: int) -> int:
        start = self.position = aligned(self.position, 8)
        self.position = self._end(8 * count)
        return start
