"""Check of measured efforts: are they the torques that the measured motion takes?"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.estimation.observer import Observer
from denoc_ros.runtime.adaptation import is_tracking
from denoc_ros.runtime.live_observer import build_observer
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.types import Array

BLOCK_S = 0.1  # Time over which torques are averaged.
BLOCKS = 5  # So many blocks are judged together.
DOUBTFUL_ERROR = 0.8  # Share of the torque by which efforts are off, above which they are wrong.
TRUSTED_ERROR = 0.4
BLOCKS_TO_TRUST = 20
# Smaller shares of the largest torque so far are mostly friction, which models describe badly.
SIGNIFICANT_SHARE = 0.1


class EffortCheck:
    """Finds joints whose efforts are not the torques of the model along the measured motion.

    Attributes
    ----------
    reason : str
        Which joint's efforts are not used and why; empty while all are used.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self._joints = tuple(joints)
        self.reset()

    def reset(self) -> None:
        """Forget all efforts: they are used."""
        n = len(self._joints)
        self._time = self._begin = np.nan
        self._integrals = np.zeros((2, n))
        self._largest = np.zeros(n)
        self._blocks: list[deque[tuple[float, float]]] = [deque(maxlen=BLOCKS) for _ in range(n)]
        self._good = np.zeros(n, dtype=np.int64)
        self._doubted = np.zeros(n, dtype=bool)
        self.reason = ''

    def take(self, time: float, effort: Array, expected: Array) -> None:
        """Take efforts (n,) and the model's torques (n,) at a time [s]."""
        interval = time - self._time
        if not 0.0 < interval <= BLOCK_S:
            self._begin = time
            self._integrals[:] = 0.0
        else:
            self._integrals[0] += interval * effort
            self._integrals[1] += interval * expected
        self._time = time
        duration = time - self._begin
        if duration >= BLOCK_S - 1e-9:
            self._judge(*(self._integrals / duration))
            self._begin = time
            self._integrals[:] = 0.0

    def _judge(self, effort: Array, expected: Array) -> None:
        """Judge the mean values (n,) of a block."""
        size, error = np.abs(expected), np.abs(effort - expected)
        np.maximum(self._largest, size, out=self._largest)
        significant = size > SIGNIFICANT_SHARE * self._largest
        for joint in np.flatnonzero(significant):
            blocks = self._blocks[joint]
            blocks.append((float(error[joint]), float(size[joint])))
            share = sum(each for each, _ in blocks) / sum(each for _, each in blocks)
            self._good[joint] = self._good[joint] + 1 if share < TRUSTED_ERROR else 0
            if len(blocks) == BLOCKS and share > DOUBTFUL_ERROR and not self._doubted[joint]:
                self._doubted[joint] = True
                self.reason = (
                    f'{self._joints[joint]}: effort must be the torque of the motion, about '
                    f'{expected[joint]:.3g}, got {effort[joint]:.3g}'
                )
        self._doubted &= self._good < BLOCKS_TO_TRUST
        if not self._doubted.any():
            self.reason = ''


class EffortGuard:
    """Measures an observer with efforts, or by the joints alone while the efforts are wrong.

    Parameters
    ----------
    by_joints : Observer or None
        Observer of the same robot with the source `joints`; None: efforts are not judged.
    joints : sequence of str
        n joints.
    takes_effort : bool
        Whether the observer takes efforts with the measurements; else in another way.
    """

    def __init__(
        self, by_joints: Observer | None, joints: Sequence[str], takes_effort: bool
    ) -> None:
        self._by_joints, self._takes_effort = by_joints, takes_effort
        self._check = EffortCheck(joints)

    @property
    def reason(self) -> str:
        """Which joint's efforts are not used and why; empty while all are used."""
        return self._check.reason

    def reset(self) -> None:
        """Forget the state and all efforts: they are used."""
        self._check.reset()
        if self._by_joints is not None:
            self._by_joints.reset()

    def follow(self, observer: Observer) -> None:
        """Go on from the state of the observer, which has been changed."""
        if self._by_joints is not None:
            self._by_joints.adopt(observer)

    def measure(
        self, observer: Observer, stamp: float, q: Array, qd: Array | None, effort: Array | None
    ) -> None:
        """Have an observer take a measurement; arguments as of :meth:`Observer.measure`."""
        other, check = self._by_joints, self._check
        taken = effort if self._takes_effort else None
        if other is None:
            observer.measure(stamp, q, qd, taken)
            return
        if other.started and not observer.started:  # Efforts led out of the model's range.
            observer.adopt(other)
        try:
            if other.measure(stamp, q, qd) and effort is not None:
                check.take(stamp, effort, other.joint_torque())
        except (StateError, SolverError):
            other.reset()
            raise
        if check.reason:
            observer.adopt(other)
        else:
            observer.measure(stamp, q, qd, taken)


def effort_guard(
    robot: Robot, settings: Settings, period: float, joints: Sequence[str], posture: Array
) -> EffortGuard:
    """Return the guard of a predictor's efforts; arguments as of :func:`build_observer`.

    Efforts are judged where the model describes them: not behind springs of gears, in loops, on
    bases that float or are in motion, where sensors are fused or the model is adapted.
    """
    by_torque = settings.text('source') == 'torque'
    takes_effort = by_torque and settings.text('effort_source') == 'measured'
    if not by_torque or settings.text('base_motion') != 'off' or is_tracking(settings):
        return EffortGuard(None, joints, takes_effort)
    by_joints = build_observer(
        robot, settings.replace({'source': 'joints'}), period, joints, posture
    )
    if not by_joints.judges_effort:
        return EffortGuard(None, joints, takes_effort)
    still = np.zeros(len(joints))
    by_joints.measure(0.0, by_joints.motion.posture[by_joints.motion.index], still)
    by_joints.joint_torque()  # Nothing compiles in the loop.
    by_joints.reset()
    return EffortGuard(by_joints, joints, takes_effort)
