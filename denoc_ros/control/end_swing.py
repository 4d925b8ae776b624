"""Residual vibration at the end of a joint motion, and its derivatives by the motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from denoc_ros.control.limit_rows import Moments
from denoc_ros.control.ringing import ringing_modes
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.types import Array


class Driven(NamedTuple):
    """A motion of all coordinates: q, qd (k, n), the joints' accelerations between (k - 1, h)."""

    q: Array
    qd: Array
    qdd_joints: Array


def middles(motion: Driven, step: float) -> tuple[Array, Array]:
    """Return all coordinates and their rates (k - 1, n) in the middle of a motion's steps [s]."""
    before, after = slice(None, -1), slice(1, None)
    q = 0.5 * (motion.q[before] + motion.q[after])
    q += 0.125 * step * (motion.qd[before] - motion.qd[after])
    qd = 1.5 / step * (motion.q[after] - motion.q[before])
    qd -= 0.25 * (motion.qd[before] + motion.qd[after])
    return q, qd


def moments_change(robot: Robot, at: Moments, drives: tuple[Array, ...], states: Array) -> Moments:
    """Return the derivatives of a motion at moments, with the torques of all joints.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    at : Moments
    drives : three (k, joints, p) arrays
        How positions, rates and accelerations of the joints change.
    states : (k, 2 free, p) array
        How the free coordinates and their rates do.
    """
    joints, free = robot.joint_indices, robot.free_indices
    of = robot.hybrid_dynamics_derivatives(at.q, at.qd, np.ascontiguousarray(at.qdd[:, joints]))
    m, moved = len(free), [np.zeros((*at.q.shape, states.shape[-1])) for _ in range(3)]
    for change, drive in zip(moved, drives, strict=True):
        change[:, joints] = drive
    moved[0][:, free], moved[1][:, free] = states[:, :m], states[:, m:]
    moved[2][:, free] = of.dqdd_dq @ moved[0] + of.dqdd_dqd @ moved[1] + of.dqdd_dqdd @ drives[2]
    torque = of.dtau_dq @ moved[0] + of.dtau_dqd @ moved[1] + of.dtau_dqdd @ drives[2]
    return Moments(moved[0], moved[1], moved[2], torque)


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


def _exponentials(small: Array) -> Array:
    """Return the exponentials of matrices (k, m, m) of steps that resolve the modes (Pade)."""
    even = np.eye(small.shape[-1]) + small @ small / 12.0
    return np.asarray(np.linalg.solve(even - 0.5 * small, even + 0.5 * small))


class EndSwing:
    """The modes that still ring when the joints have arrived.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    start, end : (joints,) arrays
        Postures [rad, m]; the motion begins in static equilibrium.
    modes : int, optional
        How many, from the lowest; default as :func:`ringing_modes` chooses.

    Attributes
    ----------
    count : int
        Numbers that :meth:`error` has: two for each mode.
    """

    def __init__(self, robot: Robot, start: Array, end: Array, modes: int | None = None) -> None:
        self.robot = robot
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
        self._stepper = Stepper(robot, 1.0)
        self.count = 2 * chosen

    def run(self, step: float, q: Array, qd: Array, between: Array) -> Driven:
        """Return the motion of all coordinates, in steps.

        Parameters
        ----------
        step : float
            s.
        q, qd : (k, joints) arrays
            Of the joints, at the ends of steps.
        between : (k - 1, joints) array
            Their accelerations in the middle of steps.
        """
        self._stepper.step = step
        return follow_joints(self._stepper, self._rest, q, qd, between)

    def error(self, motion: Driven) -> Array:
        """Return the residual vibration (count,): modal amplitudes times omega, modal rates."""
        flexible = self.robot.flexible_indices
        off = (motion.q[-1] - self._goal)[flexible]
        return np.asarray(self._observe @ np.concatenate((off, motion.qd[-1][flexible])))

    def change(
        self, step: float, motion: Driven, drives: tuple[Array, ...]
    ) -> tuple[Array, Array]:
        """Return the derivatives of the residual vibration and of a motion by p parameters.

        Of the error (count, p), and of the free coordinates and their rates at the ends of steps
        (k, 2 free, p).

        Parameters
        ----------
        step : float
            s.
        motion : Driven
        drives : three (k - 1, joints, p) arrays
            How positions, rates and accelerations of the joints change in the middle of steps.

        Notes
        -----
        The linearization along the motion, by exponentials of its matrix in the middle of steps.
        """
        robot = self.robot
        joints, free = robot.joint_indices, robot.free_indices
        q, qd = middles(motion, step)
        of = robot.hybrid_dynamics_derivatives(q, qd, motion.qdd_joints)
        m, k, p = len(free), len(q), drives[0].shape[-1]
        system = np.zeros((k, 2 * m, 2 * m))
        system[:, :m, m:] = np.eye(m)
        system[:, m:, :m] = of.dqdd_dq[:, :, free]
        system[:, m:, m:] = of.dqdd_dqd[:, :, free]
        halves = _exponentials(0.5 * step * system)
        gains = of.dqdd_dq[:, :, joints], of.dqdd_dqd[:, :, joints], of.dqdd_dqdd
        pushed = np.zeros((k, 2 * m, p))
        pushed[:, m:] = gains[0] @ drives[0] + gains[1] @ drives[1] + gains[2] @ drives[2]
        pushed *= step
        states = np.zeros((k + 1, 2 * m, p))
        for node, half in enumerate(halves):
            states[node + 1] = half @ (half @ states[node] + pushed[node])
        bends = np.isin(free, robot.flexible_indices)
        return np.asarray(self._observe @ states[-1][np.tile(bends, 2)]), states
