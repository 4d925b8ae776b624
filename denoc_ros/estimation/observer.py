"""The observer of deflections from measured joints, without ROS: the core of the predictor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import SolverError, StateError
from denoc_ros.estimation.tracking import TrackingFilter

Array = NDArray[np.float64]
Reference = Callable[[float], tuple[Array, Array, Array]]

SOURCES = ('joints', 'torque')

# After a gap of more ticks than this the observer goes on from the measurement instead.
MOST_STEPS = 10


@dataclass(frozen=True)
class ObserverSettings:
    """How the observer works.

    Attributes
    ----------
    step : float
        Time of one tick [s].
    source : str
        `joints`: the measured joint motion drives the amplitudes. `torque`: full forward
        dynamics under the effort, joints corrected by measurement.
    cutoff : float
        Bandwidth of the filter on measured joint motion [Hz].
    correction_cutoff : float
        Bandwidth at which measured joints correct the model's [Hz] (`torque` only).
    horizon : float
        How far ahead deflections are predicted [s]; 0: not at all.
    horizon_steps : int
        Steps of that prediction at most; fewer where the tick is longer than the horizon's part.
    max_age : float
        Measurements older than this [s] are refused; joints not measured for this long come to
        rest.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    step: float
    source: str = 'joints'
    cutoff: float = 50.0
    correction_cutoff: float = 10.0
    horizon: float = 0.0
    horizon_steps: int = 10
    max_age: float = 0.05

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise StateError(
                f'observer: source must be one of {", ".join(SOURCES)}, got {self.source!r}'
            )
        for name in ('step', 'cutoff', 'correction_cutoff', 'max_age'):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise StateError(f'observer: {name} must be > 0, got {value}')
        if not (math.isfinite(self.horizon) and self.horizon >= 0.0):
            raise StateError(f'observer: horizon must be >= 0 s, got {self.horizon}')
        if self.horizon_steps < 1:
            raise StateError(f'observer: horizon_steps must be >= 1, got {self.horizon_steps}')


class Observer:
    """Estimates the amplitudes of a flexible robot, tick by tick.

    Parameters
    ----------
    robot : Robot
        The model; the observer works on copies.
    settings : ObserverSettings
        How.

    Attributes
    ----------
    q, qd : (n,) arrays
        Estimated coordinates and rates at `time`.
    q_ahead, qd_ahead : (n,) arrays
        The same, `horizon` ahead, after `predict`.
    time : float
        Time of the estimate [s]; NaN before the first measurement.
    late, repeated, restarts, unsettled : int
        Measurements refused as too old, and as not newer than the last one; gaps that were not
        integrated over; starts undeformed for want of an equilibrium.
    deflections : TipDeflections
        The tips' displacements from amplitudes.
    """

    def __init__(self, robot: Robot, settings: ObserverSettings) -> None:
        self.settings = settings
        self._robot = robot.copy()
        self._stepper = Stepper(robot.copy(), settings.step)
        self._joints = np.asarray(robot.joint_indices, dtype=np.intp)
        self._flexible = np.setdiff1d(np.arange(robot.n), self._joints)
        self._inertia = np.zeros((robot.n, robot.n))
        self._filter = TrackingFilter(len(self._joints), settings.cutoff)
        self.deflections = TipDeflections(robot.tree)
        n = robot.n
        self.q, self.qd, self._tau = np.zeros(n), np.zeros(n), np.zeros(n)
        self.q_ahead, self.qd_ahead = np.zeros(n), np.zeros(n)
        self._ahead_steps = self._count_ahead()
        if self._ahead_steps:
            self._ahead = Stepper(robot.copy(), settings.horizon / self._ahead_steps)
        self.late = self.repeated = self.restarts = self.unsettled = 0
        self.reset()

    def _count_ahead(self) -> int:
        setting = self.settings
        if not setting.horizon:
            return 0
        return min(setting.horizon_steps, math.ceil(setting.horizon / setting.step - 1e-9))

    def reset(self) -> None:
        """Forget the state; the next measurement starts the observer again."""
        self.time = math.nan
        self._stamp = math.nan
        self._tau[:] = 0.0

    @property
    def started(self) -> bool:
        """Whether a measurement has started the observer."""
        return not math.isnan(self.time)

    def measure(
        self, stamp: float, q: Array, qd: Array | None = None, effort: Array | None = None
    ) -> bool:
        """Take a measurement of the joints in.

        The first one starts the observer, with the amplitudes in static equilibrium.

        Parameters
        ----------
        stamp : float
            When it was taken [s], on the clock of `tick`.
        q, qd : (joints,) arrays
            Positions and, if known, rates, in the order of the robot's joint names.
        effort : (joints,) array, optional
            Torques or forces at the joints [N m, N]; kept until the next.

        Returns
        -------
        bool
            False if it was refused: too old, or not newer than the last one.
        """
        if not self.started:
            self._start(stamp, q, qd)
            self._take_effort(effort)
            return True
        if not stamp > self._stamp:
            self.repeated += 1
            return False
        if self.time - stamp > self.settings.max_age:
            self.late += 1
            return False
        self._filter.update(q, qd, stamp - self._stamp)
        self._stamp = stamp
        self._take_effort(effort)
        return True

    def adopt(self, other: Observer) -> None:
        """Go on from the state of another observer of a robot with the same coordinates."""
        for mine, theirs in (
            (self.q, other.q),
            (self.qd, other.qd),
            (self._tau, other._tau),
            (self._filter.q, other._filter.q),
            (self._filter.qd, other._filter.qd),
            (self._filter.qdd, other._filter.qdd),
        ):
            mine[:] = theirs
        self.time, self._stamp = other.time, other._stamp
        self.late, self.repeated = other.late, other.repeated
        self.restarts, self.unsettled = other.restarts, other.unsettled

    def take_effort(self, effort: Array) -> None:
        """Take efforts (joints,) [N m, N] in that came by another way than `measure`."""
        self._take_effort(effort)

    def _take_effort(self, effort: Array | None) -> None:
        if effort is not None:
            self._tau[self._joints] = effort

    def _start(self, stamp: float, q: Array, qd: Array | None) -> None:
        self.time = self._stamp = stamp
        self._filter.reset(q, qd)
        self.q[:] = 0.0
        self.q[self._joints] = q
        try:
            self.q[:] = self._robot.static_deflection(q)
        except SolverError:
            # no equilibrium at this posture (buckled): nothing is known of the amplitudes
            self.unsettled += 1
        self.qd[:] = 0.0
        self.qd[self._joints] = self._filter.qd

    def tick(self, now: float) -> None:
        """Bring the estimate to a time [s] in whole steps; nothing before the first measurement.

        A gap of more than a few steps is not integrated over: the joints go on from what was
        measured, the amplitudes stay, and `restarts` counts it.
        """
        if not self.started:
            return
        steps = round((now - self.time) / self.settings.step)
        if steps > MOST_STEPS:
            self.restarts += 1
            self.time += (steps - 1) * self.settings.step
            steps = 1
        for _ in range(steps):
            self.time += self.settings.step
            self._step()

    @property
    def stale(self) -> bool:
        """Whether the last measurement is older than `max_age`."""
        return self.started and self.time - self._stamp > self.settings.max_age

    def _step(self) -> None:
        joints = self._joints
        q, qd = self._filter.ahead(self.time - self._stamp, self.settings.max_age)
        if self.settings.source == 'torque':
            self._stepper.free(self.q, self.qd, self._tau)
            self._correct(q, qd)
            return
        # The mean acceleration, not the filter's: so the amplitudes' rates feel the jumps of the
        # joints' rates once and noise does not pile up.
        self._stepper.driven(self.q, self.qd, (qd - self.qd[joints]) / self.settings.step)
        self.q[joints] = q
        self.qd[joints] = qd

    def _correct(self, q: Array, qd: Array) -> None:
        """Pull the joints towards the measured motion, the amplitudes as by an impulse there.

        A jump v of the joints' rates moves those of the amplitudes by -I_dd^-1 I_dj v.
        """
        gain = -math.expm1(-2.0 * math.pi * self.settings.correction_cutoff * self.settings.step)
        self.q[self._joints] += gain * (q - self.q[self._joints])
        jump = gain * (qd - self.qd[self._joints])
        if len(self._flexible):
            inertia = self._robot.inertia_matrix(self.q, out=self._inertia, check=False)
            rows = inertia[self._flexible]
            self.qd[self._flexible] -= np.linalg.solve(
                rows[:, self._flexible], rows[:, self._joints] @ jump
            )
        self.qd[self._joints] += jump

    def predict(self, reference: Reference | None = None) -> tuple[Array, Array]:
        """Predict the state `horizon` ahead.

        Parameters
        ----------
        reference : callable, optional
            `t -> (q, qd, qdd)` of the joints, on the clock of `tick`: they are taken to move on
            with its accelerations. None: with those measured last.

        Returns
        -------
        pair of (n,) arrays
            `q_ahead`, `qd_ahead`: overwritten by the next call.
        """
        self.q_ahead[:], self.qd_ahead[:] = self.q, self.qd
        if not self._ahead_steps:
            return self.q_ahead, self.qd_ahead
        step = self.settings.horizon / self._ahead_steps
        for index in range(self._ahead_steps):
            acceleration = self._filter.qdd
            if reference is not None:
                acceleration = reference(self.time + (index + 0.5) * step)[2]
            self._ahead.driven(self.q_ahead, self.qd_ahead, acceleration)
        return self.q_ahead, self.qd_ahead
