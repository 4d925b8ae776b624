"""Innovations of each sample, where noise of the joints makes links vibrate.

Noise of the measured joint motion drives the amplitudes of the model, and they remember it: the
residuals of a simulation hang together over many periods. A Kalman filter over the linear model of
the amplitudes follows that vibration by the residuals; what it does not foresee is white, and its
squares are the likelihood (L. Ljung, System Identification, 1999, section 7.4).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.constrained_dynamics import mimic_ties
from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.joint_motion import SmoothedMotion
from denoc_ros.estimation.joint_tracker import connecting_acceleration
from denoc_ros.kernels.algebra.kalman import filter_gains, filter_values, linear_states
from denoc_ros.kernels.derivatives.inverse_derivatives import inverse_dynamics_derivatives
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.types import Array, Flags

Motion = tuple[Array, Array]
Int = NDArray[np.int64]

MOST_APART = 1.5  # usual times between joint stamps: a row farther from all of them is not linked
# The series of a transition reaches so far in frequency times interval; with so many terms its
# remainder is below 1e-12.
SERIES_REACH, SERIES_ORDER = 0.5, 9


class NearbyMotion:
    """The linear model of the amplitudes about a motion, its joints moving as they do.

    Parameters
    ----------
    robot : Robot
        Without loops, mimic joints or a floating base.
    t : (k,) array
        [s]
    starts : (k,) bool array
        Where the amplitudes start anew, in equilibrium.
    motion : states (3, k, n), torques (k, joints)
        Of the robot: coordinates, rates and accelerations.

    Attributes
    ----------
    free : (f,) int array
        The amplitudes.
    transitions : (k - 1, 2f, 2f) array
        Of amplitudes and rates from a stamp to the next.
    slopes : (k, 2f, 2f) array
        Derivatives of rates and accelerations by amplitudes and rates.
    by_joints : (k, f, joints of the robot) array
        Of accelerations by those of the joints.

    Notes
    -----
    Between two stamps the linear model is that in the middle and the change of the accelerations
    is linear in time: x' = Phi x + G0 g + G1 g', with Phi = exp(A h).
    """

    def __init__(
        self, robot: Robot, joints: Sequence[str], t: Array, starts: Flags, motion: Motion
    ) -> None:
        # equilibria take their tangent from the second: by differences it takes ten times as long
        ready(linear_states, inverse_dynamics_derivatives)
        self._ties = mimic_ties(robot, joints, {})[0]
        self._index = robot.joint_indices
        self.free = np.setdiff1d(np.arange(robot.n), self._index)
        self.starts, self.motion, self._t = starts, motion, t
        q, qd, qdd = motion[0]
        slopes = self._by_motion = robot.hybrid_dynamics_derivatives(q, qd, qdd[:, self._index])
        f, k = len(self.free), len(t)
        self.slopes = np.zeros((k, 2 * f, 2 * f))
        self.slopes[:, :f, f:] = np.eye(f)
        self.slopes[:, f:, :f] = slopes.dqdd_dq[:, :, self.free]
        self.slopes[:, f:, f:] = slopes.dqdd_dqd[:, :, self.free]
        self.by_joints = slopes.dqdd_dqdd
        self._by_torque = self._ties.T @ np.concatenate(
            [slopes.dtau_dq[:, :, self.free], slopes.dtau_dqd[:, :, self.free]], axis=2
        )
        self.transitions, self._early, self._late = _transitions(t, starts, self.slopes)

    def about(self, motion: Motion) -> NearbyMotion:
        """Return the same linear model about another motion that differs little."""
        found = copy.copy(self)
        found.motion = motion
        return found

    def of(self, robot: Robot) -> Motion:
        """Return the motion of a robot that differs little."""
        q, qd, qdd = self.motion[0]
        forces, found = robot.hybrid_dynamics(q, qd, qdd[:, self._index])
        missed = found - qdd[:, self.free]
        pushed = _times(self._early, missed[:-1]) + _times(self._late, missed[1:])
        change = self._response(pushed, self._equilibria(robot, q))
        return self.changed(change, forces @ self._ties, found)

    def shaken(self, robot: Robot, noises: Sequence[SmoothedMotion]) -> Iterator[Motion]:
        """Yield the motions of the robot itself with noise on that of its joints.

        Parameters
        ----------
        noises : sequence of SmoothedMotion
            Of the recorded joints, small.

        Notes
        -----
        As in a simulation, accelerations between two stamps are those that connect positions and
        rates there.
        """
        (states, torques), by, index = self.motion, self._by_motion, self._index
        # Products with all noises at once take a fraction of the time of one by one.
        q, qd, qdd = (
            np.stack([rows @ self._ties.T for rows in each], axis=-1)
            for each in zip(*((n.q, n.qd, n.qdd) for n in noises), strict=True)
        )
        h = np.diff(self._t)[:, None, None]
        mean, slope = connecting_acceleration(h, q[:-1], qd[:-1], q[1:], qd[1:])
        by_rates = by.dqdd_dqd[:, :, index]
        there = by.dqdd_dq[:, :, index] @ q + by_rates @ qd
        # Rates between two stamps are off a line through theirs, by this in the mean.
        off = np.diff(q, axis=0) / h - 0.5 * (qd[:-1] + qd[1:])
        early = there[:-1] + self.by_joints[:-1] @ (mean - 0.5 * h * slope) + by_rates[:-1] @ off
        late = there[1:] + self.by_joints[1:] @ (mean + 0.5 * h * slope) + by_rates[1:] @ off
        pushed = self._early @ early + self._late @ late
        force = by.dtau_dq[:, :, index] @ q + by.dtau_dqd[:, :, index] @ qd
        force = self._ties.T @ (force + by.dtau_dqdd @ qdd)
        there += self.by_joints @ qdd
        for k in range(len(noises)):
            moved = states[0].copy()
            moved[:, index] += q[..., k]
            found, torque = self.changed(
                self._response(pushed[..., k], self._equilibria(robot, moved)),
                torques + force[..., k],
                states[2][:, self.free] + there[..., k],
            )
            for rows, more in zip(found, (q, qd, qdd), strict=True):
                rows[:, index] += more[..., k]
            yield found, torque

    def changed(
        self, change: Array, torques: Array | None = None, found: Array | None = None
    ) -> Motion:
        """Return the motion with other amplitudes and rates.

        Parameters
        ----------
        change : (k, 2f) array
        torques, found : arrays, optional
            Of the recorded joints (k, joints) and accelerations (k, f) without the change; default
            those of the robot.
        """
        f, (states, own) = len(self.free), self.motion
        moved = states.copy()
        moved[0][:, self.free] += change[:, :f]
        moved[1][:, self.free] += change[:, f:]
        free = states[2][:, self.free] if found is None else found
        moved[2][:, self.free] = free + _times(self.slopes[:, f:], change)
        return moved, (own if torques is None else torques) + _times(self._by_torque, change)

    def _equilibria(self, robot: Robot, q: Array) -> Array:
        """Return by how much equilibria at the starts differ from the amplitudes (starts, f)."""
        rows = np.flatnonzero(self.starts)
        still = [robot.static_deflection(q[k, self._index])[self.free] for k in rows]
        return np.asarray(np.array(still) - self.motion[0][0][np.ix_(rows, self.free)])

    def _response(self, pushed: Array, equilibria: Array) -> Array:
        """Return changes of amplitudes and rates (k, 2f).

        Parameters
        ----------
        pushed : (k - 1, 2f) array
            What each interval adds to them by changes of accelerations in it.
        equilibria : (starts, f) array
            Change of the amplitudes at each start.
        """
        f = len(self.free)
        found = np.zeros((len(self.starts), 2 * f))
        found[1:] = pushed
        found[self.starts, :f], found[self.starts, f:] = equilibria, 0.0
        linear_states(self.transitions, self.starts, found)
        return found


def _times(matrices: Array, vectors: Array) -> Array:
    """Return the products (k, m) of matrices (k, m, n) with vectors (k, n)."""
    return np.asarray((matrices @ vectors[:, :, None])[..., 0])


def _transitions(t: Array, starts: Flags, slopes: Array) -> tuple[Array, Array, Array]:
    """Return Phi (k - 1, 2f, 2f), G0 and G1 (k - 1, 2f, f) of each interval.

    Notes
    -----
    With z = A h they are h^j phi_j(z), phi_j(z) the sum of z^i / (i + j)!. The series is taken of
    z / 2^s, and s times doubled: phi_0(2 z) = phi_0^2, phi_1(2 z) = (phi_0 + 1) phi_1 / 2 and
    phi_2(2 z) = (phi_1^2 + 2 phi_2) / 4 (N. J. Higham, Functions of Matrices, 2008, section 10.7).
    Nothing crosses the interval before a start, however long it is.
    """
    f = slopes.shape[1] // 2
    h = np.where(starts[1:], 0.0, np.diff(t))[:, None, None]
    z = 0.5 * (slopes[:-1] + slopes[1:]) * h
    # bounds the largest frequency and decay times the interval, in whatever unit amplitudes are
    elastic, damped = (np.abs(z[:, f:, own]).sum(axis=2) for own in (slice(f), slice(f, None)))
    size = float(np.max(np.sqrt(elastic * h[:, 0]) + damped, initial=0.0))
    doublings = max(0, math.ceil(math.log2(max(size, 1e-300) / SERIES_REACH)))
    z *= 0.5**doublings
    one, second = np.eye(2 * f), np.zeros(z.shape)
    for order in range(SERIES_ORDER, -1, -1):
        second = z @ second + one / math.factorial(order + 2)
    first = z @ second + one
    transitions = z @ first + one
    for _ in range(doublings):
        second = 0.25 * (first @ first + 2.0 * second)
        first = 0.5 * (transitions + one) @ first
        transitions = transitions @ transitions
    late = second[:, :, f:] * h
    early = first[:, :, f:] * h - late
    return transitions, early, late


@dataclass(frozen=True)
class LinkedRows:
    """How the residuals of a run hang on the amplitudes."""

    order: Int  # (l,) int the rows that are near a stamp, by stamps
    edges: Int  # (k + 1,) int where in this order those nearest to each stamp begin, and end
    alone: Int  # (m - l,) int all others
    slopes: Array  # (m, 2f) derivatives of the residuals by amplitudes and rates at that stamp


def linked_rows(nearby: NearbyMotion, t: Array, row_t: Array, by_state: Array) -> LinkedRows:
    """Return which rows hang on which stamp.

    Parameters
    ----------
    t : (k,) array
        Its stamps [s].
    row_t : (m,) array
        When what the rows show was so [s].
    by_state : (m, 2f) array
        Derivatives of the residuals by amplitudes and rates at the rows' own times.
    """
    period = float(np.median(np.diff(t)))
    after = np.clip(np.searchsorted(t, row_t), 1, len(t) - 1)
    nearest = after - (row_t - t[after - 1] < t[after] - row_t)
    apart = row_t - t[nearest]
    # x at the row's time is about (1 + A dt) x at the stamp
    slopes = by_state + apart[:, None] * np.einsum('mi,mij->mj', by_state, nearby.slopes[nearest])
    near = np.flatnonzero(np.abs(apart) <= MOST_APART * period)
    order = near[np.argsort(nearest[near], kind='stable')]
    edges = np.searchsorted(nearest[order], np.arange(len(t) + 1))
    alone = np.setdiff1d(np.arange(len(row_t)), near)
    return LinkedRows(order, edges, alone, np.ascontiguousarray(slopes))


class Innovations:
    """A filter that is fixed: it makes residuals and their derivatives white alike.

    Parameters
    ----------
    deviation : (m,) array
        Of each row's own noise.
    rate_noise : (joints of the robot,) array
        Density of the noise of the joints' rates [rad/s per root of Hz].
    t : (k,) array
        Stamps [s].
    """

    def __init__(
        self, nearby: NearbyMotion, rows: LinkedRows, deviation: Array, rate_noise: Array, t: Array
    ) -> None:
        f = len(nearby.free)
        by_joints = nearby.by_joints * rate_noise
        # white noise v of a rate: with y = x - B v the model is y' = A y + A B v
        shaking = np.concatenate([by_joints, nearby.slopes[:, f:, f:] @ by_joints], axis=1)
        added = shaking @ shaking.transpose(0, 2, 1) * np.diff(t, prepend=t[0])[:, None, None]
        ready(filter_gains, filter_values)
        self._way = nearby.transitions, nearby.starts
        self._linked = rows.edges, rows.order, rows.slopes
        self._alone = rows.alone
        self._gains, self._deviation = np.zeros(rows.slopes.shape), deviation.copy()
        filter_gains(*self._way, added, *self._linked, self._gains, self._deviation)

    def whitened(self, residuals: Array) -> Array:
        """Residuals (m,) or (m, c) as innovations over their standard deviations."""
        found = residuals.reshape(len(residuals), -1).copy()
        found[self._alone] /= self._deviation[self._alone, None]
        filter_values(*self._way, *self._linked, self._gains, self._deviation, found)
        return np.asarray(found.reshape(residuals.shape))
