"""Residual vibration at the end of a joint motion, and its derivatives by the motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from denoc_ros.control.ringing import ringing_modes
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.types import Array


class Driven(NamedTuple):
    """A motion of all coordinates: q, qd (k, n), the joints' accelerations between (k - 1, h)."""

    q: Array
    qd: Array
    qdd_joints: Array


def follow_joints(stepper: Stepper, start: Array, q: Array, qd: Array, between: Array) -> Driven:
    """Motion of all coordinates from `start` (n,) under a motion of the joints.

    Arguments as of :meth:`EndSwing.run`.
    """
    joints, n = stepper.robot.joint_indices, len(start)
    states, rates = np.zeros((2, len(q), n))
    state, rate = start.copy(), np.zeros(n)
    for k in range(len(q)):
        state[joints], rate[joints] = q[k], qd[k]
        states[k], rates[k] = state, rate
        if k < len(between):
            stepper.driven(state, rate, between[k])
    return Driven(states, rates, between)


class EndSwing:
    """The modes that still ring when the joints have arrived.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    start, end : (joints,) arrays
        Postures [rad, m]; the motion begins in static equilibrium.
    step : float
        s of the fixed steps.
    modes : int, optional
        How many, from the lowest; default as :func:`ringing_modes` chooses.

    Attributes
    ----------
    count : int
        Numbers that :meth:`error` has: two for each mode.
    """

    def __init__(
        self, robot: Robot, start: Array, end: Array, step: float, modes: int | None = None
    ) -> None:
        self.robot = robot
        self.step = step
        chosen = len(ringing_modes(robot, end, modes).frequencies)
        self._rest = robot.static_deflection(start)
        self._goal = robot.static_deflection(end)
        natural = robot.natural_modes(self._goal)
        flexible, free = robot.flexible_indices, robot.free_indices
        inertia = robot.inertia_matrix(self._goal)[np.ix_(free, flexible)]
        rigid = len(robot.base_indices)  # these modes are a floating base's, without a frequency
        ringing = slice(rigid, rigid + chosen)
        # of shapes with unit modal mass: amplitudes are these rows times the deflection, wherever
        # a floating base is: its rigid motions have no part in them
        rows = natural.shapes[free, ringing].T @ inertia
        omega = 2.0 * np.pi * natural.frequencies[ringing]
        self._observe = scipy.linalg.block_diag(omega[:, None] * rows, rows)
        self._stepper = Stepper(robot, step)
        self.count = 2 * chosen

    def run(self, q: Array, qd: Array, between: Array) -> Driven:
        """Return the motion of all coordinates, in steps.

        Parameters
        ----------
        q, qd : (k, joints) arrays
            Of the joints, at the ends of steps.
        between : (k - 1, joints) array
            Their accelerations in the middle of steps.
        """
        return follow_joints(self._stepper, self._rest, q, qd, between)

    def error(self, motion: Driven) -> Array:
        """Return the residual vibration (count,): modal amplitudes times omega, modal rates."""
        flexible = self.robot.flexible_indices
        off = (motion.q[-1] - self._goal)[flexible]
        return np.asarray(self._observe @ np.concatenate((off, motion.qd[-1][flexible])))

    def sensitivity(
        self, motion: Driven, qdd: Array, designs: tuple[Array, Array, Array]
    ) -> tuple[Array, Array]:
        """Return how `error` and the joints' torques change with the joints' coefficients.

        Parameters
        ----------
        motion : Driven
        qdd : (k, joints) array
            Accelerations of the joints at the ends of steps.
        designs : three (k, free) arrays
            How positions, rates and accelerations change with a joint's coefficients.

        Returns
        -------
        error : (count, joints * free) array
            Joint by joint.
        torque : (k, joints, joints * free) array

        Notes
        -----
        The linearization along the motion, by exponentials of its matrix in the middle of steps.
        """
        robot = self.robot
        joints, free = robot.joint_indices, robot.free_indices
        of = robot.hybrid_dynamics_derivatives(motion.q, motion.qd, qdd)
        m, k = len(free), len(motion.q)
        system = np.zeros((k, 2 * m, 2 * m))
        system[:, :m, m:] = np.eye(m)
        system[:, m:, :m] = of.dqdd_dq[:, :, free]
        system[:, m:, m:] = of.dqdd_dqd[:, :, free]
        steps = scipy.linalg.expm(0.5 * self.step * (system[1:] + system[:-1]))
        drives = of.dqdd_dq[:, :, joints], of.dqdd_dqd[:, :, joints], of.dqdd_dqdd
        half = 0.5 * self.step * _driven_by(drives, designs)
        states = np.zeros((k, 2 * m, half.shape[2]))
        for node in range(k - 1):
            states[node + 1, :m] = states[node, :m]
            states[node + 1, m:] = states[node, m:] + half[node]
            states[node + 1] = steps[node] @ states[node + 1]
            states[node + 1, m:] += half[node + 1]
        forces = of.dtau_dq[:, :, joints], of.dtau_dqd[:, :, joints], of.dtau_dqdd
        torque = _driven_by(forces, designs)
        torque += of.dtau_dq[:, :, free] @ states[:, :m]
        torque += of.dtau_dqd[:, :, free] @ states[:, m:]
        bends = np.isin(free, robot.flexible_indices)
        return np.asarray(self._observe @ states[-1][np.tile(bends, 2)]), torque


def _driven_by(gains: tuple[Array, Array, Array], designs: tuple[Array, Array, Array]) -> Array:
    """Derivatives by coefficients (k, rows, joints * free), from those by the joints' motion."""
    parts = [
        gain[:, :, :, None] * design[:, None, None, :]
        for gain, design in zip(gains, designs, strict=True)
    ]
    total = parts[0] + parts[1] + parts[2]
    return np.asarray(total.reshape(*total.shape[:2], -1))
