"""Simulation with an adaptive integrator over the robot's dynamics, and its result.

Motions without external forces and torques take DOP853 with compiled steps: an evaluation of the
accelerations takes some microseconds, Python between two of them several times that. Stiff beams
in loops, whose vibrations keep the steps short, fall much faster this way.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import BDF, DOP853, LSODA, RK45, Radau
from tqdm import tqdm

from denoc_ros.dynamics.base.base_motion import Base
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.dynamics import runge_kutta as steps
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.kernels.jit.handle import GOOD
from denoc_ros.simulation.equations_of_motion import (
    EquationsOfMotion,
    Prescribed,
    Torque,
    checked_vector,
)
from denoc_ros.types import Array

LONGEST_TURN = 1.0  # rad between two looks at a floating base's attitude
METHODS = {'DOP853': DOP853, 'RK45': RK45, 'LSODA': LSODA, 'Radau': Radau, 'BDF': BDF}
# A projection onto loops moves the state, and so does a rotation vector that is brought back:
# methods that remember earlier steps cannot take it.
ONE_STEP = ('DOP853', 'RK45', 'Radau')


@dataclass(frozen=True)
class Run:
    """A simulated motion, sampled at the output times.

    Attributes
    ----------
    t : (k,) array
        Output times [s].
    q, qd : (k, n) arrays
        Coordinates and rates, in the robot's coordinate order.
    energy : (k, 2) array
        Kinetic and potential energy [J].
    torque : (k, n) array
        Generalized forces applied [N m, N]; at prescribed joints those that the motion needs.
    coordinate_names : tuple of str
        Names of the columns of `q`.
    evaluations : int
        How often the accelerations were worked out.
    """

    t: Array
    q: Array
    qd: Array
    energy: Array
    torque: Array
    coordinate_names: tuple[str, ...]
    evaluations: int

    def coordinate(self, name: str) -> Array:
        """Return one coordinate over time.

        Parameters
        ----------
        name : str
            As in `coordinate_names`.

        Returns
        -------
        (k,) array
            rad or m.

        Raises
        ------
        KeyError
            For an unknown name.
        """
        if name not in self.coordinate_names:
            raise KeyError(
                f'run: coordinate must be one of {", ".join(self.coordinate_names)}, got {name!r}'
            )
        return self.q[:, self.coordinate_names.index(name)]

    @property
    def energy_drift(self) -> float:
        """Largest change of the total energy, over the largest kinetic energy (1 if that is 0)."""
        total = self.energy.sum(axis=1)
        scale = float(np.max(self.energy[:, 0], initial=0.0)) or 1.0
        return float(np.max(np.abs(total - total[0]), initial=0.0)) / scale


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


def simulate(
    robot: Robot,
    q0: Array,
    qd0: Array,
    t: Array,
    torque: Torque | None = None,
    prescribed: Prescribed | None = None,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    *,
    method: str = 'DOP853',
    progress: bool = False,
    base: Base | Callable[[float], Base] | None = None,
) -> Run:
    """Integrate the equations of motion.

    Parameters
    ----------
    robot : Robot
        The robot. Mimic joints are kept tied to their leaders, loops closed (docs/loops.md).
    q0, qd0 : (n,) arrays
        State at `t[0]`, with loops closed to 1e-6 (`robot.assemble`, `robot.assemble_rates`).
    t : (k,) array
        Output times [s], strictly increasing; the first is the start.
    torque : callable, optional
        `(t, q, qd) -> (n,)` generalized forces [N m, N]; none: zero.
    prescribed : mapping of str to callable, optional
        Joint name to `t -> (q, qd, qdd)`: these joints move so, the other coordinates freely.
    rtol, atol : float
        Tolerances of the integrator per step.
    method : str
        DOP853 (order 8; the right one for lightly damped vibration), RK45, or for overdamped,
        stiff robots LSODA, Radau or BDF; the first two and Radau with loops or a floating base.
    progress : bool
        Show a progress bar on a terminal.
    base : (twist, acceleration[, pose]) or callable, optional
        The motion of the base, as `BaseMotion` says: steady, or `t -> (twist, acceleration)` or
        `t -> (twist, acceleration, pose)`. Energies are then those of the motion in space.

    Returns
    -------
    Run
        Sampled at `t`.

    Raises
    ------
    StateError
        For arrays of a wrong shape, not finite or times out of order.
    SolverError
        If the integrator fails; the message says how far it came.
    """
    times = _checked_times(t)
    one_step = robot.tree.loops or len(robot.base_indices)
    methods = ONE_STEP if one_step else tuple(METHODS)
    if method not in methods:
        raise StateError(f'simulate: method must be one of {", ".join(methods)}, got {method!r}')
    motion = EquationsOfMotion(robot, torque, prescribed, base)
    state = motion.start(
        checked_vector(q0, robot.n, 'q0'), checked_vector(qd0, robot.n, 'qd0'), times[0]
    )
    with (
        np.errstate(over='ignore', invalid='ignore'),
        tqdm(
            total=times[-1] - times[0],
            disable=not (progress and sys.stderr.isatty()),
            unit='s',
            bar_format='{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}]',
        ) as bar,
    ):
        states, failure = integrate(motion, state, times, method, (rtol, atol), bar.update)
    if failure:
        raise SolverError(failure)
    return _sampled(motion, times, states)


def integrate(
    motion: EquationsOfMotion,
    state: Array,
    times: Array,
    method: str,
    tolerances: tuple[float, float],
    advance: Callable[[float], object],
    most: int = sys.maxsize,
) -> tuple[Array, str]:
    """Integrate a motion as far as the integrator gets.

    Parameters
    ----------
    motion : EquationsOfMotion
        The equations.
    state : (2 f,) array
        The start, as `motion.start` returns it.
    times : (k,) array
        Output times [s], increasing.
    method : str
        One of `METHODS`.
    tolerances : tuple of float
        Relative and absolute, per step.
    advance : callable
        Takes each step's length [s].
    most : int
        Evaluations of the accelerations after which it gives up.

    Returns
    -------
    states : (m, 2 f) array
        At the first m output times; m = k where it got to the end.
    failure : str
        Why it did not get to the end, else empty.
    """
    states = np.empty((len(times), len(state)))
    states[0], done = state, 1
    if len(times) == 1 or not len(state):
        return states, ''
    compiled = method == 'DOP853' and motion.is_free
    trials = _Trials(motion)
    solver = (
        CompiledDOP853(motion, state, times, *tolerances)
        if compiled
        else METHODS[method](
            trials.rate, times[0], state, times[-1], rtol=tolerances[0], atol=tolerances[1]
        )
    )
    while solver.status == 'running':
        before = solver.t
        message = solver.step()
        if motion.has_loops and not compiled and np.isfinite(solver.y).all():
            solver.y = motion.close(solver.t, solver.y)
            solver.f = motion.rate(solver.t, solver.y)
        upto = int(np.searchsorted(times, solver.t, side='right'))
        if upto > done:
            states[done:upto] = solver.dense_output()(times[done:upto]).T
        finite = np.isfinite(states[done:upto]).all() and np.isfinite(solver.y).all()
        if solver.status == 'failed' or not finite:
            trials.raise_refusal()
            return states[:done], _failure(solver, motion, times[-1], message)
        done = max(done, upto)
        wrapped = motion.wrapped(solver.y)
        if wrapped is not None:
            solver.y = wrapped
            solver.f = motion.rate(solver.t, solver.y)
        advance(solver.t - before)
        if motion.evaluations > most and solver.status == 'running':
            return states[:done], _failure(solver, motion, times[-1], 'too many evaluations')
    states[-1] = solver.y
    return states, ''


class _Trials:
    """The rates of an integrator's trial states, of which some have none.

    At rest in equilibrium an integrator's first trial goes far: where it leaves all states that
    have accelerations, the answer is NaN, for which it takes a smaller step.
    """

    def __init__(self, motion: EquationsOfMotion) -> None:
        self._motion = motion
        self._begun = False
        self._refusal: SolverError | None = None

    def rate(self, t: float, state: Array) -> Array:
        """Return d(state)/dt, or NaN; the start must have one."""
        try:
            rate = self._motion.rate(t, state)
        except SolverError as error:
            if not self._begun:
                raise
            self._refusal = error
            return np.full(state.shape, np.nan)
        self._begun = True
        return rate

    def raise_refusal(self) -> None:
        """Raise the error for which the last trial was refused, if any."""
        if self._refusal is not None:
            raise self._refusal


def _failure(solver: Any, motion: EquationsOfMotion, end: float, message: str | None) -> str:
    count = len(motion.free)
    largest = np.max(np.abs(solver.y[:count])), np.max(np.abs(solver.y[count:]))
    return (
        f'simulate: {type(solver).__name__} must reach t = {end:.6g} s, got to {solver.t:.6g} s '
        f'after {motion.evaluations} evaluations with steps of {solver.h_abs:.3g} s: '
        f'largest coordinate {largest[0]:.3g}, largest rate {largest[1]:.3g} '
        f'({message or "the state is not finite"}); the motion diverges, or needs another method'
    )


def _sampled(motion: EquationsOfMotion, times: Array, states: Array) -> Run:
    """Return the run of the integrator's states (k, 2 f)."""
    evaluations, n = motion.evaluations, len(motion.q)
    q, qd, tau = (np.empty((len(times), n)) for _ in range(3))
    energy = np.empty((len(times), 2))
    for index, time in enumerate(times):
        motion.accelerate(float(time), motion.close(float(time), states[index]))
        q[index], qd[index] = motion.wrapped_state()
        tau[index] = motion.tau
        energy[index] = motion.energy()
    finite = np.isfinite(energy).all(axis=1)
    if not finite.all():
        raise SolverError(
            f'simulate: the energy must stay finite, got an overflow at '
            f't = {times[int(np.argmin(finite))]:.6g} s; the motion diverges'
        )
    names = motion.coordinate_names
    return Run(times, q, qd, energy, tau, names, evaluations)


def _checked_times(t: Array) -> Array:
    times = np.array(t, dtype=np.float64)
    if times.ndim != 1 or not len(times):
        raise StateError(f'simulate: t must have shape (k,) with k >= 1, got {times.shape}')
    if not np.isfinite(times).all() or np.any(np.diff(times) <= 0.0):
        raise StateError('simulate: t must be finite and strictly increasing')
    return times
