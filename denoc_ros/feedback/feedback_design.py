"""Gains of the state feedback: a linear-quadratic regulator and the filter that it needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import spring_indices
from denoc_ros.errors import SolverError
from denoc_ros.feedback.deviation_model import DeviationModel, PlannedState
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.model.arrays import is_flexible
from denoc_ros.model.sensors import SensorValue
from denoc_ros.types import Array

CORRELATION = 0.03  # s over which forces that the model does not know stay alike: Gauss-Markov
DOUBLINGS = 40
SETTLED = 1e-12  # relative change of a doubling
BIASES = 5.0  # standard deviations of a bias that is believed
BIAS_TIME = 1e5  # s over which a bias stays alike: Gauss-Markov
# factor of a gyroscope's noise in the filter: with the noise itself it would follow the rates
# within a period or two, and a loop with values 2 ms late would not be stable
TURNING = 10.0
# factor of a gauge's noise in the filter: modes that the design does not have are noise in it
STRAINING = 10.0
KNOWN = 0.125  # share of the model's error that is left where stiffness and load are estimated
BLIND = 30.0  # factor of the joints' noise in the filter by joints alone, which needs no speed
DEFLECTION = 0.15  # of a beam's length, beyond which a deviation is no robot's that has a plan
LEAST_TORQUE = 1e-3  # of the effort limit, that is never known
LEAST_DEFLECTION = 5e-4  # of a beam's length, whose elastic force is never known
DAMPING = 0.7  # ratio of the joints' motion, links rigid


def joint_inertia(model: DeviationModel) -> Array:
    """Return the inertia matrix (joints, joints) of the driven joints, links and springs rigid.

    Passive coordinates move freely.
    """
    k, rigid = model.joints, np.flatnonzero(model.stiff == 0.0)
    moved = model.measured[:k, rigid]
    mobility = moved @ np.linalg.solve(model.linear.inertia[np.ix_(rigid, rigid)], moved.T)
    return np.asarray(np.linalg.inv(mobility))


def joint_gains(model: DeviationModel, bandwidth: float) -> Array:
    """Return stiffness and damping (joints, 2 joints): torque = -gains [deviations; rates].

    Parameters
    ----------
    model : DeviationModel
    bandwidth : float
        Natural frequency of every joint, links rigid [Hz]; 0: no feedback.
    """
    inertia, omega = joint_inertia(model), 2.0 * np.pi * bandwidth
    return np.hstack([omega**2 * inertia, 2.0 * DAMPING * omega * inertia])


@dataclass(frozen=True)
class Regulator:
    """x[k + 1] = a x + b v, v torques in units of `scale`, x = [y; torques on their way; z].

    z are integrals of the virtual joint errors `virtual` y: what the joints must move so that the
    tip is where it should be.
    """

    a: Array
    b: Array
    weight: Array  # of x x^T in the cost; that of v v^T is the unit matrix
    virtual: Array  # (joints, m)
    past: int  # torques on their way


@cache
def _pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return both errors of each product of two of so many."""
    return np.triu_indices(count)


def terms(errors: Array) -> Array:
    """Return all that a polynomial of second degree without a constant has of errors (e,)."""
    first, second = _pairs(len(errors))
    return np.concatenate([errors, errors[first] * errors[second]])


def by_terms(tried: Array) -> Array:
    """Return what makes a polynomial's terms of its values at errors (k, e): (terms, k)."""
    return np.asarray(np.linalg.pinv(np.array([terms(errors) for errors in tried])))


@dataclass(frozen=True)
class PostureGains:
    """Gains of the loop at one moment of a plan.

    Attributes
    ----------
    gain : (joints, 2 m + past + joints) array
        Torque = -gain [y; torques on their way; integrals].
    transition : (e, e) array
        Of the estimate [y; forces; biases] over a period.
    push : (2 m, past + joints) array
        What the torques on their way and the new one add to y over a period.
    correction : (e, measured) array
        Of the estimate by the innovations.
    measured : (measured, e) array
    spread : (measured,) array
        Standard deviations of the innovations.
    blind : (e, 2 joints) array
        Correction by the joints alone, while sensors are not believed.
    reach : (measured,) array
        Largest innovations of sensors that are listened to while they are not believed.
    virtual : (joints, m) array
        Virtual joint errors by the coordinates.
    joints : (joints, 2 joints) array
        Torque = -joints [deviations of the measured joints; of their rates], beside that of
        `gain`.
    learner : (e, measured) array
        Correction of the estimate by which errors of the model and faults of sensors are found.
        Nothing feeds it back, so it may trust the model and the sensors more.
    surprise : (measured, measured) array
        Covariance of the innovations of that estimate.
    by_errors : (terms, 2 m, 2 m + past + joints) array
        Change of what y, the torques on their way and the new one make of y over a period, by
        :func:`terms` of the model's errors; zero where the filter does not follow them.
    unit : (2 m,) array
        Deviations that are as likely as one another where an estimate begins: bent by as much
        energy.
    """

    gain: Array
    transition: Array
    push: Array
    correction: Array
    measured: Array
    spread: Array
    blind: Array
    reach: Array
    virtual: Array
    joints: Array
    learner: Array
    surprise: Array
    by_errors: Array
    unit: Array

    def with_errors(self, errors: Array) -> tuple[Array, Array]:
        """Return `transition` and `push` of a robot with errors of the model (errors,)."""
        change = np.tensordot(terms(errors), self.by_errors, 1)
        transition, s = self.transition.copy(), len(change)
        transition[:s, :s] += change[:, :s]
        return transition, self.push + change[:, s:]


def virtual_joints(model: DeviationModel, settings: FeedbackSettings) -> Array:
    """Return the joint errors (joints, m) that would move the tip as deviations do.

    Least squares over the tip's errors and the joints' own, by their weights: where the joints
    cannot move the tip so, they are their own errors.
    """
    tip, own = _weighted(model, settings)
    through = tip @ np.linalg.pinv(own) * (1.0 / settings.joint_error)
    normal = through.T @ through + np.eye(model.joints) / settings.joint_error**2
    return np.asarray(np.linalg.solve(normal, through.T @ tip + own / settings.joint_error))


def _weighted(model: DeviationModel, settings: FeedbackSettings) -> tuple[Array, Array]:
    """Return the rows (6, m) of the tip and (joints, m) of the joints, weighted."""
    m = model.size
    weights = np.repeat([1.0 / settings.tip_error, 1.0 / settings.tip_turn], 3)
    tip = weights[:, None] * model.tip
    return tip, model.measured[: model.joints, :m] / settings.joint_error


def regulator(
    model: DeviationModel, limits: Array, settings: FeedbackSettings, inner: Array
) -> Regulator:
    """Return the regulator's problem at a moment.

    Parameters
    ----------
    model : DeviationModel
    limits : (joints,) array
        Effort limits [N m, N].
    settings : FeedbackSettings
    inner : (joints, 2 joints) array
        Gains of the joints' own feedback, which goes on beside.
    """
    m, k = model.size, model.joints
    sampled = model.sampled(settings.period, settings.delay)
    scale = settings.effort_share * limits
    s = len(sampled.a)
    past = s - 2 * m
    unit = np.concatenate([np.ones(2 * m), np.tile(scale, past // k)])
    virtual = virtual_joints(model, settings)
    tip, own = _weighted(model, settings)
    integrals = k if settings.integral_time else 0
    a = np.zeros((s + integrals, s + integrals))
    own_feedback = sampled.a.copy()
    own_feedback[:, : 2 * m] -= sampled.b @ inner @ model.measured[: 2 * k]
    a[:s, :s] = own_feedback * unit / unit[:, None]
    b = np.zeros((s + integrals, k))
    b[:s] = sampled.b * scale / unit[:, None]
    rows = np.zeros((len(tip) + k, s + integrals))
    rows[:, :m] = np.concatenate([tip, own])
    weight = rows.T @ rows
    if integrals:
        a[s:, :m] = settings.period * virtual
        a[s:, s:] = np.eye(k)
        through = np.concatenate([tip @ np.linalg.pinv(own) / settings.joint_error,
                                  np.eye(k) / settings.joint_error])  # fmt: skip
        weight[s:, s:] = through.T @ through / settings.integral_time**2
    return Regulator(a, b, weight, virtual, past)


def settled_cost(problem: Regulator) -> Array:
    """Return the cost matrix P of the infinite horizon.

    Raises
    ------
    SolverError
        There is none: a motion that the torques cannot stop.
    """
    found = _settled(problem.a, problem.b @ problem.b.T, problem.weight)
    if found is None:
        raise SolverError(
            'state feedback: every growing deviation must be controllable by the joints, got '
            'one that is not'
        )
    return found


def earlier_cost(problem: Regulator, cost: Array, doublings: int) -> Array:
    """Return the cost matrix 2^doublings periods before one, the problem constant in between."""
    a, g, h = problem.a, problem.b @ problem.b.T, problem.weight
    for _ in range(doublings):
        a, g, h = _doubled(a, g, h)
    before = h + a.T @ cost @ np.linalg.solve(np.eye(len(a)) + g @ cost, a)
    return np.asarray(0.5 * (before + before.T))


def _doubled(a: Array, g: Array, h: Array) -> tuple[Array, Array, Array]:
    """Riccati difference equation over twice the periods.

    Notes
    -----
    P before = h + a^T P (1 + g P)^-1 a. Over one period a is the transition, g = b b^T and h the
    weight; over twice as many a <- a w a, g <- g + a w g a^T, h <- h + a^T h w a with
    w = (1 + g h)^-1.
    """
    count = len(a)
    solved = np.linalg.solve(np.eye(count) + g @ h, np.hstack([a, g @ a.T]))
    g, h = g + a @ solved[:, count:], h + a.T @ h @ solved[:, :count]
    return a @ solved[:, :count], 0.5 * (g + g.T), 0.5 * (h + h.T)


def _settled(a: Array, g: Array, h: Array) -> Array | None:
    """Return the settled P of the Riccati difference equation, None if there is none."""
    with np.errstate(all='ignore'):
        for _ in range(DOUBLINGS):
            before = h
            try:
                a, g, h = _doubled(a, g, h)
            except np.linalg.LinAlgError:
                return None
            if not np.isfinite(h).all():
                return None
            if np.abs(h - before).max() <= SETTLED * np.abs(h).max():
                return h
    return None


def gain_of(problem: Regulator, cost: Array, limits: Array, settings: FeedbackSettings) -> Array:
    """Return the gain (joints, x) [N m, N] for the cost one period later."""
    a, b = problem.a, problem.b
    unscaled = np.linalg.solve(np.eye(b.shape[1]) + b.T @ cost @ b, b.T @ cost @ a)
    scale = settings.effort_share * limits
    gain = scale[:, None] * unscaled
    state = len(a) - problem.past - (b.shape[1] if settings.integral_time else 0)
    gain[:, state : state + problem.past] /= np.tile(scale, problem.past // len(scale))
    if not settings.integral_time:
        gain = np.hstack([gain, np.zeros((len(gain), b.shape[1]))])
    return np.asarray(gain)


@dataclass(frozen=True)
class Noise:
    """Standard deviations: of measured joints and sensors, and of forces that are not known."""

    measured: Array
    bias: Array  # of the same values
    least_force: Array  # (joints + flexible,)
    first: NDArray[np.intp]  # of each amplitude: the first of its deformation
    length: Array  # (flexible,) of the beam [m], 1 rad for twist; 0 for all but the first

    @property
    def biases(self) -> Array:
        """The standard deviations (biases,) of those that there are."""
        return np.asarray(self.bias[self.bias > 0.0])

    def with_biases(self, transition: Array, period: float) -> Array:
        """Return a transition over a period [s] with that of the biases.

        They fade slowly: one that nothing tells from a deviation cannot run away.
        """
        fading = math.exp(-period / BIAS_TIME) * np.eye(len(self.biases))
        return np.asarray(scipy.linalg.block_diag(transition, fading))

    def with_rates(self, factor: float, joints: int) -> Noise:
        """Return noise with so many times that of so many joints' rates."""
        measured = self.measured.copy()
        measured[joints : 2 * joints] *= factor
        return replace(self, measured=measured)

    def forces(self, state: PlannedState, stiff: Array, share: float) -> Array:
        """Return the deviations (joints + flexible,) of unknown forces at a moment."""
        elastic = (stiff * state.bent)[self.first]
        return np.asarray(np.hypot(share * np.concatenate([state.torque, elastic]),
                                   self.least_force))  # fmt: skip


def noise_of(
    robot: Robot, joints: int, sensors: Sequence[SensorValue], limits: Array,
    settings: FeedbackSettings, straining: float = 1.0, least: float = 1.0,
) -> Noise:  # fmt: skip
    """Return the noise of measurements and the least of the forces.

    `straining` is a factor of that of sensors on beams, `least` one of the forces.
    """
    measured = np.concatenate([
        np.full(joints, settings.position_noise), np.full(joints, settings.velocity_noise),
        [value.noise * (TURNING if value.kind == 'gyro' else straining) for value in sensors],
    ])  # fmt: skip
    bias = np.concatenate([np.zeros(2 * joints), [value.bias for value in sensors]])
    flexible = robot.flexible_indices
    first, length = np.zeros(len(flexible), dtype=np.intp), np.ones(len(flexible))
    for body in robot.tree.bodies:
        if not is_flexible(body):
            continue
        begin = int(np.searchsorted(flexible, robot.amplitudes(body.name).start))
        if body.modes is not None:  # each mode by itself
            modes = np.arange(begin, begin + body.amplitudes)
            first[modes], length[modes] = modes, body.spans
            continue
        assert body.beam is not None
        for count, span in zip(body.beam.modes, (body.beam.length, body.beam.length, 1.0),
                               strict=True):  # fmt: skip
            first[begin : begin + count] = begin
            length[begin : begin + count] = span
            begin += count
    own = np.searchsorted(flexible, spring_indices(robot))
    first[own] = own
    stiff = robot.stiffness[flexible]
    alone = np.where(first == np.arange(len(first)), length, 0.0)
    unknown = [LEAST_TORQUE * limits, LEAST_DEFLECTION * (stiff * length)[first]]
    return Noise(measured, bias, least * np.concatenate(unknown), first, alone)


def reach_of(model: DeviationModel, noise: Noise) -> Array:
    """Return the values (measured,) that beams show which are bent by a share of their length.

    Of gyroscopes: on beams that swing by so much, with a bias.
    """
    bent = np.zeros(model.size)
    bent[model.stiff > 0.0] = DEFLECTION * noise.length
    frequency = np.sqrt(model.stiff / np.diag(model.linear.inertia))
    shown = np.abs(model.measured) @ np.concatenate([bent, frequency * bent])
    return np.asarray(shown + BIASES * noise.bias)


def whole_rows(model: DeviationModel, noise: Noise) -> Array:
    """Return the measured values (measured, e) by y, unknown forces and biases."""
    forces = np.zeros((len(model.measured), model.linear.b.shape[1]))
    return np.hstack([model.measured, forces, np.eye(len(noise.bias))[:, noise.bias > 0.0]])


def estimator(
    measured: Array, transition: Array, noise: Noise, forces: Array, seen: int
) -> tuple[Array, Array]:
    """Return the correction (e, seen) of the settled filter and all innovations' covariance.

    Parameters
    ----------
    measured : (measured, e) array
        As :func:`whole_rows` returns it.
    transition : (e, e) array
        Over a period, as :meth:`DeviationModel.disturbed` returns it, with the biases.
    noise : Noise
    forces : (d,) array
        Deviations of the forces that are not known.
    seen : int
        How many of the measurements are used, the joints' first; fewer than all: a slow filter.

    Raises
    ------
    SolverError
        The measurements do not show every deviation.
    """
    total = len(transition)
    s = total - len(forces) - len(noise.biases)
    unit = np.concatenate([np.ones(s), forces, noise.biases])
    scaled = transition * unit / unit[:, None]
    rows = measured * unit
    deviations = noise.measured.copy()
    if seen < len(rows):
        deviations[:seen] *= BLIND
    rows /= deviations[:, None]
    added = np.zeros((total, total))
    added[s:, s:] = np.diag(1.0 - np.diag(transition)[s:] ** 2)
    covariance = _settled(scaled.T, rows[:seen].T @ rows[:seen], added)
    if covariance is None:
        raise SolverError(
            'state feedback: every deviation from the plan must be observable from joints '
            'and sensors, '
            'got one that is not; damping, or a sensor per deformation may help'
        )
    every = rows @ covariance @ rows.T + np.eye(len(rows))
    solved = np.linalg.solve(every[:seen, :seen], rows[:seen] @ covariance).T
    correction = unit[:, None] * solved / deviations[:seen]
    covariance = np.zeros_like(every)
    i, j = np.nonzero(every)  # what is not measured has endless noise, and shares none
    covariance[i, j] = deviations[i] * every[i, j] * deviations[j]
    return correction, covariance
