"""The bytes of sensor_msgs/JointState: laid out once, then only sliced or filled in.

Names and frame are the same in all messages of a publisher. With its layout known a message of
six joints costs 2 us to read and 1.5 us to write, against 15 us through a message object.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.cdr import ENCAPSULATION, CdrReader, aligned, stamp_bytes
from denoc_ros.bags.definitions import encode
from denoc_ros.types import Array

JOINT_STATE = 'sensor_msgs/msg/JointState'
FIELDS = ('position', 'velocity', 'effort')
# columns of a command of all in one, for drives with a loop of their own
IMPEDANCE = ('position', 'velocity', 'stiffness', 'damping', 'effort')
_HEAD = 12  # encapsulation and stamp: what follows is the same in all messages of a publisher
_STAMPS = {'<': struct.Struct('<iI'), '>': struct.Struct('>iI')}
_EMPTY = np.empty(0)


def read_names(reader: CdrReader) -> tuple[str, ...]:
    """Return the names of a message, from its beginning on."""
    reader.stamp_ns()
    reader.string()
    return tuple(reader.names())


@dataclass(frozen=True)
class JointStateLayout:
    """Where the parts of a publisher's messages stand in their bytes."""

    names: tuple[str, ...]  # the joints
    order: str  # {'<', '>'}; of the bytes of a number
    head: bytes  # frame and names
    # where the number of elements of each of `FIELDS` stands, and that number
    counts: tuple[tuple[int, bytes], ...]
    blocks: tuple[tuple[int, int], ...]  # first byte and number of elements of each field

    @classmethod
    def of(cls, reader: CdrReader) -> JointStateLayout:
        """Return the layout of a message; fails as the reader does."""
        raw, names = reader.raw, read_names(reader)
        head = bytes(raw[_HEAD : reader.position])
        counts, blocks = [], []
        for _ in FIELDS:
            at = aligned(reader.position, 4)
            blocks.append(reader.block())
            counts.append((at, bytes(raw[at : at + 4])))
        return cls(names, reader.order, head, tuple(counts), tuple(blocks))

    def fits(self, raw: bytes) -> bool:
        """Say whether a message is laid out like this."""
        start, count = self.blocks[-1]
        return (
            len(raw) >= start + 8 * count
            and raw[1] == (self.order == '<')
            and raw[0] == 0
            and raw[_HEAD : _HEAD + len(self.head)] == self.head
            and all(raw[at : at + 4] == number for at, number in self.counts)
        )

    @property
    def fixed(self) -> list[tuple[int, int]]:
        """First byte, and the one after the last, of parts that are the same in all messages."""
        counts = [(at, at + len(number)) for at, number in self.counts]
        return [(0, 2), (_HEAD, _HEAD + len(self.head)), *counts]

    def stamp_ns(self, raw: bytes) -> int:
        """Return the header's stamp of a message that fits [ns]."""
        seconds, nanoseconds = _STAMPS[self.order].unpack_from(raw, ENCAPSULATION)
        return int(seconds * 1_000_000_000 + nanoseconds)

    def places(self, joints: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return where `words` has the values of joints (c,), in the order of `FIELDS`.

        Returns
        -------
        (f, c) array of int
            A row for each of the f fields that messages have.
        """
        starts = [(start - ENCAPSULATION) // 8 for start, count in self.blocks if count]
        return np.array(starts, dtype=np.intp)[:, np.newaxis] + joints

    def words(self, raw: bytes) -> Array:
        """All words behind the encapsulation of a message as doubles, strings included.

        One view of all of it takes less time than one of each field.
        """
        return np.frombuffer(
            raw, self.order + 'f8', (len(raw) - ENCAPSULATION) // 8, ENCAPSULATION
        )

    def values(self, raw: bytes) -> tuple[Array, ...]:
        """Return position, velocity and effort of a message that fits: views, or empty."""
        kind = self.order + 'f8'
        return tuple(
            np.frombuffer(raw, kind, count, start) if count else _EMPTY
            for start, count in self.blocks
        )

    def wrong_length(self) -> tuple[str, int] | None:
        """Return a field that has neither as many values as there are names nor none."""
        for field, (_, count) in zip(FIELDS, self.blocks, strict=True):
            if count not in (0, len(self.names)):
                return field, count
        return None


class JointStateMessage:
    """A message with fixed names: write `position`, `velocity`, `effort` in place.

    Parameters
    ----------
    names : sequence of str
        Joint, deflection or sensor names.
    fields : sequence of str
        Which of `FIELDS` the message has; the others stay empty.

    Attributes
    ----------
    raw : bytearray
        The message.
    """

    def __init__(self, names: Sequence[str], fields: Sequence[str], frame_id: str = '') -> None:
        zeros = dict.fromkeys(fields, np.zeros(len(names)))
        header = {'stamp': {'sec': 0, 'nanosec': 0}, 'frame_id': frame_id}
        message = encode(JOINT_STATE, 0, {'header': header, 'name': list(names), **zeros})
        layout = JointStateLayout.of(CdrReader(message))
        self.raw = bytearray(message)
        views = {
            field: np.frombuffer(self.raw, '<f8', count, start) if count else np.empty(0)
            for field, (start, count) in zip(FIELDS, layout.blocks, strict=True)
        }
        self.names = tuple(names)
        self.position: Array = views['position']
        self.velocity: Array = views['velocity']
        self.effort: Array = views['effort']
        self._views = [views[field] for field in fields]

    def encode(self, stamp_ns: int, *values: Array) -> bytes:
        """Return the CDR of a message.

        Parameters
        ----------
        stamp_ns : int
            Goes into the header [ns].
        *values : (names,) arrays
            One for each field, in the order that was given.
        """
        for view, numbers in zip(self._views, values, strict=True):
            view[:] = numbers
        return self.bytes(stamp_ns)

    def bytes(self, stamp_ns: int | None = None) -> bytes:
        """Return the message's CDR, its header with a new stamp [ns] if given."""
        if stamp_ns is not None:
            self.raw[ENCAPSULATION:_HEAD] = stamp_bytes(stamp_ns)
        return bytes(self.raw)
