"""First-order equations of a robot's motion, for an integrator: which coordinates are free.

The coordinates are affine in independent ones, q = T z + c: T ties mimic joints to their
leaders (the identity where there are none). Of z some are prescribed in time, the rest free.
With loops q is what is integrated, under the multipliers' forces, and each state is put back onto
the loops (and mimic joints on their leaders) by a projection, which removes the closure error of
a step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.dynamics import constrained_dynamics as constraints
from denoc_ros.dynamics.assembling import close_nearby
from denoc_ros.dynamics.base.base_motion import Base
from denoc_ros.dynamics.base.floating_base import ATTITUDE, wrap_attitude
from denoc_ros.dynamics.constrained_dynamics import RANK
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError, SolverError, StateError
from denoc_ros.kernels.constraints.closing import CLOSED
from denoc_ros.types import Array

Int = NDArray[np.int_]

CORRECTIONS = 6  # each one squares what a step left, 1e-6 at most
Torque = Callable[[float, Array, Array], Array]
Prescribed = Mapping[str, Callable[[float], tuple[float, float, float]]]
# A start this far from the motion prescribed at that time is a mistake, not rounding.
START_TOLERANCE = 1e-6
WRAP = 4.0  # rad: a rotation vector this long is brought back; at 2 pi its rates are singular


class ConstraintProjection:
    """Projects states of a robot onto its loops and mimic joints.

    The change is the smallest in the metric of the inertia matrix: it does no more to a light
    coordinate's motion than to a heavy one's, and a projection of rates takes away just the
    kinetic energy of what opens the loops.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    free : (f,) array of int
        The coordinates that may be moved; the others are prescribed.
    """

    def __init__(self, robot: Robot, free: Int) -> None:
        self._robot = robot
        self._free = free

    def positions(self, q: Array) -> None:
        """Close q (n,) in place.

        Raises
        ------
        SolverError
            It does not close from there.
        """
        left = close_nearby(
            self._robot, q, self._free, lambda error, rows: self._change(q, error, rows),
            CLOSED, CORRECTIONS,
        )  # fmt: skip
        if left > CLOSED:
            raise SolverError(
                f'simulate: the loops must close, got an error of {left:.3g} m or rad after '
                f'{CORRECTIONS} corrections; a singular configuration, or too long a step'
            )

    def rates(self, q: Array, qd: Array) -> None:
        """Make qd (n,) keep the loops closed at q, in place."""
        rows = self._robot.closure_jacobian(q)
        qd[self._free] -= self._change(q, rows @ qd, rows[:, self._free])

    def _change(self, q: Array, error: Array, rows: Array) -> Array:
        """Return I^-1 J^T (J I^-1 J^T)^+ error of the free coordinates, (f,)."""
        free = self._free
        inertia = self._robot.inertia_matrix(q)[np.ix_(free, free)]
        spread = scipy.linalg.cho_solve(scipy.linalg.cho_factor(inertia), rows.T)
        share = np.linalg.lstsq(rows @ spread, error, rcond=RANK**2)[0]
        return np.asarray(spread @ share)


class EquationsOfMotion:
    """The equations of a robot under torques, some joints prescribed.

    Parameters
    ----------
    robot : Robot
        The robot; the motion works on a copy with its own workspace.
    torque : callable, optional
        `(t, q, qd) -> (n,)` generalized forces [N m, N]; none: zero.
    prescribed : mapping of str to callable, optional
        Joint name to `t -> (q, qd, qdd)`.
    base : (twist, acceleration[, pose]) or callable of time, optional
        The motion of the base; default as the robot's is now.

    Attributes
    ----------
    free : (f,) array of int
        The coordinates that are integrated.
    attitude : (3,) array of int
        Where the rotation vector of a floating base stands among the free; (0,) of a fixed one.
    evaluations : int
        How often accelerations were worked out.

    Raises
    ------
    StateError
        If a prescribed joint is unknown or mimics another.
    """

    def __init__(
        self,
        robot: Robot,
        torque: Torque | None = None,
        prescribed: Prescribed | None = None,
        base: Base | Callable[[float], Base] | None = None,
    ) -> None:
        self._robot = robot.copy()
        self._base = base if callable(base) else None
        if base is not None and not callable(base):
            self._robot.move_base(base)
        self._torque = torque
        # with loops, positions of mimic joints are closed as theirs are
        self._leaders = {} if robot.tree.loops else robot.tree.mimics
        names = dict(zip(robot.joint_names, np.asarray(robot.joint_indices).tolist(), strict=True))
        given = dict(prescribed or {})
        self._check_names(given, names)
        self._given_names = [name for name in robot.joint_names if name in given]
        self._given = np.array([names[name] for name in self._given_names], dtype=np.intp)
        self._laws = [given[name] for name in self._given_names]
        self._held = self._robot.held(self._given)
        self._followers = np.array([names[name] for name in self._leaders], dtype=np.intp)
        mimics = self._leaders.values()
        self._followed = np.array([names[mimic.leader] for mimic in mimics], dtype=np.intp)
        self._ratios = np.array([mimic.multiplier for mimic in mimics])
        self._offsets = np.array([mimic.offset for mimic in mimics])
        held = {*self._given.tolist(), *self._followers.tolist()}
        self.free = np.array([i for i in range(robot.n) if i not in held], dtype=np.intp)
        self.attitude = np.searchsorted(self.free, robot.base_indices[ATTITUDE])
        self.q, self.qd, self.qdd = (np.zeros(robot.n) for _ in range(3))
        self.tau = np.zeros(robot.n)
        self.evaluations = 0
        self._closing = ConstraintProjection(self._robot, self.free) if robot.tree.loops else None

    @property
    def handle(self) -> int:
        """The model as kernels take it."""
        return int(self._robot.handle)

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self._robot.coordinate_names

    def energy(self) -> Array:
        """Return kinetic and potential energy (2,) [J] at the last state worked out."""
        return self._robot.energy(self.q, self.qd, check=False)

    def wrapped(self, state: Array) -> Array | None:
        """Return the same state (2 f,) with its rotation vector within pi; None: it is short."""
        if not np.linalg.norm(state[self.attitude]) > WRAP:
            return None
        state, phi, rate = state.copy(), self.attitude, self.attitude + len(self.free)
        state[phi], state[rate] = wrap_attitude(state[phi], state[rate])
        return state

    def wrapped_state(self) -> tuple[Array, Array]:
        """Return q and qd (n,) of the last state worked out, its rotation vector within pi."""
        if not len(self.attitude):
            return self.q, self.qd
        return self._robot.wrap_base(self.q, self.qd)

    @property
    def is_free(self) -> bool:
        """Whether compiled steps can take the motion: no forces but the model's own.

        The way back onto loops uses factors that have no rows for axes with damping or friction.
        """
        loops = self._robot.tree.loops
        return (
            self._torque is None
            and self._base is None
            and not self._laws
            and not self._leaders
            and not any(loop.damping > 0.0 or loop.friction > 0.0 for loop in loops)
            and type(self._robot) is Robot
        )

    @property
    def has_loops(self) -> bool:
        """Whether states must be closed after each step."""
        return self._closing is not None

    def _check_names(self, given: Mapping[str, object], names: Mapping[str, int]) -> None:
        for name in given:
            if name not in names:
                raise StateError(
                    f'simulate: prescribed joint must be one of {", ".join(names)}, got {name!r}'
                )
            if name in self._leaders:
                raise StateError(
                    f'simulate: prescribed joint must not mimic another, got {name!r} '
                    f'(prescribe its leader {self._leaders[name].leader!r})'
                )

    def start(self, q0: Array, qd0: Array, t: float) -> Array:
        """State of the integrator at the start; it must agree with the prescribed motion.

        Parameters
        ----------
        q0, qd0 : (n,) arrays
            The whole state.
        t : float
            Time [s].

        Returns
        -------
        (2 f,) array
            Free coordinates, then their rates.

        Raises
        ------
        StateError
            If a prescribed or mimic joint starts elsewhere, or a loop is open.
        """
        state = self.close(t, np.concatenate([q0[self.free], qd0[self.free]]))
        self.complete(t, state)
        for index, name in enumerate(self._robot.coordinate_names):
            for what, got, must in (
                ('position', q0[index], self.q[index]),
                ('rate', qd0[index], self.qd[index]),
            ):
                if abs(got - must) > START_TOLERANCE * (1.0 + abs(must)):
                    raise StateError(
                        f'simulate: {what} of {name!r} at the start must be {must:.9g} as '
                        f'prescribed or constrained, got {got:.9g}'
                    )
        return state

    def close(self, t: float, state: Array) -> Array:
        """Return a state (2 f,) put back onto the loops at a time [s]; as it is without loops.

        Raises
        ------
        SolverError
            It does not close.
        """
        if self._closing is None:
            return state
        self.complete(t, state)
        self._closing.positions(self.q)
        self._closing.rates(self.q, self.qd)
        return np.concatenate([self.q[self.free], self.qd[self.free]])

    def complete(self, t: float, state: Array) -> None:
        """Fill `q`, `qd` and the prescribed `qdd` at a time [s] and state (2 f,)."""
        count = len(self.free)
        self.q[self.free] = state[:count]
        self.qd[self.free] = state[count:]
        for index, law in zip(self._given, self._laws, strict=True):
            self.q[index], self.qd[index], self.qdd[index] = law(t)
        if self._leaders:
            self.q[self._followers] = self._ratios * self.q[self._followed] + self._offsets
            self.qd[self._followers] = self._ratios * self.qd[self._followed]

    def accelerate(self, t: float, state: Array) -> None:
        """Work out `qdd` and `tau` (n,) at a time [s] and an integrator's state (2 f,)."""
        self._apply(t, state)
        if self._laws:
            torque, qdd, _ = constraints.hybrid(self._robot, True, self._held, *self._driven())
            self.qdd[:] = qdd[0]
            self.tau[self._given] = torque[0, self._given]
        else:
            self._accelerate()

    def _apply(self, t: float, state: Array) -> None:
        """Fill the state, the base's motion and the forces at a time [s] and state (2 f,)."""
        self.complete(t, state)
        if self._base is not None:
            self._robot.move_base(self._base(t))
        if self._torque is None:
            self.tau[:] = 0.0
        else:
            self.tau[:] = checked_vector(
                self._torque(t, self.q, self.qd), self._robot.n, 'torque', t
            )
        self.evaluations += 1

    def _driven(self) -> tuple[Array, Array, Array, Array]:
        """Return q, qd, the prescribed accelerations and the other forces, (1, n) each."""
        given = np.where(self._held > 0.0, self.qdd, 0.0)
        tau = np.where(self._held > 0.0, 0.0, self.tau)
        return self.q[None], self.qd[None], given[None], tau[None]

    def _accelerate(self) -> None:
        """Work out the free accelerations; of trial states that are far off, finite or not."""
        robot, q, qd = self._robot, self.q, self.qd
        if self._laws:
            rows, check = self._driven(), bool(robot.tree.loops)
            self.qdd[:] = constraints.accelerations(robot, self._held, *rows, check=check)[0][0]
        elif robot.constraint_names:
            self.qdd[:], _ = robot.constrained_forward_dynamics(q, qd, self.tau)
        else:
            robot.forward_dynamics(q, qd, self.tau, out=self.qdd, check=False)

    def rate(self, t: float, state: Array) -> Array:
        """Return d(state)/dt, (2 f,), at a time [s] and a state (2 f,); NaN where that is NaN.

        An integrator's trial step may go too far: it then takes a smaller one.
        """
        try:
            self._apply(t, state)
            self._accelerate()
        except DenocError:
            if np.isfinite(state).all():
                raise
            return np.full(state.shape, np.nan)
        return np.concatenate([state[len(self.free) :], self.qdd[self.free]])


def checked_vector(value: Array, n: int, name: str, t: float | None = None) -> Array:
    """Return a vector (n,) of finite numbers as float64.

    Parameters
    ----------
    value : (n,) array
    name : str
        Named in errors.
    t : float, optional
        Time at which it was asked for [s], also named.

    Raises
    ------
    StateError
        For another shape, or a number that is not finite.
    """
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (n,):
        raise StateError(f'simulate: {name} must have shape ({n},), got {vector.shape}')
    if not np.isfinite(vector).all():
        when = '' if t is None else f' at t = {t:.9g} s'
        raise StateError(f'simulate: {name} must be finite, got {vector}{when}')
    return vector
