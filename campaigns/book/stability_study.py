"""Numerical stability of forward dynamics: the recursion beside dense Cholesky (chapter 7).

Both integrate the same scenario, with the same integrator and tolerances, and are held against
what is right. The three criteria are those of the book's section 7.1, made precise here:

Zero-eigenvalue deviation
    delta_i(t) = |q_i(t) - q_i*(t)| of joint i, where q* solves the same equations: the desired
    motion where links are rigid and the torques are its inverse dynamics (that a table of them
    leaves something out then counts as an error); else an integration with DOP853 at relative
    tolerance 1e-12 (`SOLUTION_TOLERANCES`). A run is acceptable in joint
    i up to the first output time at which delta_i exceeds `ACCEPTED_DEVIATION`. Beside it stands
    q_i - q_i^desired, which the book plots and which for flexible links holds their flexibility.
Power difference
    PD(t) = sum_i tau_i(t) (q_i'(t) - q_i'*(t)) over the joints; acceptable up to the first output
    time at which |PD| exceeds `ACCEPTED_POWER` of the largest |sum_i tau_i q_i'*|.
Acceleration roughness
    R_i = rms_k(a_{k-1} - 2 a_k + a_{k+1}) / rms_k(a_k), a_k = q_i'' at the output times. A smooth
    signal of angular frequency w has R = (w dt)^2; noise from step to step has R of order 1. The
    solution's own R_i stands beside it: only what exceeds it is numerical.

A run that fails for small errors need not be the algorithm's fault. So two more curves are along
the solution: the growth rate of small errors that the motion itself has (the largest real part
among the eigenvalues of the equations linearized there), and the condition number of the inertia
matrix, times 1e-16 a bound on what a factorization may lose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from denoc_ros.dynamics.base.base_motion import Base
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.validation import as_output
from denoc_ros.errors import ConfigError, SolverError
from denoc_ros.simulation.equations_of_motion import EquationsOfMotion, Torque
from denoc_ros.simulation.scenario import Scenario
from denoc_ros.simulation.simulate import integrate
from denoc_ros.simulation.time_functions import TimeFunction
from denoc_ros.types import Array

Dense = TypeVar('Dense', bound='CholeskyRobot')


class CholeskyRobot(Robot):
    """A robot whose forward dynamics solves I q'' = tau - h with a dense Cholesky factor of I.

    O(n^3) in the coordinates, and what the book's chapter 7 compares its recursion with. Inertia
    matrix and bias forces are the same model's; all other verbs are those of :class:`Robot`.
    """

    @classmethod
    def of(cls: type[Dense], robot: Robot) -> Dense:
        """Return the same model and payloads with this forward dynamics."""
        _, arguments, state = robot.__reduce__()
        dense = cls(*arguments)
        dense.__setstate__(state)
        return dense

    def forward_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrenches: Mapping[str, ArrayLike] | None = None,
        out: Array | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Array:
        """Return the accelerations (n,) under generalized forces tau (n,).

        Parameters and errors as in :meth:`Robot.forward_dynamics`, single states only.
        """
        result = as_output(out, (self.n,))
        force = np.asarray(tau) - self.inverse_dynamics(
            q, qd, self._zero, wrenches, check=check, base=base
        )
        inertia = self.inertia_matrix(q, check=check)
        try:
            factor = cho_factor(inertia, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError as error:
            raise SolverError(
                f'{self.tree.name}: the inertia must be positive definite, got {error}'
            ) from error
        result[:] = cho_solve(factor, force, overwrite_b=True, check_finite=False)
        return result


SOLUTION_METHOD, SOLUTION_TOLERANCES = 'DOP853', (1e-12, 1e-14)
ACCEPTED_DEVIATION = 1e-3  # rad or m
ACCEPTED_POWER = 1e-2
ALGORITHMS: Mapping[str, Callable[[Robot], Robot]] = {
    'recursion': Robot.copy,
    'cholesky': CholeskyRobot.of,
}
REPEATS = 3  # of each run; the least processor time counts
LONG = 4.0  # s of processor time: runs that need no repeating
MOST_EVALUATIONS = 1_000_000
CALLS = 2000  # of forward dynamics alone, for its time
SPECTRA = 71  # times at which the motion is linearized


@dataclass(frozen=True)
class Trace:
    """A run with its accelerations, as far as it got."""

    t: Array  # (m,) output times reached [s]
    # (m, n) coordinates, rates, accelerations and generalized forces
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    evaluations: int  # how often the accelerations were worked out to integrate
    seconds: float  # processor time of the integration
    failure: str  # why it ended early, else empty


@dataclass(frozen=True)
class Measures:
    """One algorithm's run against the solution."""

    trace: Trace  # the run
    deviation: Array  # (m, joints) zero-eigenvalue deviation, absolute [rad, m]
    # (m, joints) q - desired; None where the scenario has no reference
    from_desired: Array | None
    power_difference: Array  # (m,) W
    roughness: Array  # (joints,) of the accelerations [-]
    # (joints,) time up to which the deviation is accepted [s]; the end of the run where it always
    # is
    acceptable: Array
    power_acceptable: float  # the same of the power difference [s]
    call_seconds: float  # processor time of one forward dynamics


@dataclass(frozen=True)
class Study:
    """Result of :func:`study_stability`."""

    joint_names: tuple[str, ...]
    joint_indices: NDArray[np.int64]  # (joints,) of int where they stand among the coordinates
    joint_units: tuple[str, ...]  # rad or m
    times: Array  # (k,) output times of the scenario [s]
    solution: Trace  # what is right, at all of them
    exact: bool  # the solution is the desired motion itself
    power: Array  # (k,) sum tau q' of the joints of the solution [W]
    solution_roughness: Array  # (joints,)
    runs: Mapping[str, Measures]  # by algorithm
    # largest difference of the two algorithms' joints [rad, m], as far as both got
    difference: float
    # the same where both integrate at the solution's tolerance: rounding, and its growth
    fine_difference: float
    # (s,) s, growth rate of small errors [1/s], condition number of the inertia matrix
    spectrum_times: Array
    growth: Array
    condition: Array

    @property
    def acceptable(self) -> bool:
        """Whether the recursion's run is accepted to its end in all joints."""
        return bool(np.all(self.runs['recursion'].acceptable >= self.times[-1]))


def study_stability(
    robot: Robot, scenario: Scenario, advance: Callable[[float], object] = lambda _step: None
) -> Study:
    """Integrate a scenario by the recursion and by dense Cholesky and measure both.

    Parameters
    ----------
    robot : Robot
        Without mimic joints and loops.
    scenario : Scenario
        With torques, or none; no joint prescribed. Its `rtol` is the absolute tolerance as well,
        as the book's one tolerance.
    advance : callable, optional
        Takes how much of the work was done, 0 to 1 in all.

    Raises
    ------
    ConfigError
        For a robot or scenario whose accelerations are not forward dynamics.
    """
    _require_forward(robot, scenario)
    robots = {name: make(robot) for name, make in ALGORITHMS.items()}
    share = 1.0 / (REPEATS * len(robots) + len(robots))
    span = float(scenario.times[-1] - scenario.times[0])

    def step(seconds: float) -> None:
        advance(share * seconds / span)

    fine = {
        name: trace(model, scenario, SOLUTION_METHOD, SOLUTION_TOLERANCES, step)
        for name, model in robots.items()
    }
    traces: dict[str, list[Trace]] = {name: [] for name in robots}
    tolerances = (scenario.rtol, scenario.rtol)
    for _ in range(REPEATS):
        if any(sum(one.seconds for one in made) > LONG for made in traces.values()):
            break
        for name, model in robots.items():
            traces[name].append(trace(model, scenario, scenario.method, tolerances, step))
    best = {name: min(made, key=lambda one: one.seconds) for name, made in traces.items()}
    desired = _desired(robot, scenario)
    exact = desired is not None and len(robot.flexible_indices) == 0
    solution = desired if exact and desired is not None else fine['recursion']
    joints = np.asarray(robot.joint_indices)
    power = np.sum(solution.tau[:, joints] * solution.qd[:, joints], axis=1)
    times, growth, condition = spectra(robot, solution, scenario.torque)
    return Study(
        robot.joint_names,
        joints,
        tuple(robot.tree.joints[name].unit for name in robot.joint_names),
        scenario.times,
        solution,
        exact,
        power,
        roughness(solution.qdd[:, joints]),
        {
            name: _measure(robots[name], one, solution, desired, power)
            for name, one in best.items()
        },
        _difference(best, joints),
        _difference(fine, joints),
        times,
        growth,
        condition,
    )


def trace(
    robot: Robot,
    scenario: Scenario,
    method: str,
    tolerances: tuple[float, float],
    advance: Callable[[float], object],
) -> Trace:
    """Integrate a scenario as far as it goes, and work out the accelerations at its outputs."""
    motion = EquationsOfMotion(robot, scenario.torque)
    times = scenario.times
    state = motion.start(scenario.q0, scenario.qd0, float(times[0]))
    began = time.thread_time()
    with np.errstate(over='ignore', invalid='ignore'):
        states, failure = integrate(
            motion, state, times, method, tolerances, advance, MOST_EVALUATIONS
        )
    seconds, evaluations = time.thread_time() - began, motion.evaluations
    q, qd, qdd, tau = (np.empty((len(states), robot.n)) for _ in range(4))
    for row, (t, values) in enumerate(zip(times[: len(states)], states, strict=True)):
        motion.accelerate(float(t), values)
        q[row], qd[row], qdd[row], tau[row] = motion.q, motion.qd, motion.qdd, motion.tau
    return Trace(times[: len(states)], q, qd, qdd, tau, evaluations, seconds, failure)


def roughness(accelerations: Array) -> Array:
    """Return R (joints,) of accelerations (k, joints) at equal steps of time."""
    size = np.sqrt(np.mean(accelerations**2, axis=0))
    second = np.sqrt(np.mean(np.diff(accelerations, 2, axis=0) ** 2, axis=0))
    return np.asarray(np.divide(second, size, out=np.zeros_like(size), where=size > 0.0))


def spectra(robot: Robot, solution: Trace, torque: Torque | None) -> tuple[Array, Array, Array]:
    """Return times, growth rates of small errors [1/s] and condition numbers along a motion."""
    rows = np.unique(np.linspace(0, len(solution.t) - 1, SPECTRA).astype(np.intp))
    growth, condition, n = np.empty(len(rows)), np.empty(len(rows)), robot.n
    # d(q', q'')/d(q, q'): torques depend on time alone
    change = np.eye(2 * n, k=n)
    for k, row in enumerate(rows):
        q, qd, t = solution.q[row], solution.qd[row], float(solution.t[row])
        tau = np.zeros(n) if torque is None else torque(t, q, qd)
        change[n:, :n], change[n:, n:], _ = robot.forward_dynamics_derivatives(q, qd, tau)
        growth[k] = np.max(np.linalg.eigvals(change).real)
        condition[k] = np.linalg.cond(robot.inertia_matrix(q))
    return solution.t[rows], growth, condition


def _require_forward(robot: Robot, scenario: Scenario) -> None:
    findings = []
    if scenario.prescribed:
        findings.append(
            'the scenario must drive the robot by torques (or let it fall), got prescribed joints '
            f'{", ".join(scenario.prescribed)}'
        )
    if robot.tree.mimics or robot.tree.loops:
        findings.append(f'the robot must have no mimic joints and no loops, got {robot.tree.name}')
    if len(scenario.times) < 4:
        findings.append(f'the scenario must have 4 output times, got {len(scenario.times)}')
    ConfigError.raise_any('stability', findings)


def _desired(robot: Robot, scenario: Scenario) -> Trace | None:
    """Return the reference at the output times, amplitudes at rest; None without a reference."""
    if scenario.reference is None:
        return None
    law, joints = TimeFunction(scenario.reference), np.asarray(robot.joint_indices)
    q, qd, qdd, tau = np.zeros((4, len(scenario.times), robot.n))
    for row, t in enumerate(scenario.times):
        q[row, joints], qd[row, joints], qdd[row, joints] = law(float(t))
        if scenario.torque is not None:
            tau[row] = scenario.torque(float(t), q[row], qd[row])
    return Trace(scenario.times, q, qd, qdd, tau, 0, 0.0, '')


def _measure(
    robot: Robot, one: Trace, solution: Trace, desired: Trace | None, power: Array
) -> Measures:
    joints, count = np.asarray(robot.joint_indices), min(len(one.t), len(solution.t))
    t = one.t[:count]
    off = one.q[:count, joints] - solution.q[:count, joints]
    rates = one.qd[:count, joints] - solution.qd[:count, joints]
    difference = np.sum(one.tau[:count, joints] * rates, axis=1)
    bound = ACCEPTED_POWER * float(np.max(np.abs(power), initial=0.0))
    from_desired = None if desired is None else one.q[:, joints] - desired.q[: len(one.t), joints]
    return Measures(
        one,
        np.abs(off),
        from_desired,
        difference,
        roughness(one.qdd[:, joints]),
        np.array([_until(t, np.abs(column), ACCEPTED_DEVIATION) for column in off.T]),
        _until(t, np.abs(difference), bound),
        _call_seconds(robot, one),
    )


def _until(t: Array, size: Array, bound: float) -> float:
    """Return the first time at which a size exceeds a bound, or the last time."""
    beyond = size > bound
    return float(t[np.argmax(beyond)] if beyond.any() else t[-1])


def _difference(traces: Mapping[str, Trace], joints: NDArray[np.int64]) -> float:
    one, other = traces['recursion'], traces['cholesky']
    count = min(len(one.t), len(other.t))
    gap = one.q[:count, joints] - other.q[:count, joints]
    return float(np.max(np.abs(gap), initial=0.0))


def _call_seconds(robot: Robot, one: Trace) -> float:
    out = np.empty(robot.n)
    rows = np.resize(np.arange(len(one.t)), CALLS)
    began = time.thread_time()
    for row in rows:
        robot.forward_dynamics(one.q[row], one.qd[row], one.tau[row], out=out, check=False)
    return (time.thread_time() - began) / CALLS
