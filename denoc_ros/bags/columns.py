"""Joint states of one topic in bulk: bytes are laid out once, then only sliced or filled in."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.definitions import encode
from denoc_ros.bags.series import JointSeries
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
FIELDS = ('position', 'velocity', 'effort')
_ENCAPSULATION = 4
_EMPTY = (b'',) * len(FIELDS)
_STAMP = struct.Struct('<iI')
_COUNT = struct.Struct('<I')
_FIXED = 12  # encapsulation and stamp: what follows is the same in all messages of a publisher


@dataclass(frozen=True)
class _Layout:
    """Where the parts of a JointState stand in its bytes."""

    names: tuple[str, ...]
    fixed: bytes  # frame and names
    counts: tuple[int, ...]  # where the number of elements of each field stands
    blocks: tuple[tuple[int, int], ...]  # first byte and number of elements of each field

    def fits(self, raw: bytes) -> bool:
        """Say whether a message is laid out like this."""
        start, count = self.blocks[-1]
        return (
            raw[1] == 1
            and len(raw) >= start + 8 * count
            and raw[_FIXED : _FIXED + len(self.fixed)] == self.fixed
            and all(
                _COUNT.unpack_from(raw, at)[0] == block[1]
                for at, block in zip(self.counts, self.blocks, strict=True)
            )
        )


class JointStateEncoder:
    """Writes JointState messages of the same joints: only stamp and numbers change.

    Parameters
    ----------
    names : sequence of str
        The joints.
    fields : sequence of str
        Which of `FIELDS` its messages have; the others stay empty.
    """

    def __init__(self, names: Sequence[str], fields: Sequence[str]) -> None:
        zero = np.zeros(len(names))
        message = encode(JOINT_STATE, 0, {'name': list(names), **dict.fromkeys(fields, zero)})
        self._bytes = bytearray(message)
        places = dict(zip(FIELDS, _layout(message).blocks, strict=True))
        self._starts = [places[field][0] for field in fields]

    def encode(self, stamp_ns: int, *values: NDArray[np.float64]) -> bytes:
        """Return the CDR bytes of a message.

        Parameters
        ----------
        stamp_ns : int
            Goes into the header [ns].
        *values : (joints,) arrays
            One for each field, in their order.
        """
        message = self._bytes
        _STAMP.pack_into(message, _ENCAPSULATION, *divmod(stamp_ns, 1_000_000_000))
        for start, numbers in zip(self._starts, values, strict=True):
            message[start : start + 8 * len(numbers)] = numbers.astype('<f8').tobytes()
        return bytes(message)


class JointStateColumns:
    """Collects the raw messages of one topic; `series` makes arrays of them.

    Parameters
    ----------
    topic : str
        Named in errors.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self._layout: _Layout | None = None
        self._stamps: list[int] = []
        self._parts: list[tuple[_Layout, int, tuple[bytearray, ...]]] = []

    def append(self, raw: bytes, log_ns: int) -> None:
        """Take in one message's CDR bytes; a zero stamp counts as its log time [ns].

        Raises
        ------
        BagError
            When they are no JointState.
        """
        layout = self._layout
        if layout is None or not layout.fits(raw):
            layout = self._layout = self._learn(raw)
            self._parts.append((layout, len(self._stamps), tuple(map(bytearray, _EMPTY))))
        seconds, nanoseconds = _STAMP.unpack_from(raw, _ENCAPSULATION)
        self._stamps.append(seconds * 1_000_000_000 + nanoseconds or log_ns)
        for store, (start, count) in zip(self._parts[-1][2], layout.blocks, strict=True):
            store += raw[start : start + 8 * count]

    def series(self) -> JointSeries:
        """Return all messages as arrays; NaN where a message does not have a joint or field."""
        names = tuple(dict.fromkeys(name for part in self._parts for name in part[0].names))
        stamps = np.array(self._stamps, dtype=np.int64)
        fields = {field: np.full((len(stamps), len(names)), np.nan) for field in FIELDS}
        for layout, first, stores in self._parts:
            columns = [names.index(name) for name in layout.names]
            for field, store, (_, count) in zip(FIELDS, stores, layout.blocks, strict=True):
                if count:
                    rows = np.frombuffer(store, dtype='<f8').reshape(-1, count)
                    fields[field][first : first + len(rows), columns] = rows
        return JointSeries(stamps, names, **fields)

    def _learn(self, raw: bytes) -> _Layout:
        try:
            if raw[1] != 1:
                raise BagError(f'{self.topic}: messages must be little-endian CDR')
            layout = _layout(raw)
        except (struct.error, IndexError, UnicodeDecodeError) as error:
            raise BagError(
                f'{self.topic}: message must be a whole sensor_msgs/msg/JointState, '
                f'got {len(raw)} bytes'
            ) from error
        for field, (_, count) in zip(FIELDS, layout.blocks, strict=True):
            if count not in (0, len(layout.names)):
                raise BagError(
                    f'{self.topic}: {field} must have as many values as name has '
                    f'({len(layout.names)}) or none, got {count}'
                )
        return layout


def _layout(raw: bytes) -> _Layout:
    at = _FIXED + 4 + _COUNT.unpack_from(raw, _FIXED)[0]
    at = _aligned(at, 4)
    names = []
    number, at = _COUNT.unpack_from(raw, at)[0], at + 4
    for _ in range(number):
        at = _aligned(at, 4)
        length = _COUNT.unpack_from(raw, at)[0]
        names.append(bytes(raw[at + 4 : at + 4 + length - 1]).decode())
        at += 4 + length
    at = _aligned(at, 4)
    fixed = bytes(raw[_FIXED:at])
    counts, blocks = [], []
    for _ in FIELDS:
        count = _COUNT.unpack_from(raw, at)[0]
        start = _aligned(at + 4, 8) if count else at + 4
        counts.append(at)
        blocks.append((start, count))
        at = start + 8 * count
    if at > len(raw):
        raise struct.error('a message that ends early')
    return _Layout(tuple(names), fixed, tuple(counts), tuple(blocks))


def _aligned(at: int, size: int) -> int:
    """Return the next position that is a multiple of size, counted behind the encapsulation."""
    return at + -(at - _ENCAPSULATION) % size
