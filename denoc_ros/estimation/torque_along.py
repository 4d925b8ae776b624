"""A model's torque and deflection along a joint motion, term by term."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from denoc_ros.dynamics.base.base_motion import BaseMotion
from denoc_ros.dynamics.constrained_dynamics import mimic_ties
from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.driven.measured_side import WholeCoordinates
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import GearSprings
from denoc_ros.dynamics.stepper import Stepper, StepsAlong
from denoc_ros.errors import ModelError
from denoc_ros.estimation.base_track import BaseRecord
from denoc_ros.estimation.joint_motion import SmoothedMotion
from denoc_ros.estimation.joint_tracker import connecting_acceleration
from denoc_ros.model.joint_friction import Friction
from denoc_ros.types import Array, Flags


@dataclass(frozen=True)
class Torques:
    """Torques of a model along k rows of motion."""

    # dict of str to (k, joints) array: gravity, inertia, coriolis, friction, elastic (flexible
    # robots) and offset (with fitted friction): they add up to the torque of the best model [N m,
    # N]
    parts: dict[str, Array]
    # dict of str to (k, joints) array: torque of the rigid and, with flexible links, of the
    # flexible model
    models: dict[str, Array]
    # (2, k, n) coordinates and rates with the amplitudes, where there are any
    amplitudes: Array | None
    # (2, k, 6 links) tip deflections and their rates, as `TipDeflections.names`
    deflection: Array | None
    # (2, k, all) coordinates and rates of the whole robot, with the springs behind which
    # joints are measured, as `TorqueReplay.whole.names`; None where nothing is elastic
    modal: Array | None = None

    @property
    def best(self) -> Array:
        """The torque of the flexible model where there is one, else of the rigid."""
        return self.models.get('flexible', self.models['rigid'])


class TorqueReplay:
    """Goes along a motion, block after block; the amplitudes are integrated alongside.

    Parameters
    ----------
    robot : Robot
        The model.
    joints : sequence of str
        The driven joints: order of all columns. Mimic joints and loops give others, the rest
        stands at 0.
    posture : (n,) array, optional
        Coordinates near which loops are closed; default 0.
    friction : Friction, optional
        Stands for the damping and friction that the robot's joints have.
    step : float
        Longest step of the integration [s].
    base : BaseRecord, optional
        How the base moves, on the clock of the rows; default: it is at rest.

    Raises
    ------
    ModelError
        The robot has loops and flexible links, or loops on a base that moves.
    StateError
        A driven joint is unknown or a mimic; driven joints that leave a mechanism free, or cannot
        move independently of each other.
    SolverError
        Loops that do not close near the posture.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        posture: Array | None = None,
        friction: Friction | None = None,
        step: float = 1e-3,
        base: BaseRecord | None = None,
    ) -> None:
        if robot.tree.loops and base is not None:
            loops = [loop.name for loop in robot.tree.loops]
            rule = f'a robot on a base that moves must have no loops for a replay, got {loops}'
            raise ModelError(robot.tree.name, [rule])
        if robot.tree.loops and len(robot.flexible_indices):
            loops = [loop.name for loop in robot.tree.loops]
            rule = f'links of a robot with loops must be rigid for a replay, got loops {loops}'
            raise ModelError(robot.tree.name, [rule])
        self._robot, self._base = robot.copy(), base
        self._ties, self._offsets, self.joints = mimic_ties(robot, joints, {})
        self._motion = driven_motion(self._robot, self.joints, None, posture, flexible=False)
        self._friction = friction
        index = robot.joint_indices
        self._of_model = Friction(
            robot.damping[index], robot.friction[index], np.zeros(len(index))
        )
        self.deflections = TipDeflections(robot)
        self._index = index
        self._bends = len(robot.flexible_indices) > 0
        self._stepper = Stepper(robot.copy(), step)
        self._step = step
        is_free = self._bends and base is None and not robot.constraint_names
        self._along = StepsAlong(self._stepper.robot, step) if is_free else None
        self._q, self._qd = np.zeros((2, robot.n))
        self._last: float = np.nan
        self.whole = WholeCoordinates(robot)
        self._springs = GearSprings(self.whole.springs)
        self._last_spring: float = 0.0
        driven = [self.joints.index(j) for j in self.whole.hidden if j in self.joints]
        self._behind = np.array(driven if len(driven) == len(self.whole.hidden) else [], dtype=int)

    @property
    def has_modes(self) -> bool:
        """Whether the robot has coordinates beside those of its joints that are computed."""
        return self._bends or len(self._behind) > 0

    @property
    def held(self) -> tuple[str, ...]:
        """The joints fixed at 0: not driven, not a mimic, not given by loops."""
        free = {*self._robot.tree.non_mimic_joints}
        places = zip(self._robot.joint_names, self._robot.joint_indices, strict=True)
        unbound = {name for name, place in places if place not in self._motion.bound}
        return tuple(n for n in self._robot.joint_names if n in (free & unbound) - {*self.joints})

    @property
    def models(self) -> tuple[str, ...]:
        """The models whose torque is computed."""
        return ('rigid', 'flexible') if self._bends else ('rigid',)

    def torques(self, t: Array, motion: SmoothedMotion, starts: Flags) -> Torques:
        """Return the model's torques and deflection of the next rows.

        Parameters
        ----------
        t : (k,) array
            Times [s], going on from the rows before.
        motion : SmoothedMotion
            Of the driven joints.
        starts : (k,) bool array
            Where the amplitudes start anew, in equilibrium.
        """
        base = None if self._base is None else self._base.at(t)
        parts = self._rigid(motion, base)
        own = parts['friction']
        if self._friction is not None:
            parts['friction'] = self._friction.force(motion.qd)
            parts['offset'] = np.broadcast_to(self._friction.offset, own.shape)
        models = {'rigid': np.sum(list(parts.values()), axis=0)}
        if not self._bends:
            modal = self._with_springs(t, self._still(motion), models['rigid'], starts)
            return Torques(parts, models, None, None, modal)
        flexible, amplitudes, deflection = self._flexible(t, motion, starts, base)
        rigid_alone = parts['gravity'] + parts['inertia'] + parts['coriolis'] + own
        parts['elastic'] = flexible - rigid_alone
        models['flexible'] = models['rigid'] + parts['elastic']
        modal = self._with_springs(t, amplitudes, models['flexible'], starts)
        return Torques(parts, models, amplitudes, deflection, modal)

    def _still(self, motion: SmoothedMotion) -> Array:
        """Return coordinates and rates (2, k, n) of the undeformed robot."""
        states = np.zeros((3, len(motion.q), self._robot.n))
        if self._robot.tree.loops:
            if len(self._behind):
                self._in_loops(motion, states)
            return states[:2]
        states[0][:, self._index] = motion.q @ self._ties.T + self._offsets
        states[1][:, self._index] = motion.qd @ self._ties.T
        return states[:2]

    def _with_springs(self, t: Array, states: Array, torque: Array, starts: Flags) -> Array | None:
        """Return states (2, k, all) with springs that carry the joints' torque (k, joints)."""
        if not self.has_modes:
            return None
        modal = np.zeros((2, len(t), len(self.whole.names)))
        springs = np.zeros((2, len(t), len(self._springs.rate)))
        before = self._last_spring
        for k in range(len(t) if len(self._behind) else 0):
            if starts[k]:
                self._springs.reset()
            self._springs.follow(torque[k, self._behind], t[k] - before)
            springs[:, k], before = (self._springs.deflection, self._springs.rate), t[k]
        self._last_spring = float(t[-1])
        self.whole.write(states, springs, modal)
        return modal

    def states(self, t: Array, motion: SmoothedMotion, starts: Flags) -> tuple[Array, Array]:
        """Return the best model's states and torque of the next rows, and nothing else.

        Arguments are those of `torques`.

        Returns
        -------
        states : (3, k, n) array
            Coordinates, rates and accelerations, amplitudes included.
        torque : (k, joints) array
            [N m, N]
        """
        robot, index = self._robot, self._index
        if robot.tree.loops:
            states = np.empty((3, len(t), robot.n))
            return states, self._in_loops(motion, states)[2]
        states = np.zeros((3, len(t), robot.n))
        qdd = motion.qdd @ self._ties.T
        if self._bends:
            states[:2] = self._amplitudes(t, motion, starts)
            forces, free = robot.hybrid_dynamics(states[0], states[1], qdd)
            states[2][:, index] = qdd
            states[2][:, np.setdiff1d(np.arange(robot.n), index)] = free
            return states, forces @ self._ties
        states[0][:, index] = motion.q @ self._ties.T + self._offsets
        states[1][:, index], states[2][:, index] = motion.qd @ self._ties.T, qdd
        return states, robot.inverse_dynamics(*states)[:, index] @ self._ties

    def without_friction(self, torques: Torques) -> Array:
        """Return the best model's torque without friction of the joints and offset."""
        kept = (part for name, part in torques.parts.items() if name not in ('friction', 'offset'))
        rest: Array = np.sum(list(kept), axis=0)
        return rest

    def _rigid(self, motion: SmoothedMotion, base: BaseMotion | None = None) -> dict[str, Array]:
        """Return the terms of the undeformed robot."""
        tree = not self._robot.tree.loops
        terms = self._in_tree(motion, base) if tree else self._in_loops(motion)
        gravity, moving, whole, friction = terms
        return {
            'gravity': gravity,
            'inertia': whole - moving,
            'coriolis': moving - gravity - friction,
            'friction': friction,
        }

    def _in_tree(self, motion: SmoothedMotion, base: BaseMotion | None) -> tuple[Array, ...]:
        """Return the torques at rest, without accelerations, with all, and of friction alone."""
        robot, index = self._robot, self._robot.joint_indices
        q, qd, qdd, zero = np.zeros((4, len(motion.q), robot.n))
        q[:, index] = motion.q @ self._ties.T + self._offsets
        qd[:, index] = motion.qd @ self._ties.T
        qdd[:, index] = motion.qdd @ self._ties.T
        forces = [
            robot.inverse_dynamics(q, *rates, base=base)
            for rates in ((zero, zero), (qd, zero), (qd, qdd))
        ]
        friction = self._of_model.force(qd[:, index])
        return (*(force[:, index] @ self._ties for force in forces), friction @ self._ties)

    def _in_loops(self, motion: SmoothedMotion, states: Array | None = None) -> tuple[Array, ...]:
        """Return the same of a mechanism, row by row: each closes its loops from the last.

        States (3, k, n), if given, are written.
        """
        robot, driven = self._robot, self._motion
        terms = np.empty((4, *motion.q.shape))
        zero = np.zeros(robot.n)
        q, qd, qdd = driven.posture, np.zeros(robot.n), np.zeros(robot.n)
        for k in range(len(motion.q)):
            driven.positions(q, motion.q[k])
            driven.rates(qd, motion.qd[k])
            driven.accelerations(q, qd, qdd, motion.qdd[k])
            if states is not None:
                states[:, k] = q, qd, qdd
            of_loops, friction = np.zeros((2, robot.n))
            driven.add_friction(qd, of_loops)
            friction[robot.joint_indices] = self._of_model.force(qd[robot.joint_indices])
            forces = (
                robot.inverse_dynamics(q, zero, zero),
                robot.inverse_dynamics(q, qd, zero) + of_loops,
                robot.inverse_dynamics(q, qd, qdd) + of_loops,
                friction + of_loops,
            )
            for term, force in zip(terms, forces, strict=True):
                driven.reduce(force, term[k])
        return tuple(terms)

    def _flexible(
        self, t: Array, motion: SmoothedMotion, starts: Flags, base: BaseMotion | None = None
    ) -> tuple[Array, Array, Array]:
        """Return torques, coordinates with their rates, and deflections of the flexible robot."""
        amplitudes = self._amplitudes(t, motion, starts)
        deflection = np.empty((2, len(t), len(self.deflections.names)))
        for k in range(len(t)):
            q, qd = amplitudes[:, k]
            self.deflections.evaluate(q, qd, (deflection[0, k], deflection[1, k]))
        qdd = motion.qdd @ self._ties.T
        torque, _ = self._robot.hybrid_dynamics(amplitudes[0], amplitudes[1], qdd, base=base)
        return torque @ self._ties, amplitudes, deflection

    def _amplitudes(self, t: Array, motion: SmoothedMotion, starts: Flags) -> Array:
        """Return coordinates and rates (2, k, n) with the amplitudes, integrated."""
        q, qd = motion.q @ self._ties.T + self._offsets, motion.qd @ self._ties.T
        found = np.empty((2, len(t), self._robot.n))
        q_before = np.concatenate([[self._q[self._index]], q[:-1]])
        qd_before = np.concatenate([[self._qd[self._index]], qd[:-1]])
        elapsed = np.diff(t, prepend=self._last)
        with np.errstate(invalid='ignore'):
            means, slopes = connecting_acceleration(elapsed[:, None], q_before, qd_before, q, qd)
        if self._along is not None:
            joints, rates = np.stack([q, qd]), np.stack([means, slopes])
            return self._in_one_call(self._along, t, starts, elapsed, joints, rates)
        for k in range(len(t)):
            if starts[k]:
                self._start(q[k], t[k])
            else:
                self._go(t[k], elapsed[k], means[k], slopes[k])
            self._q[self._index], self._qd[self._index] = q[k], qd[k]
            found[:, k] = self._q, self._qd
        self._last = float(t[-1])
        return found

    def _in_one_call(
        self, steps: StepsAlong, t: Array, starts: Flags, intervals: Array, joints: Array,
        rates: Array,
    ) -> Array:  # fmt: skip
        """Return the same with one call from each start to the next.

        Joints (2, k, joints) are positions and rates, `rates` mean and slope of accelerations.
        """
        count = len(t)
        states, accelerations = np.zeros((2, 2, count + 1, self._robot.n))
        states[:, 0] = self._q, self._qd
        states[:, 1:, self._index], accelerations[:, 1:, self._index] = joints, rates
        intervals = np.concatenate([[0.0], intervals])
        for first, last in pairwise([-1, *np.flatnonzero(starts), count]):
            if first >= 0:
                self._start(joints[0, first], t[first])
                self._q[self._index], self._qd[self._index] = joints[:, first]
                states[:, first + 1] = self._q, self._qd
            steps.write(states, intervals, accelerations, first + 2, last + 1)
        self._q[:], self._qd[:] = states[:, -1]
        self._last = float(t[-1])
        return states[:, 1:]

    def _start(self, joints: Array, t: float) -> None:
        """Begin with the amplitudes in equilibrium; in free fall undeformed."""
        base, still = self._base, self._robot.static_deflection
        self._qd[:] = 0.0
        if base is None or not base.floats:
            self._q[:] = still(joints, base=None if base is None else base.once(t))
        else:
            self._q[:] = 0.0
            self._q[self._index] = joints

    def _go(self, end: float, interval: float, mean: Array, slope: Array) -> None:
        """Move the amplitudes over an interval up to a time, joints' accelerations linear in it.

        The accelerations make the change of rates and positions exactly, so that errors of
        accelerations at the stamps do not pile up in the amplitudes.
        """
        steps = math.ceil(interval / self._step - 1e-6)
        self._stepper.step = interval / steps
        for k in range(steps):
            middle = (k + 0.5) * self._stepper.step - 0.5 * interval
            if self._base is not None:
                now = end - 0.5 * interval + middle
                self._stepper.robot.move_base(self._base.once(now))
            self._stepper.driven(self._q, self._qd, mean + middle * slope)
