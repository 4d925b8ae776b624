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


class MotionChange(NamedTuple):
    """Derivatives of a motion by p parameters, at the same shares of its duration.

    Attributes
    ----------
    error : (m, p) array
        Of what rings at the end.
    states : (k, 2 free, p) array
        Of the free coordinates and their rates at all steps.
    moments : Moments
        Of all coordinates and of the torques of all joints, where they were asked for.
    """

    error: Array
    states: Array
    moments: Moments


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
        self,
        step: float,
        motion: Driven,
        qdd: Array,
        drives: tuple[Array, ...],
        stretch: Array,
        every: int | None,
    ) -> MotionChange:
        """Return the derivatives of a motion.

        Parameters
        ----------
        step : float
            s.
        motion : Driven
        qdd : (k, joints) array
            Accelerations of the joints at the ends of steps.
        drives : three (k, joints, p) arrays
            How positions, rates and accelerations of the joints change.
        stretch : (p,) array
            By which share steps become longer.
        every : int or None
            Steps between moments; None: none.

        Notes
        -----
        The linearization along the motion, by exponentials of its matrix in the middle of steps.
        """
        robot = self.robot
        joints, free = robot.joint_indices, robot.free_indices
        of = robot.hybrid_dynamics_derivatives(motion.q, motion.qd, qdd)
        _, own = robot.hybrid_dynamics(motion.q, motion.qd, qdd)
        m, k, p = len(free), len(motion.q), len(stretch)
        system = np.zeros((k, 2 * m, 2 * m))
        system[:, :m, m:] = np.eye(m)
        system[:, m:, :m] = of.dqdd_dq[:, :, free]
        system[:, m:, m:] = of.dqdd_dqd[:, :, free]
        steps = scipy.linalg.expm(0.5 * step * (system[1:] + system[:-1]))
        gains = of.dqdd_dq[:, :, joints], of.dqdd_dqd[:, :, joints], of.dqdd_dqdd
        driven = gains[0] @ drives[0] + gains[1] @ drives[1] + gains[2] @ drives[2]
        half = np.zeros((k, 2 * m, p))
        half[:, :m] = motion.qd[:, free, None] * stretch
        half[:, m:] = driven + own[:, :, None] * stretch
        half *= 0.5 * step
        states = np.zeros((k, 2 * m, p))
        for node in range(k - 1):
            states[node + 1] = steps[node] @ (states[node] + half[node]) + half[node + 1]
        bends = np.isin(free, robot.flexible_indices)
        error = np.asarray(self._observe @ states[-1][np.tile(bends, 2)])
        at = slice(None, None, every) if every else slice(0, 0)
        moved = [np.zeros((len(motion.q[at]), robot.n, p)) for _ in range(3)]
        for change, drive in zip(moved, drives, strict=True):
            change[:, joints] = drive[at]
        place, rate = states[at, :m], states[at, m:]
        moved[0][:, free], moved[1][:, free] = place, rate
        moved[2][:, free] = driven[at]
        moved[2][:, free] += of.dqdd_dq[at][:, :, free] @ place
        moved[2][:, free] += of.dqdd_dqd[at][:, :, free] @ rate
        torque = of.dtau_dq[at] @ moved[0] + of.dtau_dqd[at] @ moved[1]
        torque += of.dtau_dqdd[at] @ moved[2][:, joints]
        return MotionChange(error, states, Moments(moved[0], moved[1], moved[2], torque))
