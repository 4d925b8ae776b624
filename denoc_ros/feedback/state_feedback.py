"""State feedback about a plan, tick by tick."""

from __future__ import annotations

import math

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.feedback.deviation_filter import FILTER_KERNELS, DeviationFilter
from denoc_ros.feedback.feedback_design import PostureGains
from denoc_ros.feedback.gain_schedule import GainSchedule
from denoc_ros.feedback.kernels.feedback_torques import feedback_torques, govern
from denoc_ros.feedback.model_errors import ERROR_KERNELS
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.types import Array

TORQUE_KERNELS = (feedback_torques, govern)
FEEDBACK_KERNELS = (*FILTER_KERNELS, *ERROR_KERNELS, *TORQUE_KERNELS)
RAMP = 0.5  # s in which feedback comes in
FADE = 0.05  # s in which the last torque of a feedback goes that may no longer act
# rad, m that the feedback of all deviations may push the joints from the plan against their own
REACH = 0.03
SLEW = 0.05  # s in which it may change by as much as it may be
AT_LIMIT = 3.0  # s at that limit after which the estimate is in doubt
PARDON = 5.0  # s until it is heard again
ROUNDING = 1e-9  # of the largest torque: a change that no limit made
LONGEST = 0.5  # s without a tick after which the estimate starts anew
# s over which ticks are counted, and of one pause that counts: one alone is no slow loop
COUNTED, COUNTS = 0.05, 0.02
SLOWEST = 2.5  # periods from tick to tick, on average, with which gains are not yet too high
SLOW = 'the loop is too slow for its gains'


class HandOver:
    """Torque that comes and goes without a jump: in by a growing share, out by fading.

    Parameters
    ----------
    count : int
        Joints.

    Attributes
    ----------
    share : float
        Of the torque that is in: 0 while there is none.
    torque : (joints,) array
        As it was returned last [N m, N].

    Notes
    -----
    What fades is the last torque, a signal of the time alone: it closes no loop.
    """

    def __init__(self, count: int) -> None:
        self.share, self.torque = 0.0, np.zeros(count)
        self._kept, self._left = np.zeros(count), 0.0

    def reset(self) -> None:
        """Begin with no torque at all."""
        self.share, self._left = 0.0, 0.0
        self.torque[:] = 0.0

    def take(self, asked: Array | None, elapsed: float) -> Array:
        """Return the torque (joints,) that may act; the same array each time.

        Parameters
        ----------
        asked : (joints,) array or None
            By the feedback [N m, N]; None while it may not act.
        elapsed : float
            Since the last call [s].
        """
        self._left = max(0.0, self._left - elapsed / FADE)
        if asked is None:
            if self.share > 0.0:
                self._kept[:], self._left, self.share = self.torque, 1.0, 0.0
            self.torque[:] = 0.0
        else:
            self.share = min(1.0, self.share + elapsed / RAMP)
            np.multiply(asked, self.share, out=self.torque)
        if self._left:
            self.torque += self._left * self._kept
        return self.torque


class StateFeedback:
    """Torque of the joints' own feedback and, on top, of all deviations y from a plan.

    The joints': -[stiffness, damping] of their measured deviations, while they are measured. On
    top, while the estimate is believed, -K [y; torques on their way; integrals]. Each comes and
    goes without a jump: while the estimate is in doubt, the plan acts with damped joints.

    Each tick: `follow` the plan, take measurements into `filter`, ask for the `torque`, and say
    with `applied` what became of it.

    Parameters
    ----------
    robot : Robot
        The model; worked on as a copy.
    schedule : GainSchedule
    start : float
        When the schedule's time is zero, on the clock of all times here [s].

    Attributes
    ----------
    filter : DeviationFilter
    schedule : GainSchedule
    integrals : (joints,) array
        Of the virtual joint errors [rad s, m s].
    share : float
        Of the feedback of all deviations that is in: 0 while the estimate is not believed.
    joint_share : float
        Of the joints' own feedback that is in: 0 while they are not measured.
    limited : int
        Ticks in which the feedback was at its own limit.
    hold : float
        For how long [s] drives hold a torque of the plan: a period, or less where the plan's
        torque leaves more often than this one.

    Notes
    -----
    What the controller remembers is the torque on its way, as it was clamped, and the integrals,
    which rest while anything is clamped: so nothing winds up. The estimate is driven by the
    clamped torque as well, and by what the plan's torque has become too small or too large by when
    it acts: after the delay, less the lead of the plan, and held for a period.

    Gains of all deviations are too high for a loop whose ticks come several periods apart. While
    it is that slow, the joints' own feedback acts alone, weaker the slower it is, with the torque
    that the errors add.
    """

    def __init__(self, robot: Robot, schedule: GainSchedule, start: float = 0.0) -> None:
        self.schedule, self._start = schedule, start
        self.filter = DeviationFilter(robot, schedule)
        k = len(schedule.joints)
        self._k = k
        past = schedule.gains[0].push.shape[1] - k
        self._way, self.integrals = np.zeros(past), np.zeros(k)
        self._most = schedule.settings.limit * schedule.limits
        self._rounding = ROUNDING * self._most.max()
        self._asked, self._torque, self._left, self._governed_last = np.zeros((4, k))
        self._by_state, self._by_joints = np.zeros((2, k))
        self._changed = np.zeros(k)  # torque that the plan of a robot with the errors adds
        # the joints' own feedback, where there is any, keeps to the plan with the errors
        self._stands_alone = bool(schedule.gains[0].joints.any())
        self._own, self._state = HandOver(k), HandOver(k)
        self._plan: Array | None = None  # torque of the plan at the last tick
        self._followed = 0.0  # the time of that plan [s]
        self._behind = np.zeros(k)  # torque by which it is behind when it acts, and held
        self._deviations, self._unchanged = np.zeros((2, len(schedule.gains[0].push)))
        self._torques, self._govern = map(entry, TORQUE_KERNELS)
        self.limited = 0
        self.hold = schedule.settings.period
        self._last = -np.inf
        self._at = 0
        self._at_limit, self._heard_from, self._governs = 0.0, -np.inf, False
        self._usual = COUNTED / schedule.settings.period  # ticks in that time
        self._ticks, self._pace = self._usual, 1.0

    @property
    def share(self) -> float:
        """How much of the feedback of all deviations is in."""
        return self._state.share

    @property
    def joint_share(self) -> float:
        """How much of the joints' own feedback is in."""
        return self._own.share

    @property
    def cause(self) -> str:
        """Why no torque of the feedback of all deviations is in, '' if it is or soon will be."""
        if self._last < self._heard_from:
            return 'feedback was at its limit for long'
        return self.filter.cause

    @property
    def active(self) -> bool:
        """Whether there is a torque of the feedback of all deviations."""
        return self.share > 0.0

    def reset(self) -> None:
        """Forget deviations, integrals and torques on their way."""
        self.filter.reset()
        self._ticks, self._pace = self._usual, 1.0
        self._way[:] = self.integrals[:] = self._left[:] = 0.0
        self._own.reset()
        self._state.reset()
        self._governed_last[:] = 0.0
        self._last = -np.inf
        self._at_limit, self._heard_from = 0.0, -np.inf

    def adopt(self, other: StateFeedback) -> bool:
        """Go on from another one of the same coordinates; False if it has others."""
        mine, its = self.schedule, other.schedule
        same = (
            np.array_equal(mine.coordinates, its.coordinates)
            and np.array_equal(mine.joints, its.joints)
            and np.array_equal(mine.sensors, its.sensors)
            and self._way.shape == other._way.shape
            and self.filter.is_like(other.filter)
        )
        if same:
            other.filter.take_model(self.filter)
            self.filter, self._way, self.integrals = other.filter, other._way, other.integrals
            self._left, self._own, self._state = other._left, other._own, other._state
            self._last, self.limited = other._last, other.limited
            self._governed_last = other._governed_last
            self._at_limit, self._heard_from = other._at_limit, other._heard_from
            self._ticks, self._pace = other._ticks, other._pace
        return same

    def is_near(self, now: float, position: Array, reach: float) -> bool:
        """Say whether joints (joints,) are within reach [rad, m] of the posture of the gains."""
        before, share = self.schedule.place(now - self._start)
        postures = self.schedule.postures
        there = postures[before]
        if share:
            there = there + share * (postures[before + 1] - there)
        return bool(np.abs(position - there).max() <= reach)

    def rest(self) -> None:
        """Let go until the estimate has been good for a while: the plan's torque does not act."""
        if self._last > -np.inf:
            self.reset()

    def follow(self, time: float, q: Array, qd: Array, qdd: Array | None = None) -> None:
        """Take the plan's coordinates and derivatives (n,) of a time [s], which may be ahead."""
        self.filter.follow(time, q, qd, qdd)
        self._followed = time

    def torque(self, now: float, plan: Array | None = None) -> Array:
        """Return the torque (joints,) to add to the plan's; the same array each time.

        While the estimate is not believed, that of the joints' own feedback, to which it hands
        over within `FADE`.

        Parameters
        ----------
        now : float
            [s].
        plan : (joints,) array, optional
            Torque of the plan, for ticks that come late: drives hold what they were last told.
            It is kept until the next call and must not change before.
        """
        schedule = self.schedule
        self._catch_up(now, plan)
        before, share = schedule.place(now - self._start)
        self._at = before if share < 0.5 else min(before + 1, len(schedule.gains) - 1)
        time = self.filter.time = now - self._start
        self.filter.correct(now, schedule.gains[self._at])
        elapsed = 0.0 if self._last == -np.inf else min(now - self._last, RAMP)
        self._last = now
        if self._is_slow_after(elapsed):
            self.filter.start_anew(now, SLOW)
        after = min(before + 1, len(schedule.gains) - 1)
        self._find_torques(before, after, share, time)
        asked = None
        if now - self.filter.joints_at <= schedule.settings.sensor_timeout:
            asked = self._by_joints
            asked *= self._pace
            if self._stands_alone:
                asked += self._changed
        np.copyto(self._torque, self._own.take(asked, elapsed))
        asked, self._governs = None, False
        if not self.filter.believed or now < self._heard_from:
            self.integrals[:] = 0.0
        else:
            asked = self._by_state
            if not self._stands_alone:
                asked += self._changed
            asked = self._governed(asked, before, now, elapsed)
        if asked is None:
            self._governed_last[:] = 0.0
        self._torque += self._state.take(asked, elapsed)
        np.copyto(self._asked, self._torque)
        np.minimum(self._asked, self._most, out=self._torque)
        np.maximum(self._torque, -self._most, out=self._torque)
        self.limited += bool((self._torque != self._asked).any())
        return self._torque

    def _is_slow_after(self, elapsed: float) -> bool:
        """Say whether ticks have been too far apart of late; then the joints' gains shrink."""
        self._ticks = 1.0 + self._ticks * math.exp(-min(elapsed, COUNTS) / COUNTED)
        slow = self._ticks * SLOWEST < self._usual
        pace = self._pace - elapsed / FADE if slow else self._pace + elapsed / RAMP
        self._pace = min(max(pace, self._ticks / self._usual), 1.0)
        return slow

    def _find_torques(self, before: int, after: int, share: float, time: float) -> None:
        """Find the torques by all deviations, and by those of the joints, between two postures."""
        known, errors, changed = self.filter, self.filter.errors, self._unchanged
        if errors is not None:
            changed, self._changed[:] = errors.state(time), errors.torque(time)
        here, there = self.schedule.gains[before], self.schedule.gains[after]
        self._torques(
            here.gain, there.gain, here.joints, there.joints, share, here.measured, known.state,
            known.joints, changed, self._changed, self._way, self.integrals, self._deviations,
            self._by_state, self._by_joints,
        )  # fmt: skip

    def _governed(self, asked: Array, before: int, now: float, elapsed: float) -> Array | None:
        """Return as much of a torque (joints,) as the joints' own feedback can stand against.

        All of it gets smaller together, so that it is less of the same feedback. None when it has
        been too large for long: then no deviation is that large, but something is wrong.
        """
        gain = self.schedule.gains[before].joints
        share = self._govern(asked, self._governed_last, gain, REACH, elapsed / SLEW)
        if share < 0.0:
            return asked
        self._governs = share < 1.0
        self._at_limit = self._at_limit + elapsed if share < 1.0 else 0.0
        if self._at_limit > AT_LIMIT:
            self._at_limit, self._heard_from = 0.0, now + PARDON
            self.integrals[:] = 0.0
            return None
        self._governed_last[:] = asked
        return asked

    def _catch_up(self, now: float, plan: Array | None) -> None:
        """Bring the estimate over the periods since the last tick that had none."""
        before, self._plan = self._plan, plan
        self._behind[:] = 0.0
        if self._last == -np.inf:
            return
        settings = self.schedule.settings
        if before is not None and plan is not None:
            late = settings.delay + 0.5 * self.hold - (self._followed - now)
            self._behind[:] = late / max(now - self._last, settings.period) * (plan - before)
        missed = round((now - self._last) / settings.period) - 1
        if missed * settings.period > LONGEST:
            self.reset()
        elif missed > 0:
            # the drives held the whole torque meanwhile, and the plan went on
            drift = np.zeros(self._k) if before is None or plan is None else before - plan
            gains, pushed = self.schedule.gains[self._at], np.zeros(len(self._deviations))
            for period in range(1, missed + 1):
                pushed += self._go_on(gains, self._left + period / (missed + 1) * drift)
            self.filter.doubt(pushed, missed * settings.period, now)

    def _go_on(self, gains: PostureGains, change: Array) -> Array:
        """Bring the estimate forward by a period in which a torque was added to the plan's.

        Returns what the torque did to the deviations (2 m,).
        """
        pushes = np.concatenate((self._way, change))
        pushed = self.filter.go_on(gains, pushes)
        self._way[:] = pushes[self._k :]
        return pushed

    def applied(self, change: Array) -> None:
        """Take the torque (joints,) [N m, N] that was added to the plan's after all limits."""
        gains = self.schedule.gains[self._at]
        errors, free = self.filter.errors, self.share == 1.0 and not self._governs
        if errors is not None and errors.show(self.filter.time):
            free = False  # the integrals would count what is being learned a second time
        if free and np.abs(change - self._asked).max() <= self._rounding:
            m = gains.virtual.shape[1]
            step = self.schedule.settings.period
            self.integrals += step * (gains.virtual @ self._deviations[:m])
        self._go_on(gains, change - self._behind)
        self._left[:] = change
