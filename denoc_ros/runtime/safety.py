"""Safety of the torque that leaves, and of late input.

All times are seconds of the robot's clock; stamps are nanoseconds of the
messages' own clock and only ever compared with each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.torque_limits import limit_torque
from denoc_ros.runtime.conversions import LARGEST_EFFORT, is_torque
from denoc_ros.runtime.parameters import Settings
from denoc_ros.types import Array

STALE_ACTIONS = ('hold', 'ramp_to_gravity', 'zero', 'stop_publishing')


class TorqueLimiter:
    """Lets torque leave only finite, within the limits and the change per tick.

    Whatever comes in, what left last is finite and no more than 1e9 N m or N: beyond that, and
    where torque is not finite, what left last leaves again.

    Parameters
    ----------
    limits : (n,) array
        Largest magnitude [N m or N], infinite where there is none.
    max_delta : float
        Largest change per tick [N m or N], infinite for none.

    Attributes
    ----------
    limits : (n,) array
        As given.
    last : (n,) array
        What left last.
    clamped : (n,) array of int
        Ticks in which each joint was clamped.
    non_finite : int
        Ticks in which torque was not finite and what left last left again.

    Raises
    ------
    ValueError
        A limit is negative or NaN, or the change per tick not positive.
    """

    def __init__(self, limits: Array, max_delta: float) -> None:
        n = len(limits)
        if not max_delta > 0.0:
            raise ValueError(f'max_delta must be > 0 N m or N, got {max_delta}')
        self.max_delta = max_delta
        self.last: Array = np.zeros(n)
        self.clamped = np.zeros(n, dtype=np.int64)
        self.non_finite = 0
        ready(limit_torque)
        self.take_limits(limits)

    def take_limits(self, limits: Array) -> None:
        """Take other limits (n,): torque beyond them goes there by `max_delta` per tick."""
        new: Array = np.array(limits, dtype=np.float64)
        if not (new >= 0.0).all():
            raise ValueError(f'effort limits must be >= 0 N m or N, got {new.tolist()}')
        self.limits = new

    def apply(self, torque: Array) -> Array:
        """Limit a torque (n,); the same array is returned each time."""
        last, clamped = self.last, self.clamped
        if not limit_torque(torque, self.limits, self.max_delta, LARGEST_EFFORT, last, clamped):
            self.non_finite += 1
        return last

    def reset(self, torque: Array | float = 0.0) -> None:
        """Start again from `torque`, as if it had left last (within the limits).

        One that is not finite is not taken: what left last stays.
        """
        values = np.broadcast_to(np.asarray(torque, dtype=np.float64), self.last.shape)
        if not is_torque(values):
            self.non_finite += 1
            return
        np.minimum(values, self.limits, out=self.last)
        np.maximum(self.last, -self.limits, out=self.last)


class SafeCommand:
    """The torque while joint states or reference are stale, according to `stale_action`.

    Parameters
    ----------
    action : {'hold', 'ramp_to_gravity', 'zero', 'stop_publishing'}
        Hold the last torque; go linearly to the torque that carries the robot's weight; zero;
        say nothing any more.
    ramp_time : float
        s, of the ramp.
    joints : int
        Number of joints.
    """

    def __init__(self, action: str, ramp_time: float, joints: int) -> None:
        if action not in STALE_ACTIONS:
            raise ValueError(f'stale_action must be one of {STALE_ACTIONS}, got {action!r}')
        self.action = action
        self._ramp_time = ramp_time
        self._since = math.nan
        self._from: Array = np.zeros(joints)
        self._torque: Array = np.zeros(joints)

    @property
    def active(self) -> bool:
        """Whether the safe command has taken over."""
        return self._since == self._since

    def begin(self, now: float, last: Array) -> None:
        """Take over from the torque that left last; no effect while active."""
        if not self.active:
            self._since = now
            self._from[:] = last

    def end(self) -> None:
        """Resume normal commands."""
        self._since = math.nan

    def settled(self, now: float) -> bool:
        """Say whether the command no longer changes by itself."""
        return self.action != 'ramp_to_gravity' or now - self._since >= self._ramp_time

    def torque(self, now: float, gravity: Array) -> Array | None:
        """Return the torque (n,) to send, None for silence.

        Parameters
        ----------
        now : float
            s.
        gravity : (n,) array
            Torque that carries the weight where the robot stands.
        """
        if self.action == 'stop_publishing':
            return None
        if self.action == 'hold':
            return self._from
        if self.action == 'zero':
            self._torque[:] = 0.0
            return self._torque
        elapsed = now - self._since
        share = 1.0 if elapsed >= self._ramp_time else elapsed / self._ramp_time
        np.subtract(gravity, self._from, out=self._torque)
        self._torque *= share
        self._torque += self._from
        return self._torque


def torque_limits(robot: Robot, joints: Sequence[str], settings: Settings) -> Array:
    """Return the effort limits (n,) that a node's parameters ask for.

    Raises
    ------
    ValueError
        `effort_limits` has a wrong length.
    """
    return effort_limits(
        settings.numbers('effort_limits'),
        [robot.tree.joints[joint].limits.effort for joint in joints],
        joints,
        settings.flag('enforce_command_limits'),
    )


def effort_limits(
    given: Sequence[float], of_model: Sequence[float], joints: Sequence[str], enforce: bool
) -> Array:
    """Return the limits (n,) to hold: those `given`, else the model's, infinite if not enforced.

    Raises
    ------
    ValueError
        `given` has a wrong length.
    """
    if given and len(given) != len(joints):
        raise ValueError(
            f"parameter 'effort_limits' must have {len(joints)} elements "
            f'({", ".join(joints)}), got {len(given)}'
        )
    if not enforce:
        return np.full(len(joints), np.inf)
    return np.array(given or of_model, dtype=np.float64)
