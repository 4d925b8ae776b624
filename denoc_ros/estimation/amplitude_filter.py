"""Covariance and gains of the Kalman filter on amplitudes, rates and loads the model leaves out.

The mean is not here: the nonlinear model moves it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.elastic.section import Section
from denoc_ros.dynamics.equilibrium import response
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import spring_indices
from denoc_ros.errors import StateError
from denoc_ros.kernels.algebra.kalman import predict_covariance, take_readings, take_values
from denoc_ros.kernels.dynamics.step import GAMMA
from denoc_ros.kernels.jit.compiled import entry, ready
from denoc_ros.model.arrays import is_flexible
from denoc_ros.types import Array

TWIST = 3
TIP = (1, 2, TWIST)  # u_y, u_z and the twist among a section's six displacements
TURN = 0.02  # rad or m that a joint may move before the linearization is made anew
SPREAD = 0.1  # deviation of a load in each mode alone, as a share of that of the tip's load
REST = 0.1  # of the model's error that is no steady share of the elastic forces
MEMORY = 300.0  # s in which a steady share changes
LARGEST = 0.5  # share of an elastic force


@dataclass
class MeasurementModel:
    """How sensors on beams read a state x = [d; d'; f]; all but the numbers change in place.

    Attributes
    ----------
    shapes, moved : (sensors, m) and (sensors, 3 m) arrays
        Derivatives by d through the beams' shapes, and by x of all that is beyond them.
    constant, beyond : (sensors,) arrays
        Parts that do not depend on x; those beyond the shapes at the last state.
    noise : (sensors,) array
        Standard deviations.
    timing_error, model_error : float
        Of the stamps [s]; of the parts beyond the shapes, as a share of them.
    """

    shapes: Array
    moved: Array
    constant: Array
    beyond: Array
    noise: Array
    timing_error: float
    model_error: float


class AmplitudeFilter:
    """Covariance (3 m, 3 m) of x = [d; d'; f], f generalized forces that the model leaves out.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    step : float
        Time of one prediction [s].
    model_error : float
        Standard deviation of the loads as a share of the elastic forces at the time.
    initial_deflection : float
        Share of a beam's length by which its tip may be off at the start.
    free : int array, optional
        Coordinates whose motion is not given: the amplitudes, and no others by default.
    constants : (c,) array, optional
        Standard deviations at the start of unknown constants: they stand behind f in x.
    steady : int, optional
        How many loads there are of which a steady share may be missing. Then most of the model's
        error is taken as steady shares e (m + loads,) of the elastic forces and of the loads,
        which stand behind the constants in x.

    Attributes
    ----------
    covariance : (3 m + c, 3 m + c) array, or m + loads more of shares
    carried : (m, loads) array
        Forces on the amplitudes of those loads now.
    mobility, held_mobility : (m, m) array
        Accelerations of the amplitudes by forces on them, as last linearized; with the joints'
        given.
    stiffness, damping : (m,) arrays
    decay : float
        Factor of the loads' mean over one step.
    independent_loads : (m, m) array
        Covariance of loads of unit deviation in all modes.
    linear_steps : pair of (3 m, 3 m) and (3 m, m) arrays
        Transition of [d; d'; f] over one step, and its change by steady forces; a new pair
        whenever the model is linearized.

    Notes
    -----
    M d'' + C d' + K d = f + ..., with M^-1 the amplitudes' block of the response of all that is
    free, K and C the diagonals of elasticity and damping. x' = J x is stepped as the model is
    (:mod:`denoc_ros.kernels.dynamics.step`), by R(h J) with

        R(z) = (1 + (1 - 2 gamma) z) / (1 - gamma z)^2.

    The loads are Gauss-Markov with correlation time 1 / omega, omega the lowest natural
    frequency: what is slower is a load, what is faster vibration. Per deformation of a beam they
    have covariance sigma^2 (b b^T + spread^2 1): a load at the tip, b = s(tip), and a little in
    each mode, which sensors at several stations can tell apart. sigma is `model_error` times the
    force that the first mode carries at its present amplitude of vibration; at least what moves
    a sensor by its noise. At the start energy is shared equally: that of a first mode off by
    `initial_deflection`.

    A wrong stiffness errs by the same share of the elastic forces at all times, a wrong payload
    by the same share of the forces that it takes. Shares e have the deviation `model_error`, per
    deformation nearly the same, and their forces act beside the loads f, whose deviation then is
    `REST` of that above.
    """

    def __init__(
        self,
        robot: Robot,
        step: float,
        model_error: float,
        initial_deflection: float,
        free: NDArray[np.int64] | None = None,
        constants: Array | None = None,
        steady: int | None = None,
    ) -> None:
        ready(take_values)
        self._go_on, self._take = entry(predict_covariance), entry(take_readings)
        self._robot, self._step = robot, step
        self._share = 0.0 if steady is None else model_error
        self._error = model_error if steady is None else REST * model_error
        self._flexible, self._joints = robot.flexible_indices, robot.joint_indices
        self._free = self._flexible if free is None else free
        self._among_free = np.searchsorted(self._free, self._flexible)
        self.stiffness: Array = robot.stiffness[self._flexible]
        self.damping: Array = robot.damping[self._flexible]
        self._m = m = len(self._flexible)
        self._shape, self._first, lengths = load_shapes(robot)
        self.independent_loads: Array = self._shape + (1.0 - SPREAD**2) * np.eye(m)
        force = self.stiffness[self._first] * initial_deflection * lengths
        self._start_force: Array = force
        self._floor = np.zeros(m)
        self._constants = np.zeros(0) if constants is None else constants
        after = 3 * m + len(self._constants)
        size = after + (0 if steady is None else m + steady)
        self.carried = np.zeros((m, steady or 0))
        self._shares = slice(after, size)
        self._pushed = np.zeros((3 * m, m))  # one step of x by a steady force
        self.covariance, self._scratch = np.zeros((2, size, size))
        self._transition: Array = np.eye(size)
        self._gain = np.zeros(size)
        self.mobility: Array = np.zeros((m, m))
        self.held_mobility: Array = self.mobility
        self._bending: Array = np.zeros((m, m))  # accelerations of the amplitudes by themselves
        self._posture: Array = np.full(len(robot.joint_indices), np.inf)
        self._omega, self.decay, self._still = 1.0, 1.0, np.zeros(m)
        self.linear_steps: tuple[Array, Array] = np.eye(3 * m), self._pushed

    def set_floor(self, rows: Array, noise: Array) -> None:
        """Take the least deviation of the loads from sensors, rows (k, m) and their noise (k,)."""
        tips = self._shape * (self._first[:, None] == self._first)
        reaction = np.abs(rows @ (tips / self.stiffness[:, None]))
        moved = np.divide(
            noise[:, None], reaction, out=np.full_like(reaction, np.inf), where=reaction > 0.0
        )
        least = moved.min(axis=0, initial=np.inf)
        self._floor = np.where(np.isfinite(least), least, 0.0)

    def retune(self, change: Callable[[Robot], None]) -> None:
        """Let numbers of the model change: a function changes those of a robot."""
        change(self._robot)
        self.stiffness = self._robot.stiffness[self._flexible]
        self.damping = self._robot.damping[self._flexible]
        self._posture[:] = np.inf

    def linearize(self, q: Array) -> None:
        """Linearize the model at coordinates q (n,), unless its joints have not moved.

        Raises
        ------
        StateError
            The amplitudes are where the model has no vibration: the state has left all bounds.
        """
        posture = q[self._joints]
        turned = posture - self._posture
        # The sum of squares is quicker to find than the largest, and is not smaller.
        if len(posture) and (turned.dot(turned) < TURN**2 or np.abs(turned).max() < TURN):
            return
        self._posture = posture
        m, h = self._m, self._step
        whole = response(self._robot, q, self._free)
        self.mobility = answer = whole[np.ix_(self._among_free, self._among_free)]
        held = len(self._free) == m
        self.held_mobility = answer if held else response(self._robot, q, self._flexible)
        self._bending = np.ascontiguousarray(answer * self.stiffness)
        root = np.sqrt(self.stiffness)
        scaled = root[:, None] * answer * root
        lowest = np.linalg.eigvalsh(scaled)[0] if np.isfinite(scaled).all() else math.nan
        if not lowest > 0.0:
            raise StateError(
                f'{self._robot.tree.name}: the model must vibrate at these amplitudes, got a '
                'lowest '
                f'squared frequency of {lowest:.3g}'
            )
        self._omega = omega = math.sqrt(lowest)
        jacobian = np.zeros((4 * m, 4 * m))  # with steady forces behind
        jacobian[:m, m : 2 * m] = np.eye(m)
        jacobian[m : 2 * m, :m] = -answer * self.stiffness
        jacobian[m : 2 * m, m : 2 * m] = -answer * self.damping
        jacobian[m : 2 * m, 2 * m :] = np.tile(answer, 2)
        jacobian[2 * m : 3 * m, 2 * m : 3 * m] = -omega * np.eye(m)
        implicit = np.eye(4 * m) - GAMMA * h * jacobian
        explicit = np.eye(4 * m) + (1.0 - 2.0 * GAMMA) * h * jacobian
        transition = np.linalg.solve(implicit, np.linalg.solve(implicit, explicit))
        self._transition[: 3 * m, : 3 * m] = transition[: 3 * m, : 3 * m]
        self._pushed = transition[: 3 * m, 3 * m :]
        self.linear_steps = transition[: 3 * m, : 3 * m], self._pushed
        self.decay = float(transition[3 * m - 1, 3 * m - 1])

    def reset(self, q: Array, doubt: float = 1.0) -> None:
        """Start at coordinates q (n,), off by so many times the assumed initial error."""
        self._posture[:] = np.inf
        self.linearize(q)
        self.covariance[:] = 0.0
        self.covariance[: 3 * self._m, : 3 * self._m] = self.start_covariance(self._error, doubt)
        constants = slice(3 * self._m, self._shares.start)
        self.covariance[constants, constants] = np.diag(self._constants**2)
        self.covariance[self._shares, self._shares] = self._share_covariance()

    def start_covariance(self, error: float, doubt: float) -> Array:
        """Return the covariance (3 m, 3 m) of [d; d'; f] at the start.

        Parameters
        ----------
        error : float
            Standard deviation of the loads as a share of the elastic forces.
        doubt : float
            Times the assumed initial error.
        """
        m, force = self._m, doubt * self._start_force
        energy = force * force / self.stiffness[self._first]
        covariance = np.zeros((3 * m, 3 * m))
        covariance[:m, :m] = np.diag(energy / self.stiffness)
        shared = np.sqrt(energy)
        covariance[m : 2 * m, m : 2 * m] = shared[:, None] * self.mobility * shared
        loads = np.hypot(error * force, self._floor)
        covariance[2 * m :, 2 * m :] = loads[:, None] * self._shape * loads
        return covariance

    def _share_covariance(self) -> Array:
        """Return the shares' covariance at the start; empty without shares."""
        return self.share_covariance(self._share, self._shares.stop - self._shares.start)

    def share_covariance(self, error: float, count: int) -> Array:
        """Return the covariance of steady shares: of the elastic forces, then of other forces.

        Parameters
        ----------
        error : float
            Standard deviation of a share.
        count : int
            Number of shares.
        """
        same, m = np.eye(count), min(self._m, count)
        first = self._first[:m]
        same[:m, :m] = (first[:, None] == first) + SPREAD**2 * np.eye(m)
        return np.asarray(error**2 * same)

    def envelope(self, amplitudes: Array, rates: Array) -> Array:
        """Return the amplitudes of the present vibration, from amplitudes and rates (..., m)."""
        return np.asarray(np.hypot(amplitudes, rates / self._omega))

    def load_deviation(self, envelope: Array, error: float) -> Array:
        """Return the standard deviations (m,) of independent loads in all modes.

        Parameters
        ----------
        envelope : (m,) array
            Amplitudes of the present vibration.
        error : float
            Share of the elastic force of the first mode.
        """
        force = error * self.stiffness[self._first] * envelope[self._first]
        return np.asarray(np.hypot(force, self._floor))

    def load_noise(self, deviation: Array, steps: int) -> Array:
        """Return the covariance (m, m) that loads of these deviations (m,) gain in some steps."""
        gained = (1.0 - self.decay ** (2 * steps)) * self.independent_loads
        return np.asarray(deviation[:, None] * gained * deviation)

    def shared(self, amplitudes: Array) -> Array:
        """Return the forces (m, m + loads) of which shares may be missing, at amplitudes (m,)."""
        return np.hstack((np.diag(self.stiffness * amplitudes), self.carried))

    def predict(
        self, amplitudes: Array, rates: Array, steps: int = 1, envelope: Array | None = None
    ) -> None:
        """Let the covariance go on by some steps at amplitudes and rates (m,).

        `envelope` (m,) has the amplitudes of the vibration that the loads are shares of; default
        that of the amplitudes and rates.
        """
        shares = self._shares
        if self._share:
            self._transition[: 3 * self._m, shares] = self._pushed @ self.shared(amplitudes)
            self.covariance[shares, shares] += (
                2.0 * steps * self._step / MEMORY
            ) * self._share_covariance()
        if envelope is not None:
            amplitudes, rates = envelope, self._still
        self._go_on(
            self.covariance, self._transition, self._scratch, self._shape, self.stiffness,
            self._first, amplitudes, rates, self._omega, self._error, self.decay, self._floor,
            steps,
        )  # fmt: skip

    def correct_readings(
        self, places: NDArray[np.intp], values: Array, reading: MeasurementModel, lag: float,
        gate: float, state: Array,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Take readings of sensors on beams of one time in; correct the state (s,) in place.

        Parameters
        ----------
        places : (k,) int array
            Of the sensors.
        values : (k,) array
        reading : MeasurementModel
            How the sensors read the state.
        lag : float
            By how much the covariance is of later than the readings [s]; 0: it is of then.
        gate : float
            Standard deviations of an innovation beyond which a reading is refused.
        state : (s,) array
            Expected at the time of the readings.

        Returns
        -------
        change : (s,) array
            The correction.
        taken : (k,) array
            1, or 0 for a refused reading.
        """
        change, taken = np.empty(len(state)), np.empty(len(values))
        self._take(
            self.covariance, places, values, reading.constant, reading.shapes, reading.moved,
            reading.noise, reading.beyond, self._bending, lag, reading.timing_error,
            reading.model_error, gate, state, change, taken,
        )  # fmt: skip
        return change, taken

    def correct_rows(
        self, rows: Array, noise: Array, values: Array, gate: float, state: Array
    ) -> Array:
        """Take values of one time in, one after another; correct the state (3 m + c,) in place.

        Parameters
        ----------
        rows : (k, 3 m + c) array
            The values' derivatives by the state.
        noise, values : (k,) arrays
            Standard deviations, and what was measured.
        gate : float
            Standard deviations of an innovation beyond which a value is refused.
        state : (3 m + c,) array
            Expected.

        Returns
        -------
        (k,) array of bool
            Which were not refused.
        """
        taken = np.zeros(len(values))
        take_values(self.covariance, rows, noise, values, gate, state, self._gain, taken)
        return np.asarray(taken > 0.0)

    def carry(self, correction: Array) -> Array:
        """Return a correction (3 m,) of x propagated by one step."""
        return self._transition @ correction

    def adopt(self, other: AmplitudeFilter) -> None:
        """Go on from another filter's covariance of as many amplitudes."""
        self.covariance[:] = other.covariance
        self._posture[:] = np.inf


def load_shapes(robot: Robot) -> tuple[Array, NDArray[np.intp], Array]:
    """Return the loads' covariance (m, m) at unit deviation, and per amplitude two more arrays.

    The first amplitude of its deformation, and the length [m] of its beam, for twist 1 rad; the
    spring of a joint is its own, of 1 rad.
    """
    flexible = robot.flexible_indices
    m = len(flexible)
    shape, first, lengths = np.zeros((m, m)), np.zeros(m, dtype=np.intp), np.zeros(m)
    for body in robot.tree.bodies:  # each segment of a link by itself
        if not is_flexible(body):
            continue
        own = robot.amplitudes(body.name)
        base, start = int(np.searchsorted(flexible, own.start)), 0
        if body.modes is not None:  # each mode by itself
            part = slice(base, base + body.amplitudes)
            shape[part, part] = (1.0 + SPREAD**2) * np.eye(body.amplitudes)
            first[part], lengths[part] = np.arange(part.start, part.stop), body.spans
            continue
        assert body.beam is not None
        section = Section(body.beam, body.beam.length, robot.geometric_stiffness)
        for count, component in zip(body.beam.modes, TIP, strict=True):
            part = slice(base + start, base + start + count)
            tip = section.linear[component, start : start + count]
            shape[part, part] = np.outer(tip, tip) + SPREAD**2 * np.eye(count)
            first[part] = part.start
            lengths[part] = 1.0 if component == TWIST else body.beam.length
            start += count
    springs = np.searchsorted(flexible, spring_indices(robot))
    shape[springs, springs] = 1.0 + SPREAD**2
    first[springs] = springs
    lengths[springs] = 1.0
    return shape, first, lengths
