"""Torque feedforward: the torques with which the joints follow a desired motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from denoc_ros.dynamics.base.reacting_base import ReactingBase
from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.driven.measured_side import MotorSide
from denoc_ros.dynamics.elastic.state_bounds import StateBounds
from denoc_ros.dynamics.equilibrium import Equilibrium, UnsettledError
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.jit.handle import DAMPING, FRICTION
from denoc_ros.model.joint_friction import Friction
from denoc_ros.types import Array

MODELS = ('rigid', 'flexible', 'quasi_static')
LONGEST_GAP = 0.5  # s between two updates after which the amplitudes start anew from equilibrium
SUBSTEPS = 200  # at most, per update
SEARCHES = 50  # updates at most that go on with one search for an equilibrium


@dataclass(frozen=True)
class Terms:
    """Which parts of the torque are wanted."""

    inertia: bool = True  # for accelerations
    coriolis: bool = True  # for rates: centrifugal and Coriolis
    gravity: bool = True  # for weight
    friction: bool = True  # the joints' viscous damping and Coulomb friction
    # change by deflection: without it amplitudes count as zero and the rest is as rigid
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
        Its workspace is used: do not share it with another thread. Of one with joints measured
        behind their springs, what :func:`measured_robot` gives: the motion is then that of the
        link sides.
    joints : sequence of str, optional
        The joints that are driven, in the order of all arrays here; default all that are not
        mimics. Mimic joints follow their leaders, the loops give the joints they bind, the others
        stay at `held`.
    model : {'rigid', 'flexible', 'quasi_static'}
        rigid: the book's, links taken as rigid; flexible: the joints move as desired while the
        amplitudes move freely (hybrid dynamics, integrated alongside); quasi_static: the
        amplitudes stand in equilibrium with gravity.
    step : float
        Longest step of the integration alongside [s].
    held : mapping of str to float, optional
        Positions of joints that are not driven [rad or m]; default 0.
    posture : (n,) array, optional
        Coordinates near which loops are closed; default 0.

    A base that floats reacts: it starts with a total momentum of zero and moves freely. With the
    flexible model it is integrated with the amplitudes, with the others its momentum stays zero.
    Of a robot that drifts or tumbles, give the measured twist of the base before each update.
    As the whole robot falls freely, nothing has a weight: amplitudes start undeformed.

    Attributes
    ----------
    q, qd, qdd : (n,) array
        State and acceleration that the last torque is for.
    substeps : int
        Steps of the integration alongside at most per update; default 200. After a gap of more
        they are longer than `step`.
    patience : float
        s of a processor's time that one update may search for an equilibrium; default no bound.
    bounds : StateBounds or None
        Of the state with moving amplitudes.

    Raises
    ------
    StateError
        An unknown model or joint; driven joints that do not determine the motion of the loops.
    SolverError
        Loops that do not close near the posture.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str] | None = None,
        model: str = 'flexible',
        terms: Terms | None = None,
        step: float = 1e-3,
        held: Mapping[str, float] | None = None,
        posture: Array | None = None,
    ) -> None:
        if model not in MODELS:
            raise StateError(f'model must be one of {MODELS}, got {model!r}')
        self.robot = robot
        self.model = model
        self.terms = Terms() if terms is None else terms
        self.step = step
        flexible = np.ascontiguousarray(robot.flexible_indices)
        bends = model != 'rigid' and self.terms.elastic and len(flexible) > 0
        self._moves = model == 'flexible' and bends
        self._sags = model == 'quasi_static' and bends
        self.motion = driven_motion(robot, joints, held, posture, bends)
        self.joints = self.motion.joints
        n = robot.n
        self.q, self.qd, self.qdd = np.zeros((3, n))
        self._flexible = flexible
        self._index = robot.joint_indices
        free = np.union1d(flexible, self.motion.bound)
        self._equilibrium = Equilibrium(robot, free)
        self.bounds = StateBounds(robot, self.motion.posture, free) if self._moves else None
        self._stepper = Stepper(robot, step, self.motion.given)
        self._base = ReactingBase(robot)
        self._zero = np.zeros(n)
        self._state, self._full, self._part = np.zeros((3, n))
        self._result = np.zeros(len(self.joints))
        diagonals = robot.arrays.diagonals
        viscous, coulomb = diagonals[[DAMPING, FRICTION]][:, self._index]
        self._friction = Friction(viscous, coulomb)
        self._given = np.zeros(len(self.motion.given))
        self._moved = robot.indices(self.motion.given)
        whole = all(getattr(self.terms, name) for name in Terms.names())
        # what moves the amplitudes then gives the torque as well
        self._at_once = (
            self._moves
            and whole
            and self.motion.plain
            and not (self._stepper.tied or self._base.floats)
            and robot.arrays.link_side is None
        )
        self._motors = MotorSide(robot, self.joints)
        self.q[:] = self.motion.posture
        self._rest = self.q.copy()
        self.substeps, self.patience = SUBSTEPS, np.inf
        self._settled = False
        self._spent = 0

    def reset(self) -> None:
        """Forget the amplitudes: the next update starts from equilibrium."""
        self._settled = False
        self._spent = 0
        self._rest[self._flexible] = 0.0
        self._motors.reset()
        self._equilibrium.forget()
        if not (np.isfinite(self.q).all() and np.isfinite(self.qd).all()):
            self.q[:], self.qd[:] = self.motion.posture, 0.0

    def move_floating_base(self, twist: Array | None) -> None:
        """Take the measured twist (6,) of a base that floats: how it moves now.

        Parameters
        ----------
        twist : (6,) array or None
            Velocity of the base's origin and angular velocity [m/s, rad/s], in the axes of the
            link on the floating joint. None: nothing is measured, the momentum is zero.
        """
        self._base.twist = twist

    def adopt(self, other: TorqueFeedforward) -> None:
        """Go on from another's amplitudes, if they are as many (a changed model of one robot)."""
        if other.q.shape == self.q.shape and other._moves and self._moves and other._settled:
            self.q[:], self.qd[:], self.qdd[:] = other.q, other.qd, other.qdd
            self._given[:] = self.qdd[self._moved]
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
        StateError, SolverError
            A number is not finite, or the amplitudes are none that the robot can have; the next
            update starts from their equilibrium.
        UnsettledError
            The search for an equilibrium takes longer than `patience`; the next update goes on
            with it.
        """
        try:
            torque = self._update(q, qd, qdd, elapsed)
            if self.bounds is not None:
                self.bounds.require(self.q, self.qd)
            return torque
        except UnsettledError:
            raise
        except (StateError, SolverError):
            # diverged amplitudes must not start the next update, nor enter the gravity torque
            self.reset()
            self.q[:], self.qd[:], self.qdd[:] = self.motion.posture, 0.0, 0.0
            raise

    def _update(self, q: Array, qd: Array, qdd: Array, elapsed: float) -> Array:
        if self._moves and self._settled and 0.0 <= elapsed <= LONGEST_GAP:
            if self._at_once:
                self._stepper.torque(
                    (q, qd, qdd), self.q, self.qd, self.qdd, self._result, self._given, elapsed,
                    self._count(elapsed),
                )  # fmt: skip
                if self._motors.any:
                    self._motors.add(self._result, (qd, qdd), elapsed)
                return self._result
            self._integrate(qd, qdd, elapsed)
            self._place(q, qd, qdd)
            if self._base.floats and self._base.twist is not None:
                self._base.rates(self.q, self.qd)
        else:
            self._place(q, qd, qdd)
            self._start()
            self._given[:] = self.motion.given_accelerations(qdd)
        if self._moves:
            self._stepper.accelerations(self.q, self.qd, self._given, out=self.qdd)
        elif self._base.floats:
            self._react(elapsed)
        torque = self._joint_torque()
        terms = self.terms
        self._motors.add(torque, (qd, qdd), elapsed, terms.inertia, terms.friction)
        return torque

    def whole_motion(self) -> tuple[Array, Array, Array]:
        """Return coordinates, rates, accelerations of the robot with all its springs.

        As of :meth:`MotorSide.whole_motion`: q, qd and qdd themselves, unless joints are measured
        behind their springs.
        """
        return self._motors.whole_motion((self.q, self.qd, self.qdd))

    def gravity(self, q: Array) -> Array:
        """Return the torque (driven joints,) that carries the weight at rest at joints q.

        Zero without the gravity term, and in free fall, which a base that floats is in. Does not
        touch the state of a motion; amplitudes count as they are in it, and without one as they
        are in equilibrium.
        """
        if not self.terms.gravity or self._base.floats:
            self._result[:] = 0.0
            return self._result
        state = self._state
        # loops close from the last posture that did: the next one is near it
        state[:] = self._rest
        settles = (self._moves or self._sags) and not self._settled
        if not settles:
            state[self._flexible] = self.q[self._flexible] if self.terms.elastic else 0.0
        self.motion.positions(state, q)
        if settles:
            self._sag(state)
        self._rest[:] = state
        self.robot.inverse_dynamics(state, self._zero, self._zero, out=self._full, check=False)
        return self.motion.reduce(self._full, self._result)

    def _sag(self, state: Array) -> None:
        """Put the amplitudes of a state (n,) at rest into equilibrium; undeformed without one."""
        straight = state.copy()
        straight[self._flexible] = 0.0
        try:
            if not self._equilibrium.follow(state):
                self._equilibrium.find(state, self.patience)
        except SolverError:
            state[:] = straight

    def _place(self, q: Array, qd: Array, qdd: Array) -> None:
        """Put the desired motion into the state's joints."""
        self.motion.positions(self.q, q)
        self.motion.rates(self.qd, qd)
        self.motion.accelerations(self.q, self.qd, self.qdd, qdd)

    def _integrate(self, qd: Array, qdd: Array, elapsed: float) -> None:
        """Move the amplitudes over `elapsed`, the joints going to `qd` and `qdd`."""
        before, after = self._given, self.motion.given_accelerations(qdd)
        if elapsed > 0.0:
            # as the compiled period: see its mean acceleration
            gained = self.motion.given_accelerations(qd) - self.qd[self._moved]
            middle, most = 0.5 * (before + after), np.abs(before) + np.abs(after)
            mean = np.clip(gained / elapsed, middle - most, middle + most)
            change = after - before
            first, count = mean - 0.5 * change, self._count(elapsed)
            self._stepper.drive(self.q, self.qd, first, change, elapsed, count)
        self._given[:] = after
        if elapsed > 0.0 and self._base.floats:
            self._base.wrap(self.q, self.qd)

    def _count(self, elapsed: float) -> int:
        """Return the number of steps of an interval [s]."""
        if not elapsed > 0.0:
            return 0
        return min(self.substeps, round(elapsed / self.step) or 1)

    def _react(self, elapsed: float) -> None:
        """Move a floating base beside a motion whose amplitudes are given."""
        q, qd, index = self.q, self.qd, self._base.index
        before = qd[index]
        self._base.rates(q, qd)
        if 0.0 <= elapsed <= LONGEST_GAP:
            q[index] += 0.5 * elapsed * (before + qd[index])
            self._base.wrap(q, qd)
        self._base.accelerations(q, qd, self.qdd)

    def _start(self) -> None:
        """Move the amplitudes to their static equilibrium (or keep them zero)."""
        if self._base.floats:
            self.q[self._flexible] = self.qd[self._flexible] = self.qdd[self._flexible] = 0.0
            self._settled = True
        elif self._moves or self._sags:
            self.qd[self._flexible] = 0.0
            self.qdd[self._flexible] = 0.0
            if not (self._sags and self._equilibrium.follow(self.q)):
                self._find_equilibrium()
            self._settled = True
        if self._base.floats:
            self._base.rates(self.q, self.qd)

    def _find_equilibrium(self) -> None:
        """Put the amplitudes into equilibrium from scratch."""
        self._settled = False
        self._spent += 1
        try:
            self._equilibrium.find(self.q, self.patience)
        except UnsettledError as error:
            if self._spent <= SEARCHES:
                raise
            failure: SolverError = error
        except SolverError as error:
            failure = error
        else:
            self._spent = 0
            return
        self.q[:] = self.motion.posture
        raise StateError(str(failure)) from failure

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
            friction = self._friction.force(qd[self._index])
            full[self._index] += -friction if terms.coriolis else friction
        if terms.friction:
            self.motion.add_friction(qd, full)
        return self.motion.reduce(full, self._result)
