"""DOP853 with compiled steps, for motions without external forces and torques.

An evaluation of the accelerations takes some microseconds, Python between two of them several
times that: stiff beams in loops, whose vibrations keep the steps short, fall much faster this way.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import DOP853

from denoc_ros.kernels import runge_kutta as steps
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.handle import GOOD
from denoc_ros.simulation.motion import EquationsOfMotion
from denoc_ros.types import Array

LONGEST_TURN = 1.0  # rad between two looks at a floating base's attitude


class CompiledDOP853(DOP853):  # type: ignore[misc]
    """scipy's DOP853 with the same formulas and control, stopping after steps that pass a time.

    Parameters
    ----------
    motion : EquationsOfMotion
        Free of torques and prescribed joints.
    state : (2 n,) array
        The start, loops closed.
    times : (k,) array
        Output times [s], increasing: each call of `step` passes at least one.
    rtol, atol : float
        Tolerances per step.
    """

    def __init__(
        self, motion: EquationsOfMotion, state: Array, times: Array, rtol: float, atol: float
    ) -> None:
        self.t: float
        self.h_abs: float
        self.y: Array
        self.f: Array
        super().__init__(motion.rate, times[0], state, times[-1], rtol=rtol, atol=atol)
        ready(steps.explicit_steps)
        self._motion = motion
        self._times = times
        errors = np.array([self.E3, self.E5])
        self._tables = np.ascontiguousarray(self.A), np.ascontiguousarray(self.B), errors
        self._no_forces = np.zeros(len(state) // 2)
        self._trial = np.zeros(len(state))

    def _step_impl(self) -> tuple[bool, str | None]:
        """Step until an output time is passed; scipy's hook for a step."""
        following = int(np.searchsorted(self._times, self.t, side='right'))
        control = np.zeros(steps.CONTROLS)
        control[steps.TIME], control[steps.STEP] = self.t, self.h_abs
        until = self._times[following]
        if len(self._motion.attitude):
            # a rotation vector is looked at before it can come near 2 pi
            rate = float(np.linalg.norm(self.f[self._motion.attitude]))
            until = min(until, self.t + LONGEST_TURN / max(rate, 1e-9))
        control[steps.UNTIL], control[steps.END] = until, self.t_bound
        control[steps.RELATIVE], control[steps.ABSOLUTE] = self.rtol, self.atol
        self.K[-1] = self.f
        y, self.y_old = self.y.copy(), np.empty_like(self.y)
        status = steps.explicit_steps(
            self._motion.handle,
            *self._tables,
            control,
            self._no_forces,
            y,
            self.y_old,
            self.K,
            self._trial,
        )
        self._motion.evaluations += int(control[steps.EVALUATIONS])
        self.t, self.y, self.f = float(control[steps.TIME]), y, self.K[-1].copy()
        self.h_abs, self.h_previous = control[steps.STEP], control[steps.TAKEN]
        return (True, None) if status == GOOD else (False, self.TOO_SMALL_STEP)

    def _dense_output_impl(self) -> object:
        self.t_old = self.t - self.h_previous  # of the last step, not of the call
        return super()._dense_output_impl()
