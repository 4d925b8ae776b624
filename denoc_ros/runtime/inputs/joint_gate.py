"""Gate of joint motions: turns of continuous joints, and samples that contradict the motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.turns import TURN, nearest_turns
from denoc_ros.model.tree import Joint
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.types import Array

# A deviation of this many times the largest recent one is no part of the motion.
DEVIATION_FACTOR = 5.0
DEVIATION_MEMORY_S = 2.0  # A deviation counts as recent for about this time.
# Deviations below this share of the velocity limit change no estimate that matters.
NEGLIGIBLE_SHARE = 0.01
# The bound grows by this factor with each refusal, so that the gate adapts to a noisier sensor.
REFUSAL_GROWTH = 1.2
LEARNING_SAMPLES = 10  # The first samples show how much the motion deviates from itself.
CONFIRMATION_S = 0.1  # A jump that lasts so long is where the joints are.
CONFIRMATION_SAMPLES = 3
# Of a joint without a limit, to tell a fast motion from a jump [rad/s or m/s].
ASSUMED_VELOCITY = 10.0
VELOCITY_FACTOR = 2.0  # Joints exceed their velocity limit at most by this factor.
LONGEST_GAP_S = 0.25  # After a longer pause the motion before says nothing about a sample.


@dataclass(frozen=True)
class JointSample:
    """Joints at one time.

    Attributes
    ----------
    time : float
        s.
    position, velocity, acceleration, effort : (n,) arrays
        All but the position may be None.
    stamp_ns, arrival : int, float
        Stamp of the message [ns], and when it arrived [s].
    restarts : bool
        Whether the sample does not continue the motion of the samples before.
    """

    time: float
    position: Array
    velocity: Array | None = None
    acceleration: Array | None = None
    effort: Array | None = None
    stamp_ns: int = 0
    arrival: float = 0.0
    restarts: bool = False


class _Track:
    """A motion sample by sample, its values (k,) with the largest recent deviations (k,)."""

    def __init__(self, time: float, values: Array, negligible: Array, positions: int) -> None:
        self.time, self.values = time, values
        self.rate, self.deviation = np.zeros((2, len(values)))
        self.count = 1
        self.interval = math.inf
        self._negligible, self._positions = negligible, positions

    def deviations(self, time: float, values: Array) -> tuple[Array, Array]:
        """Return how far values (k,) are from the motion that goes on, and bounds of that."""
        elapsed = time - self.time
        expected = elapsed * self.rate
        expected += self.values
        bound = DEVIATION_FACTOR * self._spread(elapsed) * self.deviation
        # A velocity is negligible at any time, a position by the time it takes to get there.
        bound[: self._positions] += elapsed * self._negligible[: self._positions]
        bound[self._positions :] += self._negligible[self._positions :]
        return values - expected, bound

    def _spread(self, elapsed: float) -> float:
        """Return how many times larger deviations are after a time [s] than after a period."""
        return max(1.0, elapsed / self.interval) ** 2

    def advance(self, time: float, values: Array) -> None:
        """Take the next sample of the motion."""
        elapsed = time - self.time
        change = (values - self.values) / elapsed
        if self.count > 1:
            change -= self.rate
            deviation = np.abs(change)
            deviation *= elapsed / self._spread(elapsed)
            self.deviation *= math.exp(-elapsed / DEVIATION_MEMORY_S)
            np.maximum(self.deviation, deviation, out=self.deviation)
            self.interval += 0.1 * (elapsed - self.interval)
            # The slope over a short interval is mostly the noise of stamps.
            change *= min(1.0, elapsed / self.interval)
            self.rate += change
        else:
            self.rate, self.interval = change, elapsed
        self.time, self.values = time, values
        self.count += 1


class JointGate:
    """Lets through what continues the motion of joints, positions without jumps by a turn.

    A sample that deviates from the motion much more than any recent one waits for the next
    sample. If the next sample takes the deviation back, the waiting one is refused: it leaves no
    trace. If the next sample confirms it, and the joints can move so fast, both pass. Otherwise
    samples are refused until they have been consistent among each other for `CONFIRMATION_S`: then
    the motion starts again from there.

    Parameters
    ----------
    joints : sequence of str
        n joints.
    continuous : (n,) array of bool
        Whether a turn more or less is the same position.
    velocity : (n,) array
        Velocity limits [rad/s or m/s], infinite where there is none.
    effort : (n,) array, optional
        Effort limits [N m or N]; None: efforts are not judged.

    Attributes
    ----------
    velocity : (n,) array
        Velocity limits, given or assumed [rad/s or m/s].
    position : (n,) array
        Of the last sample that passed; zeros before the first one.
    ignores_velocity : bool
        Whether velocities do not matter to the gate.
    restarts : int
        How often the motion has started again after a jump.
    """

    def __init__(
        self,
        joints: Sequence[str],
        continuous: Sequence[bool],
        velocity: Array,
        effort: Array | None = None,
    ) -> None:
        self._joints = tuple(joints)
        self.continuous = np.asarray(continuous, dtype=bool)
        self._turns = bool(self.continuous.any())
        # As the bounds of motions do, a velocity limit of 0 counts as none.
        known = np.isfinite(velocity) & (velocity > 0.0)
        self.velocity: Array = np.where(known, velocity, ASSUMED_VELOCITY)
        self._effort: Array | None = None
        if effort is not None:
            self._effort = np.where(np.isfinite(effort), effort, 0.0)
        self.position: Array = np.zeros(len(self._joints))
        self.restarts = 0
        self.ignores_velocity = False
        self.reset()

    def begin_path(self, first: float, position: Array, near: Array) -> Array:
        """Return how far to move a path (n,) so that it begins in the turn of the joints.

        A first point that can be reached in its time stays: more than a turn may be wanted.

        Parameters
        ----------
        first : float
            Time of the first point [s]; 0: there the joints are.
        position : (n,) array
            Of the first point.
        near : (n,) array
            Where the joints are at time 0.
        """
        far = np.abs(position - near) > VELOCITY_FACTOR * self.velocity * first
        return nearest_turns(position, near, self.continuous & far) - position

    def reset(self) -> None:
        """Forget the motion: the next sample passes."""
        self._track: _Track | None = None
        self._judges_velocity = False
        self._waiting: JointSample | None = None
        self._run: list[tuple[float, Array]] = []  # consistent refused samples: first and last
        self._run_samples = 0
        self._offered = -math.inf
        self._passed = False

    @property
    def deviation(self) -> Array:
        """Largest recent deviations (2 n,) from steady motion: of positions, of velocities."""
        n = len(self._joints)
        found = np.zeros(2 * n)
        if self._track is not None:
            judged = n * (1 + self._judges_velocity)
            found[:judged] = self._track.deviation[:judged]
        return found

    def offer(
        self,
        sample: JointSample,
        refuse: Callable[[InputError], None],
        near: Array | None = None,
    ) -> list[JointSample]:
        """Take a sample; return those that pass, the oldest first: none, one or two.

        Parameters
        ----------
        refuse : callable
            Takes the refusal of a sample, with the cause `implausible`.
        near : (n,) array, optional
            Positions near which a first sample is taken to be.
        """
        pause, self._offered = sample.time - self._offered, sample.time
        track = self._track
        values = self._values(sample)
        if track is None or not 0.0 < pause <= LONGEST_GAP_S or len(values) != len(track.values):
            if track is not None or self._passed:
                near = self.position
            return [self._start(sample, near, restarts=False)]
        sample = self._unwrapped(sample, track)
        values = self._values(sample)
        deviation, bound = track.deviations(sample.time, values)
        fits = bool((np.abs(deviation) <= bound).all())
        before = self._waiting
        if fits and before is None:
            self._run.clear()
            return [self._advance(sample, values)]
        if before is not None:
            self._waiting = None
            first = self._values(before)
            verdict = self._judge(before, first, sample, values, deviation)
            if verdict:
                return [self._advance(before, first), self._advance(sample, values)]
            refuse(self._refusal(track, before))
            if verdict is None:
                self._run, self._run_samples = [(before.time, first)] * 2, 1
            else:
                self._tolerate(track, before, first)
                if fits:
                    return [self._advance(sample, values)]
        if self._run:
            return self._persist(sample, values, bound, refuse)
        if track.count < LEARNING_SAMPLES and self._feasible(
            track.values, values, sample.time - track.time, 0.0
        ):
            return [self._advance(sample, values)]
        self._waiting = sample
        return []

    def _judge(
        self, before: JointSample, first: Array, sample: JointSample, values: Array, later: Array
    ) -> bool | None:
        """Say whether the waiting sample is part of the motion; None: undecided.

        Parameters
        ----------
        first, values : arrays
            Values of the waiting and the next sample.
        later : array
            Deviation of the next sample.
        """
        assert self._track is not None
        deviation, bound = self._track.deviations(before.time, first)
        size = np.abs(deviation)
        if ((size > bound) & (np.abs(later) < 0.5 * size)).any():
            return False
        since = before.time - self._track.time
        if self._feasible(self._track.values, first, since, bound) and self._feasible(
            first, values, sample.time - before.time, bound
        ):
            return True
        return None

    def _tolerate(self, track: _Track, refused: JointSample, values: Array) -> None:
        """Widen the bounds that a refused sample exceeded."""
        deviation, bound = track.deviations(refused.time, values)
        wider = REFUSAL_GROWTH / DEVIATION_FACTOR * bound
        np.copyto(track.deviation, wider, where=np.abs(deviation) > bound)

    def _feasible(self, before: Array, after: Array, elapsed: float, bound: Array | float) -> bool:
        """Say whether the joints can go from one state to another in a time [s]."""
        n = len(self._joints)
        most = VELOCITY_FACTOR * self.velocity
        if self._track is not None and math.isfinite(self._track.interval):
            # Late messages may come at once, and have the time of their arrival.
            elapsed = max(elapsed, self._track.interval)
        margin = np.broadcast_to(bound, after.shape)
        if not (np.abs(after[:n] - before[:n]) <= most * elapsed + margin[:n]).all():
            return False
        if not self._judges_velocity:
            return True
        return bool((np.abs(after[n : 2 * n]) <= most).all())

    def _persist(
        self,
        sample: JointSample,
        values: Array,
        bound: Array,
        refuse: Callable[[InputError], None],
    ) -> list[JointSample]:
        """Refuse a sample, unless the refused ones have been consistent for long enough."""
        (begin, _), (last, latest) = self._run[0], self._run[-1]
        if self._feasible(latest, values, sample.time - last, bound):
            self._run[-1] = sample.time, values
            self._run_samples += 1
        else:
            self._run, self._run_samples = [(sample.time, values)] * 2, 1
            begin = sample.time
        lasted = sample.time - begin >= CONFIRMATION_S
        if lasted and self._run_samples >= CONFIRMATION_SAMPLES:
            self.restarts += 1
            return [self._start(sample, None, restarts=True)]
        assert self._track is not None
        refuse(self._refusal(self._track, sample))
        return []

    def _values(self, sample: JointSample) -> Array:
        """Return what is judged of a sample (k n,): positions, velocities and efforts if given."""
        with_velocity = sample.velocity is not None and not self.ignores_velocity
        with_effort = self._effort is not None and sample.effort is not None
        if not (with_velocity or with_effort):
            return sample.position
        parts = sample.position, sample.velocity, sample.effort
        chosen = True, with_velocity, with_effort
        return np.concatenate(
            [part for part, each in zip(parts, chosen, strict=True) if each and part is not None]
        )

    def _unwrapped(self, sample: JointSample, track: _Track) -> JointSample:
        """Return the sample with continuous joints in the turn that continues the motion."""
        if not self._turns:
            return sample
        n = len(self._joints)
        near = track.values[:n] + (sample.time - track.time) * track.rate[:n]
        if (np.abs(near - sample.position) < 0.5 * TURN).all():
            return sample
        return replace(sample, position=nearest_turns(sample.position, near, self.continuous))

    def _start(self, sample: JointSample, near: Array | None, restarts: bool) -> JointSample:
        """Let the motion start at a sample."""
        if near is not None:
            sample = replace(
                sample, position=nearest_turns(sample.position, near, self.continuous)
            )
        values = self._values(sample)
        self._judges_velocity = sample.velocity is not None and not self.ignores_velocity
        limits = [self.velocity] * (1 + self._judges_velocity)
        if self._effort is not None and sample.effort is not None:
            limits.append(self._effort)
        negligible = NEGLIGIBLE_SHARE * np.concatenate(limits)
        self._track = _Track(sample.time, values, negligible, len(self._joints))
        self._waiting = None
        self._run.clear()
        self._passed = True
        self.position = sample.position
        return replace(sample, restarts=True) if restarts else sample

    def _advance(self, sample: JointSample, values: Array) -> JointSample:
        """Let a sample pass."""
        assert self._track is not None
        self._track.advance(sample.time, values)
        self.position = sample.position
        return sample

    def _refusal(self, track: _Track, sample: JointSample) -> InputError:
        """Return why a sample is refused: its value that deviates most."""
        values = self._values(sample)
        deviation, bound = track.deviations(sample.time, values)
        bound = np.maximum(bound, np.finfo(np.float64).tiny)
        worst = int(np.argmax(np.abs(deviation) / bound))
        n = len(self._joints)
        judged = ['position', *(['velocity'] if self._judges_velocity else []), 'effort']
        what = judged[worst // n]
        return InputError(
            'implausible',
            f'{self._joints[worst % n]}: {what} must continue the motion, within '
            f'{bound[worst]:.3g} of {values[worst] - deviation[worst]:.6g}, '
            f'got {values[worst]:.6g}',
        )


def joint_gate(robot: Robot, joints: Sequence[str], judges_effort: bool = False) -> JointGate:
    """Return the gate of some of a robot's joints."""
    found: list[Joint] = [robot.tree.joints[joint] for joint in joints]
    return JointGate(
        joints,
        [joint.continuous for joint in found],
        np.array([joint.limits.velocity for joint in found]),
        np.array([joint.limits.effort for joint in found]) if judges_effort else None,
    )
