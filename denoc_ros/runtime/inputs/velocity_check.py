"""Check of measured joint velocities: is their integral the change of the positions?"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from denoc_ros.runtime.inputs.joint_gate import NEGLIGIBLE_SHARE, JointSample
from denoc_ros.types import Array

BLOCK_S = 0.05  # Time over which velocities are integrated.
BLOCK_SAMPLES = 4  # A block has at least so many intervals.
BLOCK_ERROR = 0.25  # Share of the change of position by which the integral may be off.
VELOCITY_LAG_S = 0.02  # Filters of drives delay velocities by this at most.
POSITION_DEVIATIONS = 4.0  # The two ends of a block are off by so many deviations at most.
BLOCKS_TO_DOUBT = 2  # A change of direction within one block may look like a contradiction.
BLOCKS_TO_TRUST = 20
HISTORY_STEP_S = 0.01
HISTORY_SAMPLES = 50  # These reach back to a time before the first contradictory block.
DEGREES = math.degrees(1.0)
RATIO_TOLERANCE = 0.2


class VelocityCheck:
    """Replaces velocities that contradict the positions, until they agree for a while.

    Parameters
    ----------
    joints : sequence of str
        n joints.
    velocity : (n,) array
        Velocity limits [rad/s or m/s].
    rewinds : bool
        Whether samples since before a contradiction are given once more.

    Attributes
    ----------
    reason : str
        Which joint's velocities are not used and why; empty while all are used.
    """

    def __init__(self, joints: Sequence[str], velocity: Array, rewinds: bool) -> None:
        self._joints, self._negligible = tuple(joints), NEGLIGIBLE_SHARE * velocity
        self._history: deque[JointSample] = deque(maxlen=HISTORY_SAMPLES if rewinds else 0)
        self.reset()

    def reset(self) -> None:
        """Forget all samples: measured velocities are used."""
        n = len(self._joints)
        self._last: JointSample | None = None
        self._history.clear()
        self._bad, self._good = np.zeros((2, n), dtype=np.int64)
        self._doubted = np.zeros(n, dtype=bool)
        self._rate = np.zeros(n)
        self.reason = ''

    def take(self, sample: JointSample, deviation: Array) -> list[JointSample]:
        """Take a sample; return it, without velocities if these contradict the positions.

        When a contradiction is found, the first sample returned restarts the motion: this one or,
        with `rewinds`, one from before the contradiction, and all since then without velocities.

        Parameters
        ----------
        deviation : (2 n,) array
            Largest recent deviations of positions and velocities from a steady motion.
        """
        if sample.velocity is None:
            self._last = None
            return [sample]
        last, self._last = self._last, sample
        if last is None or sample.restarts:
            self._history.clear()
            self._begin_block(sample)
        elif self._add(last, sample) and self._judge_block(sample, deviation):
            past = [replace(each, velocity=None) for each in (*self._history, sample)]
            past[0] = replace(past[0], restarts=True)
            return past
        if not self._history or sample.time - self._history[-1].time >= HISTORY_STEP_S:
            self._history.append(sample)
        return [replace(sample, velocity=None)] if self.reason else [sample]

    def _begin_block(self, sample: JointSample) -> None:
        self._begin, self._intervals = sample, 0
        self._integral = np.zeros(len(self._joints))
        assert sample.velocity is not None
        self._lowest = self._highest = sample.velocity

    def _add(self, last: JointSample, sample: JointSample) -> bool:
        """Integrate up to a sample; say whether the block is complete."""
        assert last.velocity is not None
        assert sample.velocity is not None
        self._integral += (0.5 * (sample.time - last.time)) * (last.velocity + sample.velocity)
        self._intervals += 1
        self._lowest = np.minimum(self._lowest, sample.velocity)
        self._highest = np.maximum(self._highest, sample.velocity)
        return (
            self._intervals >= BLOCK_SAMPLES and sample.time - self._begin.time >= BLOCK_S - 1e-9
        )

    def _judge_block(self, sample: JointSample, deviation: Array) -> bool:
        """Judge a complete block; say whether it is the one that shows a contradiction."""
        n = len(self._joints)
        duration = sample.time - self._begin.time
        change, integral = sample.position - self._begin.position, self._integral
        rate = change / duration
        size = np.maximum(np.abs(change), np.abs(integral))
        noise = POSITION_DEVIATIONS * deviation[:n]
        noise = noise + duration * (deviation[n:] + self._negligible)
        lag = VELOCITY_LAG_S * np.abs(rate - self._rate)
        significant = size > 2.0 * noise
        wrong = significant & (np.abs(change - integral) > BLOCK_ERROR * size + noise + lag)
        agrees = significant & ~wrong
        self._bad[wrong] += 1
        self._good[agrees] += 1
        self._bad[agrees] = 0
        self._good[wrong] = 0
        doubted = self._doubted & (self._good < BLOCKS_TO_TRUST)
        doubted |= self._bad >= BLOCKS_TO_DOUBT
        new = doubted & ~self._doubted
        first = bool(new.any()) and not self._doubted.any()
        self._doubted = doubted
        if new.any():
            joint = int(np.argmax(new))
            self.reason = f'{self._joints[joint]}: velocity {self._describe(joint, change)}'
        elif not doubted.any():
            self.reason = ''
        self._rate = rate
        self._begin_block(sample)
        return first

    def _describe(self, joint: int, change: Array) -> str:
        """Say how a joint's velocities of a block contradict the change of position (n,)."""
        measured, moved = float(self._integral[joint]), float(change[joint])
        if self._lowest[joint] == self._highest[joint]:
            return f'is frozen at {self._lowest[joint]:.4g}'
        if moved == 0.0:
            return 'is not zero while the position stays'
        ratio = measured / moved
        text = f'is {ratio:.3g} times the change of position'
        if abs(ratio / DEGREES - 1.0) < RATIO_TOLERANCE:
            return f'{text}: degrees instead of radians'
        if abs(ratio + 1.0) < RATIO_TOLERANCE:
            return f'{text}: the sign is wrong'
        return text
