"""Damping of vibration by the joints: torque from the rate of the strain behind each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.base.floating_base import require_known_base
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.structure import sensor_rows
from denoc_ros.errors import StateError
from denoc_ros.kernels.jit.handle import DAMPING, STIFFNESS
from denoc_ros.types import Array

POSTURES = 16  # at which dissipation is shown, the zero posture among them
SEED = 1
SHORTEST = 1e-5  # s, of a delay
NOTHING = 1e-3  # share of what damping takes from a mode that it may be fed
ROUNDING = 1e-9  # share of a mode's energy per radian that counts as no power


class StrainDamping:
    """Torque -gain d(strain)/dt at joints whose link has a strain gauge; limited.

    Parameters
    ----------
    joints : sequence of str
        Driven joints, in the order of all arrays here.
    gains : (joints,)
        [N m or N per value of the gauge per s]; 0: none at this joint.
    limits : (joints,)
        Largest torque [N m, N].
    bandwidth : float
        Of the filter that makes the rate [Hz].
    delay : float
        From a gauge's value to the torque at the joint [s].

    Attributes
    ----------
    places : (k,) int array
        Which of the robot's sensors are read: per joint with a gain, the gauge on its link that
        answers most to torque there.

    Raises
    ------
    StateError
        A gain is negative or has no gauge; or the torque does not dissipate (see Notes).

    Notes
    -----
    With y = R q the strains, S the places of the joints and s the sign of each strain's answer to
    torque at its joint in the undeformed zero posture, and the delay T by its Pade approximant,

        M q'' + C q' + K q = -S G s (2 x - r),  r = w (y - f),  f' = r,  x' = (r - x) 2 / T.

    In every mode of this closed loop, elasticity K and damping C as they are, at 16 postures
    within the joints' limits, the torque must take power: Re(q'_j* tau_j) <= 0, but for a
    thousandth of what damping takes. The filter and the delay are counted in. Free joints without
    inertia of their own (armature) rarely pass: there is no moment at their links' roots.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        gains: ArrayLike,
        limits: ArrayLike,
        bandwidth: float,
        delay: float = 0.0,
    ) -> None:
        require_known_base(robot, 'strain feedback')
        given = np.asarray(gains, dtype=np.float64)
        if given.shape != (len(joints),) or not (np.isfinite(given) & (given >= 0.0)).all():
            raise StateError(
                f'strain damping: gains must be {len(joints)} finite numbers >= 0, '
                f'got {given.tolist()}'
            )
        if not (bandwidth > 0.0 and delay >= 0.0):
            raise StateError(
                f'strain damping: bandwidth must be > 0 Hz and delay >= 0 s, '
                f'got {bandwidth} and {delay}'
            )
        self._used = np.flatnonzero(given).tolist()
        self._coordinates = np.array(
            [robot.joint_indices[robot.joint_names.index(joints[k])] for k in self._used],
            dtype=np.intp,
        )
        found = [_gauge(robot, joints[k]) for k in self._used]
        self.places = np.array([place for place, _, _ in found], dtype=np.intp)
        self._rows = np.array([row for _, row, _ in found]).reshape(-1, robot.n)
        self._rate = 2.0 * np.pi * bandwidth
        self._delay = max(delay, SHORTEST)
        self._slowest = float(robot.natural_frequencies(np.zeros(robot.n)).min(initial=np.inf))
        self._gains = given[self._used] * [sign for _, _, sign in found]
        self._limits = np.asarray(limits, dtype=np.float64)[self._used]
        self._filtered = np.full(len(self._used), np.nan)
        self._torque = np.zeros(len(joints))
        self._require_dissipation(robot)

    def reset(self) -> None:
        """Forget the strains."""
        self._filtered[:] = np.nan

    def torque(self, values: Array, elapsed: float) -> Array:
        """Return the torque (joints,) for the gauges' values (k,); the same array each time.

        Parameters
        ----------
        values : (k,) array
            Calibrated, in the order of `places`; NaN where there is none: no torque then.
        elapsed : float
            Since the last call [s].
        """
        filtered = self._filtered
        fresh = np.isnan(filtered) | np.isnan(values)
        filtered[fresh] = values[fresh]
        change = values - filtered
        filtered -= np.expm1(-self._rate * elapsed) * change
        torque = -self._gains * self._rate * change
        torque[np.isnan(torque)] = 0.0
        self._torque[self._used] = np.clip(torque, -self._limits, self._limits)
        return self._torque

    def closed_loop(self, robot: Robot, q: Array) -> Array:
        """Return A (2 n + 2 k, 2 n + 2 k) of [q, q', f, x]' = A [q, q', f, x] at coordinates q."""
        n, k = robot.n, len(self._used)
        diagonals = robot.arrays.diagonals
        mobility = np.linalg.inv(robot.inertia_matrix(q))
        bent = mobility @ self._force(n)
        rate, late = self._rate, 2.0 / self._delay
        system = np.zeros((2 * n + 2 * k, 2 * n + 2 * k))
        system[:n, n : 2 * n] = np.eye(n)
        system[n : 2 * n] = bent @ self._law()
        system[n : 2 * n, :n] -= mobility * diagonals[STIFFNESS]
        system[n : 2 * n, n : 2 * n] -= mobility * diagonals[DAMPING]
        system[2 * n : 2 * n + k, :n] = rate * self._rows
        system[2 * n : 2 * n + k, 2 * n : 2 * n + k] = -rate * np.eye(k)
        system[2 * n + k :, :n] = late * rate * self._rows
        system[2 * n + k :, 2 * n : 2 * n + k] = -late * rate * np.eye(k)
        system[2 * n + k :, 2 * n + k :] = -late * np.eye(k)
        return system

    def _force(self, n: int) -> Array:
        """Return the generalized forces (n, k) of unit torques."""
        force = np.zeros((n, len(self._used)))
        force[self._coordinates, np.arange(len(self._used))] = 1.0
        return force

    def _law(self) -> Array:
        """Return the torques (k, 2 n + 2 k) by the closed loop's state."""
        gains = np.diag(self._gains)
        law = (gains * self._rate) @ np.hstack((self._rows, np.zeros_like(self._rows)))
        return np.hstack((law, -gains * self._rate, -2.0 * gains))

    def _require_dissipation(self, robot: Robot) -> None:
        if not len(self._used):
            return
        for q in _postures(robot):
            power, frequency = self._largest_power(robot, q)
            if power > ROUNDING:
                posture = np.round(q[robot.joint_indices], 3).tolist()
                raise StateError(
                    'strain damping: torque must take power from every mode, got one at '
                    f'{frequency:.3g} Hz that gains {power:.2g} of its energy per radian, joints '
                    f'at {posture}; a higher bandwidth, a smaller gain or delay, or 0 for this '
                    'joint may help'
                )

    def _largest_power(self, robot: Robot, q: Array) -> tuple[float, float]:
        """Return the most that a mode is fed, as a share per radian, and its frequency [Hz]."""
        n = robot.n
        values, vectors = np.linalg.eig(self.closed_loop(robot, q))
        position, rate = vectors[:n], vectors[n : 2 * n]
        torque = self._force(n) @ (self._law() @ vectors)
        fed = np.real(np.sum(np.conj(rate) * torque, axis=0))
        taken = robot.damping @ np.abs(rate) ** 2
        kinetic = np.real(np.sum(np.conj(rate) * (robot.inertia_matrix(q) @ rate), axis=0))
        elastic = robot.stiffness @ np.abs(position) ** 2
        energy = kinetic + elastic
        speed = np.maximum(np.abs(values), 2.0 * np.pi * self._slowest)
        # joints at rest anywhere are no vibration: rounding is all the energy they have
        vibrates = energy > 1e-12 * energy.max()
        fed -= NOTHING * taken
        share = np.divide(fed, energy * speed, out=np.zeros_like(fed), where=vibrates)
        worst = int(np.argmax(share))
        return float(share[worst]), float(np.abs(values[worst]) / (2.0 * np.pi))


def _gauge(robot: Robot, joint: str) -> tuple[int, Array, float]:
    """Return the gauge behind a joint that answers most to torque there.

    Its place among the sensors, its row (n,), and the sign of its answer.
    """
    inertia = robot.inertia_matrix(np.zeros(robot.n))
    unit = np.zeros(robot.n)
    unit[robot.joint_indices[robot.joint_names.index(joint)]] = 1.0
    answer = np.linalg.solve(inertia, unit)
    links = [b.name for b in robot.tree.bodies if b.joint is not None and b.joint.name == joint]
    found = []
    for place, (sensor, row) in enumerate(
        zip(robot.tree.sensors, sensor_rows(robot), strict=True)
    ):
        if sensor.quantity == 'strain' and sensor.link in links and sensor.topic:
            found.append((place, row, float(row @ answer)))
    if not any(strain for *_, strain in found):
        raise StateError(
            f'strain damping: joint {joint!r} must have a strain gauge with a topic on the link '
            'it moves that responds to its torque, got none'
        )
    place, row, strain = max(found, key=lambda one: abs(one[2]))
    return place, row, float(np.sign(strain))


def _postures(robot: Robot) -> list[Array]:
    """Return coordinates (n,), undeformed: zero, and some within the joints' limits."""
    limits = [robot.tree.joints[name].limits for name in robot.joint_names]
    lower = np.array([max(limit.lower, -np.pi) for limit in limits])
    upper = np.array([min(limit.upper, np.pi) for limit in limits])
    drawn = np.random.default_rng(SEED).uniform(lower, upper, (POSTURES - 1, len(limits)))
    postures = []
    for row in (np.zeros(len(limits)), *drawn):
        q = np.zeros(robot.n)
        q[robot.joint_indices] = row
        postures.append(q)
    return postures
