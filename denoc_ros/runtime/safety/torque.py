"""The torque that leaves: of a live model along a reference, or safe; limited, and reported."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence

import numpy as np

from denoc_ros.dynamics.driven.torque_feedforward import Terms, TorqueFeedforward
from denoc_ros.dynamics.equilibrium import UnsettledError
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.kernels.runtime.torque_limits import limit_torque
from denoc_ros.runtime.inputs.message_readers import LARGEST_EFFORT, is_torque
from denoc_ros.runtime.loop.rate_limiter import Backoff
from denoc_ros.runtime.loop.status import ERROR, WARN, Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.safety.restarts import Restarts
from denoc_ros.types import Array

STALE_ACTIONS = ('hold', 'ramp_to_gravity', 'zero', 'stop_publishing')
POSTURE_SHARE = 0.1  # of a processor that postures without a torque may cost
LONGEST_WAIT = 0.25  # s until such a posture, or a model that fails, is tried again
SUBSTEPS = 20  # of the model in one tick after a pause
SEARCH_SHARE = 0.5  # of a period that a tick may search for an equilibrium
FAILING_SHARE = 0.1  # of a processor for a model that fails


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


class CarryingTorque:
    """Gravity torque of the last posture that has one.

    A measured posture may have none: one in which the loops of a mechanism do not close, or whose
    numbers overflow.

    Attributes
    ----------
    posture, torque : (n,) array
        The last posture with a torque [rad or m], and that torque [N m or N].
    found : bool
        Whether there is any.
    failure : str
        Why the newest posture has none, '' if it has.
    """

    def __init__(self, joints: int) -> None:
        self.posture, self.torque = np.zeros((2, joints))
        self._wrong = np.full(joints, np.nan)
        self._source: TorqueFeedforward | None = None
        self._backoff = Backoff(POSTURE_SHARE, LONGEST_WAIT)
        self.forget()

    def forget(self) -> None:
        """Discard the result."""
        self.found = False
        self.failure = ''

    def hurry(self) -> None:
        """Look at the next posture at once: time has begun anew."""
        self._backoff.reset()

    def update(self, source: TorqueFeedforward, posture: Array, now: float) -> str:
        """Find the torque of a posture (n,) at steady `now` [s].

        Returns
        -------
        str
            Why there is none, '' if there is, if it was too soon to look again, or for the same
            posture and model as before.
        """
        changed, self._source = source is not self._source, source
        again = bool(self.failure) and not changed and bool((posture == self._wrong).all())
        if self.failure and not changed and not self._backoff.due(now):
            return ''
        begin = time.thread_time()
        try:
            torque = source.gravity(posture)
            self.failure = '' if is_torque(torque) else f'{posture} must have a finite weight'
        except (StateError, SolverError) as error:
            self.failure = str(error)
        if self.failure:
            self._wrong[:] = posture
            self._backoff.failed(now, time.thread_time() - begin)
            return '' if again else self.failure
        self.posture[:], self.torque[:] = posture, torque
        self.found = True
        return ''


def torque_feedforward(
    robot: Robot, joints: Sequence[str], settings: Settings, posture: Array, in_loop: bool
) -> TorqueFeedforward:
    """Return the torque that a node's parameters ask for, each of its verbs called once.

    Parameters
    ----------
    posture : (n,) array
        Near which loops are closed.
    in_loop : bool
        Whether a loop waits for it, which has no time for more than a little work per tick.
    """
    terms = Terms(**{name: settings.flag(f'terms.{name}') for name in Terms.names()})
    period = 1.0 / settings.number('update_rate')
    source = TorqueFeedforward(
        robot, joints, settings.text('model'), terms, period, posture=posture
    )
    zero, there = np.zeros(len(joints)), source.q[source.motion.index]
    source.update(there, zero, zero, 0.0)
    source.update(there, zero, zero, period)
    source.gravity(there)
    source.reset()
    if in_loop:
        source.substeps, source.patience = SUBSTEPS, SEARCH_SHARE * period
    return source


class LiveTorque:
    """Torque along a motion by a model that may be replaced between two ticks.

    Parameters
    ----------
    in_loop : bool
        Whether a model that fails is left alone for a while, so that the loop keeps its period.

    Attributes
    ----------
    restarts : Restarts
        How often it gave no torque, and what its amplitudes miss since then.
    """

    def __init__(self, source: TorqueFeedforward, in_loop: bool) -> None:
        self.source = source
        self.restarts = Restarts(source.bounds)
        self._backoff = Backoff(FAILING_SHARE, LONGEST_WAIT) if in_loop else None

    def replace(self, source: TorqueFeedforward) -> None:
        """Go on with another model where the one before is."""
        source.adopt(self.source)
        self.source = source
        self.restarts.bounds = source.bounds

    def reset(self) -> None:
        """Forget the amplitudes."""
        self.source.reset()
        self.restarts.clear()

    def update(
        self, q: Array, qd: Array, qdd: Array, elapsed: float, moment: float
    ) -> Array | None:
        """Return the torque (n,) of a motion, None while the model fails.

        `moment` is the time of the clock [s]; the other arguments are the source's.
        """
        backoff, now = self._backoff, time.perf_counter()
        if backoff is not None and not backoff.due(now):
            return None
        begin = time.thread_time()
        try:
            return self.source.update(q, qd, qdd, elapsed)
        except UnsettledError:  # the next update goes on with it
            return None
        except (StateError, SolverError) as error:
            self.restarts.note_failure(str(error))
            self.restarts.note_restart(str(error), moment)
            self.source.reset()
            if backoff is not None:
                backoff.failed(now, time.thread_time() - begin)
            return None


class TorqueStatus:
    """State of the torque, with warnings for events since the last report."""

    def __init__(self) -> None:
        self._clamped = self._non_finite = 0

    def status(
        self,
        cause: str,
        limiter: TorqueLimiter,
        restarts: Restarts,
        now: float,
        more: Mapping[str, object],
    ) -> Status:
        """Return the status.

        Parameters
        ----------
        cause : str
            What the torque follows, or why it does not.
        restarts : Restarts
            Of the model's amplitudes.
        now : float
            s.
        """
        status = Status('torque', message=cause)
        status.values = {
            'cause': cause,
            **more,
            'clamped': ' '.join(map(str, limiter.clamped.tolist())),
            'non_finite': limiter.non_finite,
            'model_failures': restarts.failures,
        }
        clamped = int(limiter.clamped.sum())
        if clamped > self._clamped:
            status.worsen(WARN, 'torque clamped')
        if cause.startswith('stale'):
            status.worsen(WARN, cause)
        if limiter.non_finite > self._non_finite:
            status.worsen(ERROR, 'torque of the model not finite')
        restarts.worsen(status, now)
        self._clamped, self._non_finite = clamped, limiter.non_finite
        return status
