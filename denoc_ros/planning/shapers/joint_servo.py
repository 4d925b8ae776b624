"""The servo of a position-controlled joint, and its inverse: the command for a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from denoc_ros.errors import StateError
from denoc_ros.types import Array

# times (k,), order of the derivative -> (k, joints), held outside of the motion
Motion = Callable[[Array, int], Array]


@dataclass(frozen=True)
class JointServo:
    """How joints follow their commands: a second-order lag after a delay, each.

    Attributes
    ----------
    bandwidth : (joints,) array
        Natural frequency [Hz] of the lag; inf: the joint is where it is told to be, after the
        delay.
    damping : (joints,) array
        Damping ratio.
    delay : (joints,) array
        s.

    Notes
    -----
    q'' / w^2 + 2 zeta q' / w + q = u(t - delay), with w = 2 pi bandwidth.
    """

    bandwidth: Array
    damping: Array
    delay: Array

    @property
    def preaction(self) -> float:
        """How long before a motion its command begins [s]."""
        return float(self.delay.max(initial=0.0))

    @property
    def is_exact(self) -> bool:
        """Whether every joint follows its command exactly and at once."""
        return bool(np.isinf(self.bandwidth).all() and not self.delay.any())

    def command(self, times: ArrayLike, motion: Motion) -> tuple[Array, Array, Array]:
        """Return the commands for a motion of the joints.

        Parameters
        ----------
        times : (k,) array
            s, in the time of the motion; its command begins `preaction` before it.
        motion : callable
            Twice continuously differentiable, four times in pieces.

        Returns
        -------
        u, ud, udd : (k, joints) arrays
        """
        moments = np.asarray(times, dtype=np.float64)
        omega = 2.0 * np.pi * self.bandwidth
        lag, inertia = 2.0 * self.damping / omega, 1.0 / omega**2
        rows = np.zeros((5, len(moments), len(self.delay)))
        for delay in np.unique(self.delay):
            those = self.delay == delay
            for order in range(5):
                rows[order][:, those] = motion(moments + delay, order)[:, those]
        first, second, third = (
            rows[k] + lag * rows[k + 1] + inertia * rows[k + 2] for k in range(3)
        )
        return first, second, third

    def response(self, times: Array, command: Array) -> Array:
        """Return the joint positions (k, joints) under commands (k, joints) in equal steps.

        At rest at the first command before it; commands are linear between their times.
        """
        step = float(times[1] - times[0])
        result = np.zeros_like(command)
        for j in range(command.shape[1]):
            late = np.interp(times - self.delay[j], times, command[:, j])
            if np.isinf(self.bandwidth[j]):
                result[:, j] = late
            else:
                result[:, j] = self._lag(j, step, late)
        return result

    def _lag(self, j: int, step: float, command: Array) -> Array:
        """Return the exact response (k,) of one joint's lag to commands linear between steps."""
        omega = 2.0 * np.pi * self.bandwidth[j]
        # x = (q, q', u, u'): u' is constant within a step
        system = np.zeros((4, 4))
        system[0, 1] = system[2, 3] = 1.0
        system[1, :3] = -(omega**2), -2.0 * self.damping[j] * omega, omega**2
        ahead = scipy.linalg.expm(step * system)
        state = np.array([command[0], 0.0, command[0], 0.0])
        found = np.empty_like(command)
        for k, slope in enumerate(np.append(np.diff(command), 0.0) / step):
            found[k] = state[0]
            state[2:] = command[k], slope
            state = ahead @ state
        return found


def joint_servo(
    joints: int,
    bandwidth: ArrayLike = np.inf,
    damping: ArrayLike = 1.0,
    delay: ArrayLike = 0.0,
) -> JointServo:
    """Return the servo of so many joints; one number stands for all of them.

    Raises
    ------
    StateError
        Another number of elements, or a value that is not > 0 (delay: >= 0 and finite).
    """
    columns = {}
    for name, given in (('bandwidth', bandwidth), ('damping', damping), ('delay', delay)):
        values = np.asarray(given, dtype=np.float64)
        if values.ndim > 1 or values.size not in (1, joints):
            raise StateError(
                f'servo: {name} must have 1 or {joints} elements, got shape {values.shape}'
            )
        columns[name] = np.broadcast_to(values, (joints,)).copy()
    for name in ('bandwidth', 'damping'):
        if not (columns[name] > 0.0).all():
            raise StateError(f'servo: {name} must be > 0, got {columns[name].tolist()}')
    if not (np.isfinite(columns['delay']).all() and (columns['delay'] >= 0.0).all()):
        raise StateError(f'servo: delay must be >= 0 s, got {columns["delay"].tolist()}')
    return JointServo(columns['bandwidth'], columns['damping'], columns['delay'])
