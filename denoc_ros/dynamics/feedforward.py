"""Torque feedforward: what the joints must give so that they follow a desired motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.joint_ties import joint_ties
from denoc_ros.dynamics.linearization import stiffness
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.articulated import articulated_dynamics
from denoc_ros.kernels.handle import ARMATURE, DAMPING, FRICTION, GOOD
from denoc_ros.model.lowering import SLIP_RATE

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

Array = NDArray[np.float64]

MODELS = ('rigid', 'flexible', 'quasi_static')
LONGEST_GAP = 0.5  # s between two updates after which the amplitudes start anew from equilibrium
SUBSTEPS = 200  # at most, per update
FOLLOW_ITERATIONS = 3  # of the static deflection, per update
SETTLED = 1e-12  # relative change that ends the iteration
FOLLOWED = 1e-7  # relative change above which the tangent no longer serves


@dataclass(frozen=True)
class Terms:
    """Which parts of the torque are wanted.

    Attributes
    ----------
    inertia : bool
        What accelerations need.
    coriolis : bool
        What rates need: centrifugal and Coriolis.
    gravity : bool
        What weight needs.
    friction : bool
        The joints' viscous damping and Coulomb friction.
    elastic : bool
        What deflection changes: without it amplitudes count as zero and the rest is as rigid.
    """

    inertia: bool = True
    coriolis: bool = True
    gravity: bool = True
    friction: bool = True
    elastic: bool = True

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the switches' names."""
        return tuple(field.name for field in fields(cls))


class TorqueFeedforward:
    """Torque along a desired joint motion, update by update; allocates nothing that grows.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    joints : sequence of str, optional
        The joints that are driven, in the order of all arrays here; default all that are not
        mimics. Mimic joints follow their leaders, the others stay at `held`.
    model : {'rigid', 'flexible', 'quasi_static'}
        rigid: the book's, links taken as rigid; flexible: the joints move as desired while the
        amplitudes move freely (hybrid dynamics, integrated alongside); quasi_static: the
        amplitudes stand in equilibrium with gravity.
    terms : Terms
    step : float
        Longest step of the integration alongside [s].
    held : mapping of str to float, optional
        Positions of joints that are not driven [rad or m]; default 0.

    Attributes
    ----------
    q, qd, qdd : (n,) array
        State and acceleration that the last torque is for.

    Raises
    ------
    StateError
        An unknown model or joint.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str] | None = None,
        model: str = 'flexible',
        terms: Terms | None = None,
        step: float = 1e-3,
        held: Mapping[str, float] | None = None,
    ) -> None:
        if model not in MODELS:
            raise StateError(f'model must be one of {MODELS}, got {model!r}')
        self.robot = robot
        self.model = model
        self.terms = Terms() if terms is None else terms
        self.step = step
        self.ties, self.offsets, self.joints = joint_ties(robot, joints, held or {})
        n = robot.n
        self.q, self.qd, self.qdd = np.zeros((3, n))
        self._flexible = np.ascontiguousarray(robot.flexible_indices)
        self._index = robot.joint_indices
        self._moves = model == 'flexible' and self.terms.elastic and len(self._flexible) > 0
        self._sags = model == 'quasi_static' and self.terms.elastic and len(self._flexible) > 0
        self._stepper = Stepper(robot, step)
        self._held = robot.held(robot.joint_indices)
        self._zero = np.zeros(n)
        self._drive, self._given, self._full, self._part, self._torque = np.zeros((5, n))
        self._acceleration = np.zeros(len(self._index))
        self._result = np.zeros(len(self.joints))
        diagonals = robot.lowered.diagonals
        self._damping = diagonals[DAMPING][self._index].copy()
        self._friction = diagonals[FRICTION][self._index].copy()
        self._armature = diagonals[ARMATURE].copy()
        self._compliance: Array = np.zeros((len(self._flexible), len(self._flexible)))
        self._settled = False

    def reset(self) -> None:
        """Forget the amplitudes: the next update starts from equilibrium."""
        self._settled = False

    def adopt(self, other: TorqueFeedforward) -> None:
        """Go on from another's amplitudes, if they are as many (a changed model of one robot)."""
        if other.q.shape == self.q.shape and other._moves and self._moves and other._settled:
            self.q[:], self.qd[:], self.qdd[:] = other.q, other.qd, other.qdd
            self._settled = True

    def update(self, q: Array, qd: Array, qdd: Array, elapsed: float) -> Array:
        """Return the torque (driven joints,) for a desired motion; the same array each time.

        Parameters
        ----------
        q, qd, qdd : (driven joints,) array
            rad or m, and per s, per s^2.
        elapsed : float
            s since the last update; the amplitudes are integrated over it. The first update, and
            one after a gap longer than 0.5 s, starts from the amplitudes' equilibrium.

        Raises
        ------
        StateError
            A number is not finite.
        """
        if self._moves and self._settled and 0.0 <= elapsed <= LONGEST_GAP:
            self._integrate(qdd, elapsed)
            self._place(q, qd, qdd)
        else:
            self._place(q, qd, qdd)
            self._start()
        if self._moves:
            self._free_accelerations()
        return self._joint_torque()

    def gravity(self, q: Array) -> Array:
        """Return the torque (driven joints,) that carries the weight at rest at joints q.

        Zero without the gravity term. Does not touch the state of a motion; amplitudes count as
        they are.
        """
        if not self.terms.gravity:
            self._result[:] = 0.0
            return self._result
        state = self._given
        state[:] = self.q if self.terms.elastic else 0.0
        state[self._index] = self.ties @ q + self.offsets
        self.robot.inverse_dynamics(state, self._zero, self._zero, out=self._full, check=False)
        return self._reduce(self._full)

    def _place(self, q: Array, qd: Array, qdd: Array) -> None:
        """Put the desired motion into the state's joints."""
        index, ties = self._index, self.ties
        self.q[index] = ties @ q + self.offsets
        self.qd[index] = ties @ qd
        self.qdd[index] = ties @ qdd

    def _integrate(self, qdd: Array, elapsed: float) -> None:
        """Move the amplitudes over `elapsed`, the joints' acceleration going to `qdd`."""
        if elapsed == 0.0:
            return
        before = self.qdd[self._index]
        after = self.ties @ qdd
        count = min(SUBSTEPS, max(1, round(elapsed / self.step)))
        self._stepper.step = elapsed / count
        for k in range(count):
            np.multiply(after - before, (k + 0.5) / count, out=self._acceleration)
            self._acceleration += before
            self._stepper.driven(self.q, self.qd, self._acceleration)

    def _start(self) -> None:
        """Put the amplitudes where they stand still (or keep them zero)."""
        if self._moves or self._sags:
            self.qd[self._flexible] = 0.0
            self.qdd[self._flexible] = 0.0
            if not (self._settled and self._sags and self._follow_equilibrium()):
                self._find_equilibrium()
            self._settled = True

    def _find_equilibrium(self) -> None:
        """Put the amplitudes into equilibrium from scratch and keep the tangent there."""
        self._settled = False
        try:
            start = self.q if np.isfinite(self.q).all() else None
            self.q[:] = self.robot.static_deflection(self.q[self._index], start=start)
            flexible = np.ix_(self._flexible, self._flexible)
            tangent = stiffness(self.robot, self.q)[flexible]
            self._compliance = np.linalg.inv(tangent).astype(np.float64, copy=False)
        except SolverError as error:
            self.q[self._flexible] = 0.0
            raise StateError(str(error)) from error

    def _follow_equilibrium(self) -> bool:
        """Move the amplitudes to the equilibrium nearby by the tangent kept; say if it did."""
        flexible = self._flexible
        for _ in range(FOLLOW_ITERATIONS):
            self.robot.inverse_dynamics(
                self.q, self._zero, self._zero, out=self._part, check=False
            )
            change = self._compliance @ self._part[flexible]
            self.q[flexible] -= change
            share = float(np.abs(change).max() / (1e-3 + np.abs(self.q[flexible]).max()))
            if share <= SETTLED:
                break
        return share <= FOLLOWED

    def _free_accelerations(self) -> None:
        """Write the amplitudes' accelerations into `qdd`."""
        self._given[:] = 0.0
        self._given[self._index] = self.qdd[self._index]
        status = articulated_dynamics(
            self.robot.handle, self._armature, self._held, self.q, self.qd,
            self._given, self._drive, self.qdd, self._torque,
        )  # fmt: skip
        if status != GOOD:
            self._settled = False
            raise StateError('desired motion must be finite, got one that is not')
        self.qdd[self._index] = self._given[self._index]

    def _joint_torque(self) -> Array:
        """Return the wanted terms of the torque at the state."""
        terms, inverse = self.terms, self.robot.inverse_dynamics
        q, qd, qdd, zero = self.q, self.qd, self.qdd, self._zero
        full, part = self._full, self._part
        inverse(q, qd, qdd if terms.inertia else zero, out=full, check=False)
        if not terms.coriolis:
            # leaves the inertia term alone; gravity and friction are put back
            full -= inverse(q, qd, zero, out=part, check=False)
        if terms.gravity != terms.coriolis:
            inverse(q, zero, zero, out=part, check=False)
            full += part if terms.gravity else -part
        if terms.friction != terms.coriolis:
            friction = self._joint_friction(qd[self._index])
            full[self._index] += -friction if terms.coriolis else friction
        return self._reduce(full)

    def _joint_friction(self, rate: Array) -> Array:
        friction: Array = self._damping * rate + self._friction * np.tanh(rate / SLIP_RATE)
        return friction

    def _reduce(self, force: Array) -> Array:
        """Return the driven joints' share: a leader carries its mimics."""
        return np.dot(force[self._index], self.ties, out=self._result)
