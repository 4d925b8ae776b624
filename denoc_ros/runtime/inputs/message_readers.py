"""Raw CDR bytes in, arrays out: validated input messages, or the reason of refusal.

A JointState of known layout is compared, taken and checked in one call of a kernel. What does not
pass there is read step by step, which finds what is wrong with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import repeat
from operator import le
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.cdr import CdrReader, aligned
from denoc_ros.bags.joint_state import FIELDS, JointStateLayout, read_names
from denoc_ros.errors import ConfigError
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.kernels.runtime.message_values import OTHER, take_numbers
from denoc_ros.model.reading.poses import rotation_rpy
from denoc_ros.runtime.inputs.input_monitor import MOST_JOINTS, InputError
from denoc_ros.runtime.inputs.message_numbers import NumberTaker
from denoc_ros.runtime.safety.motion_bounds import MotionBounds
from denoc_ros.types import Array

LONGEST = 16384  # bytes of a message that a loop has time for
LARGEST_EFFORT = 1e9  # N m or N: more is no torque of a robot
SHORTEST = 1e-3  # s between two messages whose difference says what the base does
UNIT = 1e-3  # how far a quaternion may be from unit length
LARGEST = 1e6  # m/s, rad/s, and per s: more is no base's motion


class MessageReader(CdrReader):
    """Reader of an incoming message's CDR; a fault is an `InputError`."""

    def fail(self, rule: str, cause: str = 'malformed') -> NoReturn:
        """Refuse the message."""
        raise InputError(cause, rule)

    def names(self) -> list[str]:
        """Read the joint names of a message; too many are refused before they are read."""
        count = self.count()
        if count > MOST_JOINTS:
            rule = f'message must have at most {MOST_JOINTS} joints'
            raise InputError('too_many_joints', f'{rule}, got {count}')
        return [self.string() for _ in range(count)]


def joint_map(
    given: Sequence[str], wanted: Sequence[str], known: Sequence[str] | None = None
) -> NDArray[np.intp]:
    """Return the index in `given` of each of `wanted`.

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
    bounds : MotionBounds, optional
        What the joints can have; default everything finite.
    """

    def __init__(
        self,
        joints: Sequence[str],
        allow_extra: bool = False,
        known: Sequence[str] | None = None,
        bounds: MotionBounds | None = None,
    ) -> None:
        n = len(joints)
        self._bounds = bounds
        self.joints = tuple(joints)
        self.stamp_ns = 0
        self._rows: Array = np.zeros((len(FIELDS), n))  # of one message: who takes one may keep it
        self.has_velocity = False
        self.has_effort = False
        self._joints_known = None if allow_extra else tuple(known or joints)
        self._layout: JointStateLayout | None = None  # of the last message
        self._fields: list[str] = []  # that it has, and where their values are
        self._places: NDArray[np.intp] = np.zeros((0, n), dtype=np.intp)
        # within which any number is
        self._unbounded = np.outer((-np.inf, np.inf, -np.inf, np.inf), np.ones(n))
        self._taker: NumberTaker | None = None
        ready(take_numbers)  # not by the first message, in a loop

    def read(
        self, raw: bytes, admit: Callable[[int], None] | None = None, with_effort: bool = False
    ) -> None:
        """Read one message.

        Parameters
        ----------
        admit : callable, optional
            Takes the stamp [ns] of a good message before the arrays do; may raise InputError.
        with_effort : bool
            Whether the message must have effort.

        Raises
        ------
        InputError
            Causes `malformed`, `unknown_joint`, `missing_joint`, `repeated_joint`,
            `too_many_joints`, `wrong_length`, `non_finite`, `out_of_range`, `missing_effort`;
            the arrays keep what they had.
        """
        taker = self._taker
        if taker is not None:
            limits = self._unbounded if self._bounds is None else self._bounds.table
            stamp_ns = taker.take(raw, limits)
            _, has_velocity, has_effort = taker.given
            if stamp_ns != OTHER and (has_effort or not with_effort):
                if admit is not None:
                    admit(stamp_ns)
                self.stamp_ns, self._rows = stamp_ns, taker.values.copy()
                self.has_velocity, self.has_effort = has_velocity == 1, has_effort == 1
                return
        self._read_stepwise(raw, admit, with_effort)

    @property
    def position(self) -> Array:
        """Positions (n,) of the last message."""
        row: Array = self._rows[0]
        return row

    @property
    def velocity(self) -> Array:
        """Velocities (n,) of the last message."""
        row: Array = self._rows[1]
        return row

    @property
    def effort(self) -> Array:
        """Efforts (n,) of the last message."""
        row: Array = self._rows[2]
        return row

    def _read_stepwise(
        self, raw: bytes, admit: Callable[[int], None] | None, with_effort: bool
    ) -> None:
        """Read a message of any layout, or find its fault."""
        layout = self._layout
        if layout is None or not layout.fits(raw):
            layout = self._learn(raw)
        stamp_ns = layout.stamp_ns(raw)
        found = layout.words(raw)[self._places].astype(np.float64, copy=False)
        rows, given = np.zeros_like(self._rows), set()
        for what, values in zip(self._fields, found, strict=True):
            numbers = values.tolist()
            if all(map(math.isfinite, numbers)):
                rows[FIELDS.index(what)] = values
                given.add(what)
            elif what == 'position' or not any(map(math.isnan, numbers)):
                require_finite(what, values)
        has_velocity, has_effort = 'velocity' in given, 'effort' in given
        if self._bounds is not None:
            self._bounds.require(rows[0], rows[1] if has_velocity else None)
        if with_effort and not has_effort:
            has = 'NaN' if 'effort' in self._fields else 'none'
            raise InputError('missing_effort', f'effort must be given, got {has}')
        if admit is not None:
            admit(stamp_ns)
        self.stamp_ns, self._rows = stamp_ns, rows
        self.has_velocity, self.has_effort = has_velocity, has_effort

    def _learn(self, raw: bytes) -> JointStateLayout:
        """Remember where the values of a layout stand and which joint is where."""
        self._layout = self._taker = None
        layout = JointStateLayout.of(MessageReader(raw))
        places = joint_map(layout.names, self.joints, self._joints_known)
        joints, position = len(layout.names), layout.blocks[0][1]
        if position != joints:
            rule = f'position must have {joints} elements'
            raise InputError('wrong_length', f'{rule}, got {position}')
        if wrong := layout.wrong_length():
            what, count = wrong
            rule = f'{what} must have {joints} or no elements'
            raise InputError('wrong_length', f'{rule}, got {count}')
        blocks = zip(FIELDS, layout.blocks, strict=True)
        self._fields = [field for field, (_, count) in blocks if count]
        self._layout, self._places = layout, layout.places(places)
        if layout.order == '<' and len(places):
            starts = [start if count else None for start, count in layout.blocks]
            self._taker = NumberTaker(raw, layout.fixed, starts, places)
        return layout


def joint_names(raw: bytes) -> tuple[str, ...]:
    """Return the names of a JointState message; InputError `malformed` where there are none."""
    return read_names(MessageReader(raw))


def is_torque(values: Array) -> bool:
    """Say whether all values (n,) are finite and no larger than any robot's [N m or N]."""
    # NaN is no less than anything
    return all(map(le, map(abs, values.tolist()), repeat(LARGEST_EFFORT)))


def require_effort(values: Array) -> None:
    """Refuse efforts (n,) [N m or N] that no robot has."""
    largest = max(map(abs, values.tolist()), default=0.0)
    if largest > LARGEST_EFFORT:
        raise InputError(
            'out_of_range', f'data must be within {LARGEST_EFFORT:g} N m or N, got {largest:g}'
        )


def require_finite(what: str, values: Array) -> None:
    """Refuse values that are not all finite."""
    # faster than np.isfinite(values).all() for the few elements of a message
    if not all(map(math.isfinite, values.tolist())):
        wrong = values[~np.isfinite(values)]
        raise InputError('non_finite', f'{what} must be finite, got {wrong[0]}')


class CommandReader:
    """Reads Float64MultiArray commands whose `layout.dim[0].label` names the joints.

    Parameters
    ----------
    numbers : int
        Of each joint, one joint after the other; the last is the effort.

    Attributes
    ----------
    values : (joints,) array, or (joints, numbers) where there are several
    """

    def __init__(self, joints: Sequence[str], numbers: int = 1) -> None:
        self.joints, self._numbers = tuple(joints), numbers
        self.values: Array = np.zeros((len(joints), numbers) if numbers > 1 else len(joints))
        self._map: NDArray[np.intp] = np.arange(len(joints))
        # of the last message: what stands before its numbers, their type and place, its length
        self._known, self._kind, self._start, self._length = b'', '<f8', 0, 0
        self._taker: NumberTaker | None = None
        ready(take_numbers)  # not by the first message, in a loop
        self._bounds = LARGEST_EFFORT * np.outer((-1.0, 1.0, -1.0, 1.0), np.ones(len(joints)))

    def read(self, raw: bytes) -> None:
        """Read one message into `values`, 0 for joints that it does not name.

        Raises
        ------
        InputError
            Causes `malformed`, `unnamed`, `too_many_joints`, `unknown_joint`, `repeated_joint`,
            `wrong_length`, `non_finite`, `out_of_range`.
        """
        taker = self._taker
        if taker is not None and taker.take(raw, self._bounds) != OTHER:
            self.values = taker.values[0].copy()
            return
        if not (self._known and raw.startswith(self._known) and len(raw) == self._length):
            self._learn(raw)
        values = np.frombuffer(raw, self._kind, len(self._map) * self._numbers, self._start)
        if self._numbers > 1:
            require_finite('data', values)
            values = values.reshape(-1, self._numbers)
            require_effort(values[:, -1])
        elif not is_torque(values):
            require_finite('data', values)
            require_effort(values)
        result = np.zeros_like(self.values)
        result[self._map] = values
        self.values = result

    def _learn(self, raw: bytes) -> None:
        self._known, self._taker = b'', None
        reader = MessageReader(raw)
        labels, dimensions = [], reader.count()
        if dimensions > MOST_JOINTS:
            rule = f'layout must have at most {MOST_JOINTS} dimensions'
            raise InputError('too_many_joints', f'{rule}, got {dimensions}')
        for _ in range(dimensions):
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
        self._map = joint_map(self.joints, names)
        counted = aligned(reader.position, 4) + 4  # what pads from there on may be anything
        start, count = reader.block()
        expected = len(names) * self._numbers
        if count != expected:
            raise InputError('wrong_length', f'data must have {expected} elements, got {count}')
        self._kind, self._start, self._length = reader.order + 'f8', start, len(raw)
        self._known = raw[:counted]
        if reader.order == '<' and 0 < len(names) == len(self.joints) and self._numbers == 1:
            places = joint_map(names, self.joints)
            self._taker = NumberTaker(raw, [(0, counted)], (start, None, None), places)


class BaseLimits:
    """Refusal of readings that no base can have, before they count.

    Parameters
    ----------
    rate, acceleration, angular_acceleration : float
        Largest of any component [rad/s, m/s^2, rad/s^2].
    gap : float
        s after which two readings are not compared.
    """

    def __init__(
        self, rate: float, acceleration: float, angular_acceleration: float, gap: float
    ) -> None:
        self._rate, self._acceleration = rate, acceleration
        self._angular, self._gap = angular_acceleration, gap
        self.forget()

    def forget(self) -> None:
        """Compare the next reading with none."""
        self._time, self._twist = -math.inf, np.zeros(6)

    def require(self, time: float, twist: Array | None, acceleration: Array | None = None) -> None:
        """Refuse a reading at a time [s]: twist (6,), acceleration (3,) or (6,), None: not said.

        Raises
        ------
        InputError
            Cause `out_of_range`.
        """
        if acceleration is not None:
            _require_within('acceleration', acceleration[:3], self._acceleration, 'm/s^2')
            _require_within('angular acceleration', acceleration[3:], self._angular, 'rad/s^2')
        if twist is None:
            return
        _require_within('angular velocity', twist[3:], self._rate, 'rad/s')
        interval = time - self._time
        if 0.0 < interval <= self._gap:
            change = (twist - self._twist) / max(interval, SHORTEST)
            _require_within('change of velocity', change[:3], self._acceleration, 'm/s^2')
            _require_within('change of angular velocity', change[3:], self._angular, 'rad/s^2')

    def took(self, time: float, twist: Array) -> None:
        """Compare the next twist with this one (6,)."""
        self._time, self._twist = time, twist


def _require_within(what: str, values: Array, most: float, unit: str) -> None:
    largest = float(np.abs(values).max(initial=0.0))
    if largest > most:
        raise InputError(
            'out_of_range', f'the {what} must be at most {most:g} {unit}, got {largest:.6g}'
        )


def imu_mounting(where: str, source: str, xyz: Sequence[float], rpy: Sequence[float]) -> Array:
    """Return the pose (4, 4) of the IMU in the base frame that a node's parameters say.

    Raises
    ------
    ConfigError
        They are not three finite numbers each, or there is no IMU; every finding.
    """
    findings = []
    for name, given in (('base_imu_xyz', xyz), ('base_imu_rpy', rpy)):
        if len(given) != 3 or not np.isfinite(given).all():
            findings.append(f'parameter {name!r} must be three finite numbers, got {list(given)}')
        elif any(given) and source != 'imu':
            findings.append(
                f"parameter {name!r} must be 0 where 'base_motion' is {source!r} (it is the pose "
                f'of an IMU), got {list(given)}'
            )
    ConfigError.raise_any(where, findings)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_rpy(np.array(rpy, dtype=np.float64)), xyz
    return pose


def _numbers(reader: MessageReader, count: int) -> Array:
    return np.array([reader.float64() for _ in range(count)])


def _require_motion(what: str, values: Array) -> None:
    require_finite(what, values)
    largest = float(np.abs(values).max())
    if largest > LARGEST:
        raise InputError('out_of_range', f'{what} must be within {LARGEST:g}, got {largest:.6g}')


def _rotation(quaternion: Array) -> Array:
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= UNIT:
        raise InputError('no_rotation', f'orientation must have unit length, got {length:.6g}')
    x, y, z, w = quaternion / length
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def read_odometry(raw: bytes) -> tuple[int, Array, Array]:
    """Return stamp [ns], pose (4, 4) and twist (6,) in the child frame's axes of an Odometry."""
    reader = MessageReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string()
    reader.string()
    position, quaternion = _numbers(reader, 3), _numbers(reader, 4)
    for _ in range(36):
        reader.float64()
    twist = _numbers(reader, 6)
    require_finite('pose', np.concatenate([position, quaternion]))
    _require_motion('twist', twist)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = _rotation(quaternion), position
    return stamp_ns, pose, twist


def read_accel(raw: bytes) -> tuple[int, Array]:
    """Return stamp [ns] and acceleration (6,) of an AccelStamped."""
    reader = MessageReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string()
    acceleration = _numbers(reader, 6)
    _require_motion('accel', acceleration)
    return stamp_ns, acceleration


def read_imu(raw: bytes) -> tuple[int, Array, Array]:
    """Return stamp [ns], angular velocity (3,) and specific force (3,) of an Imu."""
    reader = MessageReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string()
    for _ in range(13):
        reader.float64()
    rate = _numbers(reader, 3)
    for _ in range(9):
        reader.float64()
    force = _numbers(reader, 3)
    _require_motion('angular_velocity', rate)
    _require_motion('linear_acceleration', force)
    return stamp_ns, rate, force
