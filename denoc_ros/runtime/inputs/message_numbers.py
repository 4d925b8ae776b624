"""Numbers of messages of a known layout: taken, or put, by one compiled call.

A loop has some hundred microseconds for a tick; each small array that Python handles costs it one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags import cdr
from denoc_ros.bags.joint_state import FIELDS
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.kernels.runtime.message_values import (
    BOUNDS,
    BYTES_TYPE,
    COPIES,
    FIXED,
    GIVEN,
    JOINTS,
    LENGTH,
    MESSAGES,
    MOST_SECONDS,
    OUTGOING,
    PARTS,
    PATTERN,
    PLACES,
    RECORD,
    SOURCES,
    STAMPED,
    TARGETS,
    VALUES,
    bytes_type,
    put_numbers,
    take_numbers,
)
from denoc_ros.types import Array

# a vector, or some elements of one
Numbers = Array | tuple[Array, NDArray[np.intp]]


class NumberTaker:
    """Takes the numbers of messages of one little-endian layout, each by one compiled call.

    Parameters
    ----------
    raw : bytes
        A message of the layout.
    fixed : sequence of (int, int)
        First byte, and the one after the last, of parts that are the same in all of them.
    starts : sequence of three int or None
        First bytes of the rows of numbers: position, velocity, effort.
    places : (n,) array of int
        Which numbers of a row are taken.

    Attributes
    ----------
    values : (3, n) array
        Of the last message; zeros where it has none.
    given : memoryview of three int
        1 where it has them.
    """

    def __init__(
        self,
        raw: bytes,
        fixed: Sequence[tuple[int, int]],
        starts: Sequence[int | None],
        places: NDArray[np.intp],
    ) -> None:
        n = len(places)
        self.values: Array = np.zeros((len(FIELDS), n))
        given = np.zeros(len(FIELDS), dtype=np.int64)
        self.given = given.data  # read without an array's detours
        rows = np.full((len(FIELDS), n), -1, dtype=np.int64)
        for row, start in zip(rows, starts, strict=True):
            if start is not None:
                row[:] = start + 8 * places
        self._bounds: Array | None = None
        parts = np.array(fixed, dtype=np.int64)
        pattern = np.frombuffer(raw, np.uint8)
        self._record = np.zeros(RECORD, dtype=np.int64)
        self._kept = parts, pattern, rows, raw  # as long as the record has their addresses
        for at, array in (
            (PATTERN, pattern),
            (FIXED, parts),
            (PLACES, rows),
            (VALUES, self.values),
            (GIVEN, given),
        ):
            self._record[at] = array.ctypes.data
        self._record[[LENGTH, PARTS, JOINTS, BYTES_TYPE]] = len(raw), len(parts), n, bytes_type()
        self._address = self._record.ctypes.data
        self._take = entry(take_numbers)

    def take(self, raw: bytes, bounds: Array) -> int:
        """Take a message's numbers; return its stamp [ns], or OTHER as `take_numbers` does.

        `bounds` (4, n) are least and largest position, least and largest velocity.
        """
        if bounds is not self._bounds:
            self._bounds = np.ascontiguousarray(bounds, dtype=np.float64)
            self._record[BOUNDS] = self._bounds.ctypes.data
        return self._take(self._address, raw)


class Prebuilt(Protocol):
    """A message whose bytes stay where they are."""

    @property
    def raw(self) -> bytearray:
        """Of the message."""


class MessageFiller:
    """Copies numbers into prebuilt messages and stamps these, in one compiled call.

    Parameters
    ----------
    stamped : sequence of prebuilt messages
        With a header.
    copies : sequence of (array, array)
        The numbers of a message, and the array (of as many doubles) that they are copied from:
        the same at each call. A pair of array and indices is of some of its elements.
    """

    def __init__(
        self,
        stamped: Sequence[Prebuilt],
        copies: Sequence[tuple[Numbers, Numbers]],
    ) -> None:
        raws = [np.frombuffer(message.raw, np.uint8) for message in stamped]
        pairs = [(_addresses(target), _addresses(source)) for target, source in copies]
        if any(len(target) != len(source) for target, source in pairs):
            raise ValueError('a message must have as many numbers as the array they come from')
        targets, sources = (
            np.concatenate([np.zeros(0, np.int64), *side]) for side in zip(*pairs, strict=True)
        )
        messages = np.array([raw.ctypes.data for raw in raws], dtype=np.int64)
        record = np.zeros(OUTGOING, dtype=np.int64)
        record[[COPIES, MESSAGES, MOST_SECONDS]] = len(targets), len(messages), cdr.MOST_SECONDS
        for at, array in ((SOURCES, sources), (TARGETS, targets), (STAMPED, messages)):
            record[at] = array.ctypes.data
        # as long as the record has their addresses
        self._kept = raws, copies, targets, sources, messages, record
        self._address = record.ctypes.data
        self._put = entry(put_numbers)

    def fill(self, stamp_ns: int) -> None:
        """Bring the messages up to date, with a new stamp [ns]."""
        self._put(self._address, stamp_ns)


def _addresses(numbers: Numbers) -> NDArray[np.int64]:
    """Return the addresses (n,) of numbers."""
    array, places = numbers if isinstance(numbers, tuple) else (numbers, None)
    if array.ndim != 1 or array.dtype != np.float64:
        raise ValueError(f'numbers must be a vector of doubles, got {array.dtype}, {array.shape}')
    at = np.arange(len(array)) if places is None else np.asarray(places)
    return np.asarray(array.ctypes.data + array.strides[0] * at, dtype=np.int64)
