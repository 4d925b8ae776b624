"""Residual vibration at the end of a joint motion, and its derivatives by the motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper, raise_step_status
from denoc_ros.kernels.dynamics.runge_kutta import CONTROLS, END, STEP, TIME, UNTIL, explicit_steps
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.kernels.jit.handle import FRICTION
from denoc_ros.planning.shapers.ringing import ringing_modes
from denoc_ros.planning.timing.limit_rows import Moments
from denoc_ros.types import Array

# Kutta's method of order 4: stages, weights, and no estimate of errors
RUNGE_KUTTA = (
    np.array(
        [[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    ),
    np.array([1.0, 2.0, 2.0, 1.0]) / 6.0,
    np.zeros((2, 5)),
)


class Driven(NamedTuple):
    """A motion of all coordinates: q, qd (k, n), and the joints' drive between (k - 1, h).

    That is their accelerations, or net torques: those without Coulomb friction.
    """

    q: Array
    qd: Array
    between: Array


def middles(motion: Driven, step: float) -> tuple[Array, Array]:
    """Return all coordinates and their rates (k - 1, n) in the middle of a motion's steps [s]."""
    before, after = slice(None, -1), slice(1, None)
    q = 0.5 * (motion.q[before] + motion.q[after])
    q += 0.125 * step * (motion.qd[before] - motion.qd[after])
    qd = 1.5 / step * (motion.q[after] - motion.q[before])
    qd -= 0.25 * (motion.qd[before] + motion.qd[after])
    return q, qd


def moments_change(robot: Robot, at: Moments, drive: Array, states: Array) -> Moments:
    """Return the derivatives of a motion at moments, with the torques of all joints.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    at : Moments
    drive : (k, joints, p) array
        How the accelerations of the joints change.
    states : (k, 2 n, p) array
        How all coordinates and their rates do.
    """
    joints, free = robot.joint_indices, robot.free_indices
    of = robot.hybrid_dynamics_derivatives(at.q, at.qd, np.ascontiguousarray(at.qdd[:, joints]))
    q, qd = np.split(states, 2, axis=1)
    qdd = np.zeros_like(q)
    qdd[:, joints] = drive
    qdd[:, free] = of.dqdd_dq @ q + of.dqdd_dqd @ qd + of.dqdd_dqdd @ drive
    return Moments(q, qd, qdd, of.dtau_dq @ q + of.dtau_dqd @ qd + of.dtau_dqdd @ drive)


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


def without_friction(robot: Robot) -> Robot:
    """Return a copy without Coulomb friction."""
    net = robot.copy()
    diagonals = net.diagonals()
    diagonals[FRICTION] = 0.0
    net.set_diagonals(diagonals)
    return net


def free_motion(robot: Robot, posture: Array) -> tuple[float, float]:
    """Return the fastest frequency [Hz] and growth [1/s] at rest, with constant joint torques."""
    net, n = without_friction(robot), robot.n
    rest = net.static_deflection(posture)
    still = np.zeros(n)
    by_q, by_qd, _ = net.forward_dynamics_derivatives(
        rest, still, net.inverse_dynamics(rest, still, still)
    )
    values = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [by_q, by_qd]]))
    return float(np.abs(values.imag).max()) / (2.0 * np.pi), float(values.real.max())


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
    by_torque : bool
        Whether net torques drive the joints, which may then not have arrived; else accelerations.

    Attributes
    ----------
    net : Robot
        The robot without Coulomb friction.
    """

    def __init__(
        self,
        robot: Robot,
        start: Array,
        end: Array,
        modes: int | None = None,
        by_torque: bool = False,
    ) -> None:
        self.robot, self.net = robot, without_friction(robot) if by_torque else robot
        chosen = len(ringing_modes(robot, end, modes).frequencies)
        self._rest = robot.static_deflection(start)
        self._goal = robot.static_deflection(end)
        natural = robot.natural_modes(self._goal)
        flexible, free = robot.flexible_indices, robot.free_indices
        inertia = robot.inertia_matrix(self._goal)
        rigid = len(robot.base_indices)  # these modes are a floating base's, without a frequency
        ringing = slice(rigid, rigid + chosen)
        # of shapes with unit modal mass: amplitudes are these rows times the deflection, wherever
        # a floating base is: its rigid motions have no part in them
        rows = np.zeros((chosen, robot.n))
        rows[:, flexible] = natural.shapes[free, ringing].T @ inertia[np.ix_(free, flexible)]
        omega = 2.0 * np.pi * natural.frequencies[ringing]
        if by_torque:  # the joints come to rest as one more mode each
            joints = np.eye(robot.n)[robot.joint_indices]
            rows = np.vstack([rows, np.sqrt(np.diag(inertia)) * joints])
            omega = np.append(omega, np.full(len(joints), omega[0]))
        self._observe = scipy.linalg.block_diag(omega[:, None] * rows, rows)
        self._stepper = Stepper(robot, 1.0)
        if by_torque:
            ready(explicit_steps)

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

    def run_by_torque(self, step: float, between: Array) -> Driven:
        """Return the motion under net torques (k - 1, joints) in the middle of steps [s]."""
        net, n = self.net, self.net.n
        forces = np.zeros((len(between), n))
        forces[:, net.joint_indices] = between
        states, stages, room = (
            np.zeros((len(between) + 1, 2 * n)),
            np.zeros((5, 2 * n)),
            np.zeros(2 * n),
        )
        states[0, :n] = self._rest
        control = np.ones(CONTROLS)
        for before, after, force in zip(states[:-1], states[1:], forces, strict=True):
            control[[TIME, STEP, UNTIL, END]] = 0.0, step, step, step
            stages[-1, :n] = before[n:]
            net.forward_dynamics(before[:n], before[n:], force, out=stages[-1, n:])
            after[:] = before
            status = explicit_steps(
                net.handle, *RUNGE_KUTTA, control, force, after, room.copy(), stages, room
            )
            raise_step_status(net, status, after, force)
        return Driven(
            np.ascontiguousarray(states[:, :n]), np.ascontiguousarray(states[:, n:]), between
        )

    def after(self, step: float, motion: Driven) -> Array:
        """Return the states (k - 1, 2 n) a step [s] after those of a motion under net torques."""
        net, n = self.net, self.net.n
        forces = np.zeros((len(motion.between), n))
        forces[:, net.joint_indices] = motion.between
        before = np.hstack([motion.q, motion.qd])[:-1]

        def slope(state: Array) -> Array:
            q, qd = (np.ascontiguousarray(each) for each in np.split(state, 2, axis=1))
            return np.hstack([qd, net.forward_dynamics(q, qd, forces)])

        first = slope(before)
        second = slope(before + 0.5 * step * first)
        third = slope(before + 0.5 * step * second)
        last = slope(before + step * third)
        return np.asarray(before + step / 6.0 * (first + 2.0 * second + 2.0 * third + last))

    def gaps(self, step: float, motion: Driven) -> Array:
        """Return how far each step [s] under net torques ends from the next state (k - 1, 2 n)."""
        return self.after(step, motion) - np.hstack([motion.q, motion.qd])[1:]

    def error(self, motion: Driven) -> Array:
        """Return the residual swing (m,): modal amplitudes times omega, modal rates."""
        return self.seen(np.concatenate((motion.q[-1] - self._goal, motion.qd[-1])))

    def seen(self, change: Array) -> Array:
        """Return the swing (..., m) after changes (..., 2 n) of coordinates and rates."""
        return np.asarray(change @ self._observe.T)

    def change(
        self, step: float, motion: Driven, drives: tuple[Array, ...]
    ) -> tuple[Array, Array, Array]:
        """Return the derivatives of the residual vibration and of a motion by p parameters.

        Of the error (m, p), of all coordinates and their rates at the ends of steps (k, 2 n, p),
        and how each step passes on a change of those that move (k - 1, 2 moved, 2 moved); joints
        that are driven by accelerations are not among them.

        Parameters
        ----------
        step : float
            s.
        motion : Driven
        drives : one or three (k - 1, joints, p) arrays
            How net torques, or positions, rates and accelerations of the joints change in the
            middle of steps.

        Notes
        -----
        The linearization along the motion, by exponentials of its matrix in the middle of steps.
        """
        robot = self.robot
        joints, n = robot.joint_indices, robot.n
        q, qd = middles(motion, step)
        if len(drives) == 1:
            free, force = np.arange(n), np.zeros_like(q)
            force[:, joints] = motion.between
            by_q, by_qd, by_force = self.net.forward_dynamics_derivatives(q, qd, force)
            gained = by_force[:, :, joints] @ drives[0]
        else:
            free = robot.free_indices
            of = robot.hybrid_dynamics_derivatives(q, qd, motion.between)
            by_q, by_qd = of.dqdd_dq[:, :, free], of.dqdd_dqd[:, :, free]
            gains = of.dqdd_dq[:, :, joints], of.dqdd_dqd[:, :, joints], of.dqdd_dqdd
            gained = gains[0] @ drives[0] + gains[1] @ drives[1] + gains[2] @ drives[2]
        m, k, p = len(free), len(q), gained.shape[-1]
        system = np.zeros((k, 2 * m, 2 * m))
        system[:, :m, m:] = np.eye(m)
        system[:, m:, :m], system[:, m:, m:] = by_q, by_qd
        halves = _exponentials(0.5 * step * system)
        passed = halves @ halves
        pushed = step * halves[:, :, m:] @ gained
        moved = np.concatenate((free, n + free))
        states = np.zeros((k + 1, 2 * n, p))
        here = states[0, moved]
        for node in range(k):
            here = passed[node] @ here + pushed[node]
            states[node + 1, moved] = here
        return np.asarray(self._observe @ states[-1]), states, passed


def closing(passed: Array, gaps: Array) -> Array:
    """Return the change of a motion (k, 2 n) that closes the gaps after its steps."""
    states = np.zeros((len(gaps) + 1, gaps.shape[1]))
    for node, gap in enumerate(gaps):
        states[node + 1] = passed[node] @ states[node] + gap
    return states
