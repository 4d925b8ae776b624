"""Fixed steps of the real-time side, along a motion too, and with feedback taken implicitly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics.constrained_dynamics import raise_status
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.state_rows import run_rows
from denoc_ros.errors import ModelError, StateError
from denoc_ros.kernels.constraints.closing import advance_tied
from denoc_ros.kernels.constraints.constrained import constrained_dynamics_rows
from denoc_ros.kernels.dynamics.articulated import articulated_dynamics
from denoc_ros.kernels.dynamics.driven_step import advance_driven, driven_torque, take_measurement
from denoc_ros.kernels.dynamics.step import ALONG_ROWS, STEP_ROWS, advance_along
from denoc_ros.kernels.jit.compiled import entry, ready
from denoc_ros.kernels.jit.handle import DAMPING, GOOD, MISFIT, NOT_FINITE, STIFFNESS
from denoc_ros.types import Array

# steps of robots without constraints
DRIVEN_KERNELS = (advance_driven, driven_torque, take_measurement)


class Stepper:
    """Advances a robot's state by a fixed step; allocates nothing per call.

    A Rosenbrock W-method of order 2, linearly implicit in elasticity, damping and friction, so a
    mode faster than the step stays stable (see :mod:`denoc_ros.kernels.dynamics.step`). Loops stay
    closed and mimic joints on their leaders: every state it leaves obeys them to rounding.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    step : float [s]
    driven : joint names, optional
        Those whose accelerations :meth:`driven` and :meth:`accelerations` take, in this order;
        default all. In a robot with loops the other joints follow.
    """

    def __init__(self, robot: Robot, step: float, driven: Sequence[str] | None = None) -> None:
        if not (np.isfinite(step) and step > 0.0):
            raise StateError(f'step must be > 0 s, got {step}')
        self.robot = robot
        self.step = float(step)
        self._tied = bool(robot.constraint_names)
        self._steps = np.zeros((STEP_ROWS, robot.n))
        self._zero, self._given, self._torque = np.zeros((3, robot.n))
        self._multipliers = np.zeros(len(robot.constraint_names))
        self._driven = robot.indices(robot.joint_names if driven is None else driven)
        self._held = robot.held(self._driven)
        self._armature = robot.armature.copy()
        self._places = self._driven.astype(np.float64)
        self._room = np.zeros((3, robot.n))
        self._unmoved, self._nowhere = np.zeros(len(self._driven)), np.zeros(0)
        if not self._tied:
            ready(*DRIVEN_KERNELS)
            self._drive, self._torques, self._measurement = map(entry, DRIVEN_KERNELS)

    @property
    def tied(self) -> bool:
        """Whether the robot has loops or mimic joints: then no step is free of constraints."""
        return self._tied

    def free(self, q: Array, qd: Array, tau: Array) -> None:
        """Advance q and qd (n,) in place under generalized forces tau (n,), held over the step.

        Mimic joints are placed by their leaders, whatever q and qd say of them.

        Raises
        ------
        StateError
            A number is not finite; q and qd are then as they were.
        SolverError
            The inertia is not positive definite; a loop is not closed before the step, or cannot
            be kept closed in it.
        """
        if self._tied:
            self._advance_tied(self._zero, q, qd, self._zero, tau)
            return
        none = self._nowhere
        status = self._drive(
            self.robot.handle, self._steps, self._zero, none, none, none, tau, self._given,
            q, qd, q, qd, self.step, 1,
        )  # fmt: skip
        if status != GOOD:
            raise_step_status(self.robot, status, q, qd, tau)

    def driven(self, q: Array, qd: Array, qdd_driven: Array, tau: Array | None = None) -> None:
        """Advance q and qd (n,) in place with the driven joints' accelerations (driven,) given.

        These joints move with constant acceleration over the step, all else by its dynamics, under
        generalized forces tau (n,) if given, of which those of driven joints do not matter.
        """
        if self._tied:
            self._given[self._driven] = qdd_driven
            force = self._zero if tau is None else tau
            self._advance_tied(self._held, q, qd, self._given, force)
        else:
            self.drive(q, qd, qdd_driven, self._unmoved, self.step, 1, tau)

    def drive(
        self,
        q: Array,
        qd: Array,
        first: Array,
        change: Array,
        duration: float,
        count: int,
        tau: Array | None = None,
        start: tuple[Array, Array] | None = None,
    ) -> None:
        """Advance q and qd (n,) in place by several steps as :meth:`driven` does by one.

        Parameters
        ----------
        q, qd : (n,) arrays
        first, change : (driven,) arrays
            Accelerations of the driven joints at the beginning, and by how much these change to
            the end; each step has that of its middle.
        duration : float
            Of all steps together [s].
        count : int
            Steps.
        tau : (n,) array, optional
            As of :meth:`driven`.
        start : pair of (n,) arrays, optional
            State to begin from, instead of what is in q and qd.
        """
        q_before, qd_before = start or (q, qd)
        if self._tied:
            q[:], qd[:] = q_before, qd_before
            self.step = duration / count
            for k in range(count):
                self.driven(q, qd, first + (k + 0.5) / count * change, tau)
            return
        force = self._zero if tau is None else tau
        before = self.robot.handle, self._steps, self._held, self._places
        after = force, self._given, q_before, qd_before, q, qd, duration, count
        status = self._drive(*before, first, change, *after)
        if status == MISFIT:  # lists, say, or views
            status = self._drive(*before, *as_rows(first, change), *after)
        if status != GOOD:
            raise_step_status(self.robot, status, q, qd, force)

    def torque(
        self,
        motion: tuple[Array, Array, Array],
        q: Array,
        qd: Array,
        qdd: Array,
        out: Array,
        first: Array | None = None,
        duration: float = 0.0,
        count: int = 0,
    ) -> None:
        """Write the torque (driven,) of a motion of the driven joints, and all accelerations.

        Before that, advance to the motion by several steps, as :meth:`drive` does.

        Not for robots with constraints.

        Parameters
        ----------
        motion : three (driven,) arrays
            Positions, rates and accelerations.
        q, qd, qdd : (n,) arrays
            State and accelerations: those of the driven joints are written, and the other
            accelerations.
        out : (driven,) array
            Output [N m or N].
        first : (driven,) array, optional
            Accelerations before the steps; output: those of the motion.
        duration, count : float, int
            Of all steps together [s], and how many there are.

        Raises
        ------
        StateError
            A number is not finite.
        """
        begin = self._unmoved.copy() if first is None else first
        before = self.robot.handle, self._steps, self._held, self._places, begin
        after = self._zero, self._room, q, qd, qdd, out, duration, count
        status = self._torques(*before, *motion, *after)
        if status == MISFIT:  # lists, say, or views
            status = self._torques(*before, *as_rows(*motion), *after)
        if status != GOOD:
            raise_step_status(self.robot, status, q, qd, *motion)

    def measure(
        self, numbers: Array, tracked: Array, measured: tuple[Array, Array], has_rate: bool,
        tau: Array, q: Array, qd: Array,
    ) -> None:  # fmt: skip
        """Bring a tracking filter and the state to a measurement of the driven joints.

        Not for robots with constraints.

        Parameters
        ----------
        numbers, tracked : arrays
            As `numbers` and `state` of
            :func:`denoc_ros.kernels.dynamics.driven_step.take_measurement`.
        measured : pair of (driven,) arrays
            Positions and, if `has_rate`, rates.
        tau, q, qd : (n,) arrays
            Generalized forces, and the state: in place.
        """
        before = self.robot.handle, self._steps, self._held, self._places, numbers, tracked
        after = tau, self._room, q, qd, has_rate
        status = self._measurement(*before, *measured, *after)
        if status == MISFIT:  # lists, say, or views
            status = self._measurement(*before, *as_rows(*measured), *after)
        if status != GOOD:
            raise_step_status(self.robot, status, q, qd, *measured, tau)

    def accelerations(
        self, q: Array, qd: Array, qdd_driven: Array, out: Array, tau: Array | None = None
    ) -> None:
        """Write the accelerations (n,) at a state with those of the driven joints given.

        Generalized forces tau (n,) act, if given, of which those of driven joints do not matter.

        Raises
        ------
        StateError
            A number is not finite.
        """
        self._given[self._driven] = qdd_driven
        robot, given = self.robot, self._given
        force = self._zero if tau is None else tau
        if self._tied:
            rows = self._held, q, qd, given, force, out, self._multipliers
            status = run_rows(robot, constrained_dynamics_rows, 1, *rows)
        else:
            status = articulated_dynamics(
                robot.handle, self._armature, self._held, q, qd, given, force, out,
                self._torque,
            )  # fmt: skip
        raise_step_status(robot, status, q, qd, out)
        out[self._driven] = qdd_driven

    def _advance_tied(self, held: Array, q: Array, qd: Array, given: Array, tau: Array) -> None:
        try:
            status = advance_tied(
                self.robot.handle, self._steps, held, self.step, q, qd, given, tau
            )
        except TypeError:
            status = MISFIT
        raise_step_status(self.robot, status, q, qd, tau)


def as_rows(*rows: Array) -> tuple[Array, ...]:
    """Return vectors as kernels take them: contiguous, of doubles."""
    return tuple(np.array(row, dtype=np.float64) for row in rows)


def raise_step_status(robot: Robot, status: int, *arrays: Array) -> None:
    """Raise the error of a step's status."""
    if status == GOOD:
        return
    if status == MISFIT:
        raise StateError(
            f'states and forces must be float64 arrays of shape ({robot.n},), got '
            + ', '.join(str(np.shape(array)) for array in arrays)
        )
    if status == NOT_FINITE:
        raise StateError('state, acceleration and torque must be finite, got one that is not')
    raise_status(robot, status)


class StepsAlong:
    """Takes the steps of :meth:`Stepper.driven` along a motion of all joints.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    step : float
        Longest step [s]: the steps of an interval are of equal length.

    Raises
    ------
    ModelError
        The robot has loops or mimic joints.
    """

    def __init__(self, robot: Robot, step: float) -> None:
        if robot.constraint_names:
            rule = f'must have no loops or mimic joints here, got {robot.constraint_names}'
            raise ModelError(robot.tree.name, [rule])
        ready(advance_along)
        self.robot, self.step = robot, float(step)
        self._work = np.zeros((ALONG_ROWS, robot.n))
        self._held = robot.held(robot.joint_indices)

    def write(
        self, states: Array, intervals: Array, accelerations: Array, first: int, last: int
    ) -> None:
        """Write the undriven coordinates into rows first .. last - 1 of the states.

        Parameters
        ----------
        states : (2, k, n) array
            Coordinates and rates: joints in all rows, all coordinates in row first - 1.
        intervals : (k,) array
            Of each row from the one before [s].
        accelerations : (2, k, n) array
            Mean of the joints' over each interval, and slope about its middle, 0 elsewhere.

        Raises
        ------
        StateError
            A shape is wrong, a number not finite, or an interval not > 0.
        SolverError
            The inertia is not positive definite.
        """
        status = advance_along(
            self.robot.handle, self._work, self._held, self.step, intervals, accelerations,
            states, first, last,
        )  # fmt: skip
        if status == MISFIT:
            k, n = len(intervals), self.robot.n
            raise StateError(
                f'states and accelerations must have shape {(2, k, n)}, and rows be in 1 .. {k}, '
                f'got {states.shape}, {accelerations.shape} and {first} .. {last}'
            )
        raise_step_status(self.robot, status)


def with_joint_feedback(
    robot: Robot, index: NDArray[np.int64], kp: ArrayLike, kd: ArrayLike
) -> Robot:
    """Return a copy of a robot whose joints also resist by kp q + kd q'.

    Under the generalized force kp q_wanted + kd q'_wanted it is the robot under the feedback
    kp (q_wanted - q) + kd (q'_wanted - q'), which a linearly implicit step then takes without a
    limit on the gains.

    Parameters
    ----------
    index : (k,) int array
        Coordinates of the joints.
    kp, kd : (k,) or scalar
        [N m/rad, N/m] and [N m s/rad, N s/m], >= 0.

    Raises
    ------
    StateError
        A gain is negative or not finite.
    """
    gains = np.array([np.broadcast_to(kp, len(index)), np.broadcast_to(kd, len(index))])
    if not np.isfinite(gains).all() or (gains < 0.0).any():
        raise StateError(f'gains kp, kd must be finite and >= 0, got {gains.tolist()}')
    held = robot.copy()
    diagonals = held.diagonals()
    diagonals[STIFFNESS, index] += gains[0]
    diagonals[DAMPING, index] += gains[1]
    held.arrays = held.arrays.with_diagonals(diagonals)
    # a copy makes its workspace from the arrays
    return held.copy()
