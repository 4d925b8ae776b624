"""Joint states that come in parts, as those of an arm and of its gripper: joined by joint."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_readers import JointStateReader, joint_names
from denoc_ros.types import Array

MOST_PARTS = 8  # Sets of joints that messages name whose last messages are kept.


class _Part:
    """Messages that name the same joints: the last one."""

    def __init__(self, reader: JointStateReader, places: NDArray[np.intp]) -> None:
        self.reader, self.places = reader, places
        self.time, self.stamp_ns = -math.inf, 0
        self.position: Array = np.zeros(len(places))
        self.velocity: Array = np.zeros(len(places))
        self.effort: Array | None = None

    def read(self, raw: bytes, now: float) -> None:
        """Take a message that arrived at a time [s]; a rate that it lacks is the difference."""
        reader = self.reader
        reader.read(raw)
        stamp_ns = reader.stamp_ns
        if 0 < stamp_ns <= self.stamp_ns:
            words = ('duplicate', 'be new') if stamp_ns == self.stamp_ns else (
                'backwards_stamp', 'not go back'
            )  # fmt: skip
            raise InputError(
                words[0],
                f'stamp of {list(reader.joints)} must {words[1]}, got {stamp_ns} ns after '
                f'{self.stamp_ns} ns',
            )
        time = 1e-9 * stamp_ns if stamp_ns else now
        before = 1e-9 * self.stamp_ns if stamp_ns else self.time
        if reader.has_velocity:
            self.velocity = reader.velocity
        elif self.time > -math.inf and time > before:
            self.velocity = (reader.position - self.position) / (time - before)
        self.position = reader.position
        self.effort = reader.effort if reader.has_effort else None
        self.time, self.stamp_ns = now, stamp_ns


class PartialJoints:
    """Joint states of messages of which none names all joints.

    The messages that name most joints set the pace: each of them makes a state, with the other
    joints where their last messages and rates lead them.

    Parameters
    ----------
    joints : sequence of str
        n joints.
    allow_extra : bool
        Whether messages may also name joints that are not known.
    known : sequence of str
        The joints of the robot.

    Attributes
    ----------
    stamp_ns : int
        Of the last state [ns].
    position, velocity, effort : (n,) array
        The last state; None for an effort that one of the joints lacks.
    """

    def __init__(self, joints: Sequence[str], allow_extra: bool, known: Sequence[str]) -> None:
        self._joints, self._allow_extra, self._known = tuple(joints), allow_extra, tuple(known)
        self.reset()

    def reset(self) -> None:
        """Forget all messages."""
        self._parts: dict[tuple[str, ...], _Part | None] = {}
        self.stamp_ns = 0
        self.position, self.velocity = np.zeros((2, len(self._joints)))
        self.effort: Array | None = None

    def read(self, raw: bytes, now: float, timeout: float) -> bool:
        """Read a message that arrived at a time [s]; say whether there is a new state.

        Raises
        ------
        InputError
            As of :meth:`JointStateReader.read`; `missing_joint` while another joint's last message
            is older than `timeout` [s].
        """
        names = joint_names(raw)
        if names not in self._parts:
            part = self._part(names)
            if len(self._parts) >= MOST_PARTS:
                self._drop_oldest()
            self._parts[names] = part
        part = self._parts[names]
        if part is None:  # of other joints of the robot
            return False
        part.read(raw, now)
        if part is not self._leader(now, timeout):
            return False
        self._join(part, now, timeout)
        return True

    def _drop_oldest(self) -> None:
        """Forget the part whose last message is the oldest one."""
        times = {
            names: -math.inf if part is None else part.time for names, part in self._parts.items()
        }
        del self._parts[min(times, key=lambda names: times[names])]

    def _part(self, names: tuple[str, ...]) -> _Part | None:
        """Return the part that names some joints; None for joints that do not count."""
        own = [joint for joint in self._joints if joint in names]
        reader = JointStateReader(own, self._allow_extra, self._known)
        places = np.array([self._joints.index(joint) for joint in own], dtype=np.intp)
        if own or self._allow_extra or set(names) <= {*self._known}:
            return _Part(reader, places) if own else None
        unknown = sorted(set(names) - {*self._known})
        raise InputError(
            'unknown_joint', f'joint must be one of {list(self._known)}, got {unknown}'
        )

    def _leader(self, now: float, timeout: float) -> _Part:
        """Return the part with most joints among those that are not stale."""
        parts = [part for part in self._parts.values() if part is not None]
        return max(parts, key=lambda part: (now - part.time <= timeout, len(part.places)))

    def _join(self, leader: _Part, now: float, timeout: float) -> None:
        found = np.full((3, len(self._joints)), np.nan)
        for part in self._parts.values():
            if part is None or part is leader or now - part.time > timeout:
                continue
            found[0, part.places] = part.position + (now - part.time) * part.velocity
            found[1, part.places] = part.velocity
            if part.effort is not None:
                found[2, part.places] = part.effort
        found[:2, leader.places] = leader.position, leader.velocity
        if leader.effort is not None:
            found[2, leader.places] = leader.effort
        if missing := [self._joints[k] for k in np.flatnonzero(np.isnan(found[0]))]:
            raise InputError(
                'missing_joint',
                f'messages of joints {missing} must not be older than {timeout:g} s, got none',
            )
        self.stamp_ns = leader.stamp_ns
        self.position, self.velocity = found[:2]
        self.effort = found[2] if np.isfinite(found[2]).all() else None
