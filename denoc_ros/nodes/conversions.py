"""Raw CDR bytes in, arrays out: what the input topics say, or why it is refused.

Parsing a JointState of known layout costs 2-3 us here against 15-20 us through a message object.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LITTLE_ENDIAN = b'\x00\x01'
ENCAPSULATION = 4  # bytes before the payload; alignment counts from its end
INTEGERS = {1: ('<', struct.Struct('<I'), struct.Struct('<i'))}
INTEGERS[0] = ('>', struct.Struct('>I'), struct.Struct('>i'))


class InputError(Exception):
    """An input message is refused; `cause` is the word it is counted under."""

    def __init__(self, cause: str, message: str) -> None:
        self.cause = cause
        super().__init__(message)


class CdrReader:
    """Reads plain CDR, little or big endian, in order."""

    def __init__(self, raw: bytes) -> None:
        if len(raw) < ENCAPSULATION or raw[0] != 0 or raw[1] not in (0, 1):
            raise InputError('malformed', f'encapsulation must be plain CDR, got {raw[:4].hex()}')
        self._raw = raw
        self._order, self._uint, self._int = INTEGERS[raw[1]]
        self.position = ENCAPSULATION

    def _align(self, size: int) -> None:
        self.position += -(self.position - ENCAPSULATION) % size

    def _take(self, layout: struct.Struct) -> int:
        self._align(4)
        if self.position + 4 > len(self._raw):
            raise InputError('malformed', f'message must not end at byte {len(self._raw)}')
        (value,) = layout.unpack_from(self._raw, self.position)
        self.position += 4
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
        if count > len(self._raw):
            raise InputError('malformed', f'sequence must fit its message, got {count} elements')
        return count

    def string(self) -> str:
        """Read a string."""
        length = self.count()
        end = self.position + length
        if end > len(self._raw):
            raise InputError('malformed', f'message must not end at byte {len(self._raw)}')
        text = self._raw[self.position : end - 1 if length else end]
        self.position = end
        return text.decode('utf-8', 'replace')

    def strings(self) -> list[str]:
        """Read a sequence of strings."""
        return [self.string() for _ in range(self.count())]

    def float64(self) -> float:
        """Read a double."""
        return float(self._doubles(1)[0])

    def doubles(self) -> Array:
        """Read a sequence of doubles (a view into the message)."""
        return self._doubles(self.count())

    def _doubles(self, count: int) -> Array:
        if count == 0:
            return np.empty(0)
        self._align(8)
        end = self.position + 8 * count
        if end > len(self._raw):
            raise InputError('malformed', f'message must not end at byte {len(self._raw)}')
        values = np.frombuffer(self._raw, self._order + 'f8', count, self.position)
        self.position = end
        return values


def joint_map(
    given: Sequence[str], wanted: Sequence[str], known: Sequence[str] | None = None
) -> NDArray[np.intp]:
    """Return where in `given` each of `wanted` stands.

    Raises
    ------
    InputError
        Cause `unknown_joint` (not one of `known`, if these are given), `missing_joint` or
        `repeated_joint`.
    """
    places = {name: place for place, name in enumerate(given)}
    if len(places) != len(given):
        raise InputError('repeated_joint', f'joint names must differ, got {list(given)}')
    unknown = [] if known is None else sorted(set(given) - set(known))
    if known is not None and unknown:
        raise InputError('unknown_joint', f'joint must be one of {list(known)}, got {unknown}')
    missing = [name for name in wanted if name not in places]
    if missing:
        raise InputError('missing_joint', f'message must have joints {missing}, got {list(given)}')
    return np.array([places[name] for name in wanted], dtype=np.intp)


class JointStateReader:
    """Reads the JointState messages of one topic into arrays in the order of `joints`.

    After a successful `read`, `stamp_ns`, `position`, `velocity` and `effort` (each (n,), zeros
    where the message has none) hold the message until the next one; `has_velocity` and
    `has_effort` say what it had. Velocities or efforts of which one is NaN count as none: so
    joint_state_broadcaster fills what a joint has no interface for.

    Parameters
    ----------
    joints : sequence of str
        Those that every message must have.
    allow_extra : bool
        Whether others may come along.
    known : sequence of str, optional
        Those that may come along in any case; default none but `joints`.
    """

    def __init__(
        self,
        joints: Sequence[str],
        allow_extra: bool = False,
        known: Sequence[str] | None = None,
    ) -> None:
        n = len(joints)
        self.joints = tuple(joints)
        self.stamp_ns = 0
        self.position: Array = np.zeros(n)
        self.velocity: Array = np.zeros(n)
        self.effort: Array = np.zeros(n)
        self.has_velocity = False
        self.has_effort = False
        self._joints_known = None if allow_extra else tuple(known or joints)
        self._known = b''  # frame_id and names of the last message, as bytes
        self._end = 0
        self._map: NDArray[np.intp] = np.arange(n)
        self._count = n

    def read(
        self, raw: bytes, admit: Callable[[int], None] | None = None, with_effort: bool = False
    ) -> None:
        """Read one message.

        Parameters
        ----------
        raw : bytes
        admit : callable, optional
            Takes the stamp [ns] of a good message before the arrays do; may raise InputError.
        with_effort : bool
            Whether the message must have effort.

        Raises
        ------
        InputError
            Causes `malformed`, `unknown_joint`, `missing_joint`, `repeated_joint`,
            `wrong_length`, `non_finite`, `missing_effort`; the arrays keep what they had.
        """
        if not (self._end and raw[:2] == LITTLE_ENDIAN and raw[12 : self._end] == self._known):
            self._learn(raw)
        reader = CdrReader(raw)
        stamp_ns = reader.stamp_ns()
        reader.position = self._end
        position, velocity, effort = reader.doubles(), reader.doubles(), reader.doubles()
        count = self._count
        if len(position) != count:
            raise InputError(
                'wrong_length', f'position must have {count} elements, got {len(position)}'
            )
        for what, values in (('velocity', velocity), ('effort', effort)):
            if len(values) not in (0, count):
                raise InputError(
                    'wrong_length', f'{what} must have {count} or no elements, got {len(values)}'
                )
        places = self._map
        position = position[places]
        has = 'NaN' if len(effort) else 'none'
        velocity, effort = _given(velocity, places), _given(effort, places)
        for what, values in (('position', position), ('velocity', velocity), ('effort', effort)):
            require_finite(what, values)
        if with_effort and not len(effort):
            raise InputError('missing_effort', f'effort must be given, got {has}')
        if admit is not None:
            admit(stamp_ns)
        self.stamp_ns = stamp_ns
        self.position = np.asarray(position, dtype=np.float64)
        self.has_velocity, self.has_effort = len(velocity) > 0, len(effort) > 0
        self.velocity = np.asarray(velocity, float) if len(velocity) else np.zeros(len(places))
        self.effort = np.asarray(effort, float) if len(effort) else np.zeros(len(places))

    def _learn(self, raw: bytes) -> None:
        """Remember where the doubles of a layout begin and which joint stands where."""
        self._end = 0
        reader = CdrReader(raw)
        reader.stamp_ns()
        reader.string()
        names = reader.strings()
        self._map = joint_map(names, self.joints, self._joints_known)
        self._count = len(names)
        self._end = reader.position
        self._known = raw[12 : self._end]


def _given(values: Array, places: NDArray[np.intp]) -> Array:
    """Return the values at `places`, none where one of them is NaN."""
    if not len(values):
        return values
    chosen = values[places]
    return chosen[:0] if any(map(math.isnan, chosen.tolist())) else chosen


def joint_names(raw: bytes) -> tuple[str, ...]:
    """Return the names of a JointState message; InputError `malformed` where there are none."""
    reader = CdrReader(raw)
    reader.stamp_ns()
    reader.string()
    return tuple(reader.strings())


def require_finite(what: str, values: Array) -> None:
    """Refuse values that are not all finite."""
    # faster than np.isfinite(values).all() for the few elements of a message
    if not all(map(math.isfinite, values.tolist())):
        raise InputError('non_finite', f'{what} must be finite, got {values.tolist()}')


@dataclass(frozen=True)
class TrajectoryMessage:
    """A JointTrajectory in the order of the node's joints."""

    stamp_ns: int  # of the header; 0: start now
    times: Array  # (k,) time_from_start [s]
    positions: Array  # (k, n) rad or m
    velocities: Array | None  # (k, n)
    accelerations: Array | None  # (k, n)
    effort: Array | None = field(default=None)  # (k, n)
    held: tuple[int, ...] = ()  # joints that it does not name: zeros stand for them

    @property
    def is_streamed(self) -> bool:
        """Whether it is one point for now, not a trajectory to interpolate."""
        return len(self.times) == 1 and self.times[0] == 0.0

    @property
    def is_cancel(self) -> bool:
        """Whether it has no points: what is followed ends."""
        return len(self.times) == 0

    def holding(self, q: Array) -> TrajectoryMessage:
        """Return the message with the joints that it does not name standing as in `q` (n,)."""
        held = list(self.held)
        positions = self.positions.copy()
        positions[:, held] = q[held]
        return replace(self, positions=positions, held=())


def read_trajectory(raw: bytes, joints: Sequence[str], partial: bool = False) -> TrajectoryMessage:
    """Read one JointTrajectory.

    Parameters
    ----------
    raw : bytes
    joints : sequence of str
        The node's n joints.
    partial : bool
        Whether it may name some of them only, or have no points.

    Raises
    ------
    InputError
        Causes `malformed`, `empty`, `unknown_joint`, `missing_joint`, `repeated_joint`,
        `wrong_length`, `non_finite`, `times_not_increasing`.
    """
    reader = CdrReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string()
    names = reader.strings()
    count = reader.count()
    rows: list[tuple[Array, Array, Array, Array]] = []
    times = np.empty(count)
    for point in range(count):
        rows.append((reader.doubles(), reader.doubles(), reader.doubles(), reader.doubles()))
        times[point] = 1e-9 * reader.stamp_ns()
    if count == 0:
        if partial:
            return TrajectoryMessage(stamp_ns, times, np.zeros((0, len(joints))), None, None)
        raise InputError('empty', 'trajectory must have points, got none')
    named = [name for name in joints if name in names] if partial else []
    places = joint_map(names, named or joints, joints)
    held = tuple(k for k, name in enumerate(joints) if named and name not in names)
    if (np.diff(times) <= 0.0).any() or times[0] < 0.0:
        raise InputError(
            'times_not_increasing', f'time_from_start must increase from >= 0, got {times}'
        )
    columns = [
        _stack(what, [row[place] for row in rows], len(names), places, held)
        for place, what in enumerate(('positions', 'velocities', 'accelerations', 'effort'))
    ]
    position, velocity, acceleration, effort = columns
    if position is None:
        raise InputError('wrong_length', f'positions must have {len(names)} elements, got 0')
    return TrajectoryMessage(stamp_ns, times, position, velocity, acceleration, effort, held)


def has_many_points(raw: bytes) -> bool:
    """Say whether a JointTrajectory has more than one point; one that cannot be read has not."""
    try:
        reader = CdrReader(raw)
        reader.stamp_ns()
        reader.string()
        reader.strings()
        return reader.count() > 1
    except InputError:
        return False


def _stack(
    what: str,
    rows: list[Array],
    count: int,
    places: NDArray[np.intp],
    held: tuple[int, ...],
) -> Array | None:
    """Return the points' values as (k, n), 0 for joints held; None if no point has any."""
    if not any(len(row) for row in rows):
        return None
    for row in rows:
        if len(row) != count:
            raise InputError('wrong_length', f'{what} must have {count} elements, got {len(row)}')
    values = np.array(rows, dtype=np.float64)[:, places]
    require_finite(what, values.ravel())
    for place in held:
        values = np.insert(values, place, 0.0, axis=1)
    return values


class CommandReader:
    """Reads Float64MultiArray commands whose `layout.dim[0].label` names the joints."""

    def __init__(self, joints: Sequence[str]) -> None:
        self.joints = tuple(joints)
        self.values: Array = np.zeros(len(joints))
        self._known = b''
        self._map: NDArray[np.intp] = np.arange(len(joints))
        self._count = len(joints)

    def read(self, raw: bytes) -> None:
        """Read one message into `values`, 0 for joints that it does not name.

        Raises
        ------
        InputError
            Causes `malformed`, `unnamed`, `unknown_joint`, `repeated_joint`, `wrong_length`,
            `non_finite`.
        """
        if not (self._known and raw.startswith(self._known)):
            self._learn(raw)
        reader = CdrReader(raw)
        reader.position = len(self._known)
        values = reader.doubles()
        if len(values) != self._count:
            raise InputError(
                'wrong_length', f'data must have {self._count} elements, got {len(values)}'
            )
        require_finite('data', values)
        result = np.zeros(len(self.joints))
        result[self._map] = values
        self.values = result

    def _learn(self, raw: bytes) -> None:
        self._known = b''
        reader = CdrReader(raw)
        labels = []
        for _ in range(reader.count()):
            labels.append(reader.string())
            reader.uint32()
            reader.uint32()
        reader.uint32()  # data_offset
        names = [name.strip() for name in labels[0].split(',')] if labels else []
        if not labels or not labels[0]:
            raise InputError('unnamed', 'layout.dim[0].label must name the joints, got none')
        if len(set(names)) != len(names):
            raise InputError('repeated_joint', f'joint names must differ, got {names}')
        unknown = sorted(set(names) - set(self.joints))
        if unknown:
            raise InputError(
                'unknown_joint', f'joint must be one of {list(self.joints)}, got {unknown}'
            )
        self._map, self._count = joint_map(self.joints, names), len(names)
        self._known = raw[: reader.position]
