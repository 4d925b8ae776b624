"""Motion of all joints from that of the driven ones: mimic joints and loops give the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.assembling import rank_of
from denoc_ros.dynamics.constrained_dynamics import (
    RANK,
    add_loop_friction,
    closure_rows,
    jacobian,
    mimic_ties,
)
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.model.tree import JointKind, Tree
from denoc_ros.types import Array

Int = NDArray[np.int64]

ITERATIONS = 20
REACH = 0.2  # rad or m of the driven joints at once, so that the loops stay on their branch
MOST_PARTS = 40  # at once; whole turns of a revolute joint beyond that leave out
NEARLY_CLOSED = 1e-8  # m or rad; Newton's next step squares it


class DrivenMotion:
    """Joints of a tree: mimic joints follow their leaders, the others are fixed.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    joints : sequence of str, optional
        The driven joints; default all that are not mimics.
    held : mapping of str to float, optional
        Positions of joints that are neither driven nor follow [rad or m]; default 0.

    Attributes
    ----------
    joints : tuple of str
        The driven joints, in the order of all arrays of driven joints here.
    index : (driven,) int array
        Their coordinates.
    posture : (n,) array
        Closed coordinates to start from.
    given : tuple of str
        Joints whose motion so is given: the driven ones, those that stand still, mimics of trees.
    bound : int array
        Coordinates that are found from the loops.

    Raises
    ------
    StateError
        A driven joint is unknown, repeated or a mimic.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str] | None = None,
        held: Mapping[str, float] | None = None,
    ) -> None:
        self.robot = robot
        self._ties, self._offsets, self.joints = mimic_ties(robot, joints, held or {})
        self._all = robot.joint_indices
        identity = np.array_equal(self._ties, np.eye(len(self._ties)))
        self._plain = identity and not self._offsets.any()
        names = list(robot.joint_names)
        self.index: Int = self._all[[names.index(name) for name in self.joints]]
        self.given = robot.joint_names
        # whether all joints are driven, each by itself, in the order of the coordinates
        self.plain = self._plain and not robot.tree.loops
        self.posture: Array = np.zeros(robot.n)
        self.bound: Int = np.zeros(0, dtype=np.int64)

    def positions(self, q: Array, driven: Array) -> None:
        """Put positions (driven,) into q (n,) and with them those of the joints they give."""
        q[self._all] = driven if self._plain else self._ties @ driven + self._offsets

    def rates(self, qd: Array, driven: Array) -> None:
        """Put rates (driven,) into qd (n,) and with them those they give at the last positions."""
        qd[self._all] = driven if self._plain else self._ties @ driven

    def accelerations(self, q: Array, qd: Array, qdd: Array, driven: Array) -> None:
        """Put accelerations (driven,) into qdd (n,) and with them those they give."""
        qdd[self._all] = driven if self._plain else self._ties @ driven

    def given_accelerations(self, driven: Array) -> Array:
        """Return the accelerations of the joints `given` by those of the driven ones."""
        return driven if self._plain else np.asarray(self._ties @ driven)

    def reduce(self, force: Array, out: Array) -> Array:
        """Return the driven joints' torques for generalized forces (n,), at the last positions."""
        if self._plain:
            out[:] = force[self._all]
            return out
        return np.dot(force[self._all], self._ties, out=out)

    def add_friction(self, qd: Array, force: Array) -> None:
        """Add viscous and Coulomb friction of the loops' own joints to a force (n,) in place."""


class LoopedMotion(DrivenMotion):
    """Joints of a mechanism: the loops give those that are not driven.

    Parameters
    ----------
    robot, joints, held
        As of :class:`DrivenMotion`; joints outside of loops that are not driven are held.
    posture : (n,) array, optional
        Coordinates near which the loops are closed; default 0.
    flexible : bool
        Whether amplitudes may help to close the loops where the joints alone cannot.

    Notes
    -----
    With B the bound coordinates and P the pseudoinverse of their columns of J: positions by
    Newton's steps -P e, rates by one step -P J q', accelerations by -P (J q'' + J' q'), and the
    multipliers of forces on B are P^T f_B (book, section 5.1.2).

    Raises
    ------
    StateError
        The driven joints leave the mechanism free, or cannot move apart from each other.
    SolverError
        The loops do not close near the posture.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str] | None = None,
        held: Mapping[str, float] | None = None,
        posture: Array | None = None,
        flexible: bool = True,
    ) -> None:
        super().__init__(robot, joints, held)
        self.posture = robot.assemble(np.zeros(robot.n) if posture is None else posture)
        self._zero = np.zeros(robot.n)
        self._rows, self._axes = jacobian(robot, self.posture)
        self.bound = self._find_bound(flexible)
        names = zip(robot.joint_names, robot.joint_indices, strict=True)
        self.given = tuple(name for name, place in names if place not in self.bound)
        self._picked = [robot.joint_names.index(name) for name in self.given]
        self._least: Array = np.zeros((len(self.bound), len(self._rows)))
        kinds = [robot.tree.joints[name].kind for name in self.joints]
        self._turning = np.array([kind is JointKind.REVOLUTE for kind in kinds])
        self._apart = self._outside_of_loops()
        self._linearize(self.posture)

    def _find_bound(self, flexible: bool) -> Int:
        """Return the coordinates that the loops determine; check that they do."""
        rows, robot = self._rows, self.robot
        moving = np.abs(rows).max(axis=0) > RANK * np.abs(rows).max()
        free = np.setdiff1d(robot.joint_indices[moving[robot.joint_indices]], self.index)
        rank = rank_of(rows[:, free])
        if rank < len(free):
            names = [robot.coordinate_names[k] for k in free]
            raise StateError(
                f'{robot.tree.name}: the driven joints {list(self.joints)} must leave nothing '
                f'else free, got {len(free) - rank} free motion(s) of {names}'
            )
        if rank_of(rows[:, np.union1d(free, self.index)]) > rank:
            raise StateError(
                f'{robot.tree.name}: the driven joints must move independently of each other, '
                f'got {list(self.joints)}, which the loops constrain together'
            )
        everything = np.union1d(free, robot.flexible_indices)
        return everything if flexible and rank_of(rows[:, everything]) > rank else free

    def _outside_of_loops(self) -> NDArray[np.bool_]:
        """Say of each driven joint whether it leaves the loops as they are, wherever it is."""
        tree = self.robot.tree
        within: set[str] = set()
        for loop in tree.loops:
            within |= joints_below(tree, loop.parent.frame) ^ joints_below(tree, loop.child.frame)
        inside = [name in within for name in self.robot.joint_names]
        moves = (self._ties[inside] != 0.0).any(axis=0)
        return np.asarray(~moves, dtype=np.bool_)

    def _linearize(self, q: Array) -> None:
        self._rows, self._axes = jacobian(self.robot, q)
        least = np.linalg.pinv(self._rows[:, self.bound], rcond=RANK)
        self._least = np.asarray(least, dtype=np.float64)

    def positions(self, q: Array, driven: Array) -> None:
        """Put positions (driven,) into q (n,) and close the loops from where q is.

        Raises
        ------
        SolverError
            They do not close there, or it is too far from q; q is then as it was.
        """
        start, found = q[self.index], q.copy()
        start[self._apart] = driven[self._apart]
        found[self.index] = start
        way = np.abs(driven - start).max(initial=0.0)
        if MOST_PARTS * REACH < way < np.inf:
            # the same posture, turns later
            start = start + np.where(self._turning, _turns(driven - start), 0.0)
            found[self.index] = start
            way = np.abs(driven - start).max()
        if not way <= MOST_PARTS * REACH:
            raise SolverError(
                f'{self.robot.tree.name}: the driven joints must be within '
                f'{MOST_PARTS * REACH:g} rad or m of where they were, got {way:.3g} from there'
            )
        parts = max(1, int(np.ceil(way / REACH)))
        for part in range(1, parts + 1):
            self._close(found, start + (part / parts) * (driven - start))
        q[:] = found

    def _close(self, q: Array, driven: Array) -> None:
        before = q.copy()
        super().positions(q, driven)
        q[self.bound] = before[self.bound]
        q[self.bound] -= self._least @ (self._rows @ (q - before))
        for _ in range(ITERATIONS):
            self._linearize(q)
            error = closure_rows(self.robot, q, self._zero)[0]
            q[self.bound] -= self._least @ error
            if np.abs(error).max() <= NEARLY_CLOSED:
                return
        raise SolverError(
            f'{self.robot.tree.name}: the driven joints must be where the loops close, got '
            f'{np.round(driven, 6).tolist()} with {np.abs(error).max():.3g} m or rad left open'
        )

    def rates(self, qd: Array, driven: Array) -> None:
        """Put rates (driven,) into qd (n,) and with them those they give at the last positions."""
        bound = qd[self.bound]
        super().rates(qd, driven)
        qd[self.bound] = bound
        qd[self.bound] -= self._least @ (self._rows @ qd)

    def accelerations(self, q: Array, qd: Array, qdd: Array, driven: Array) -> None:
        """Put accelerations (driven,) into qdd (n,) and with them those they give."""
        bound = qdd[self.bound]
        super().accelerations(q, qd, qdd, driven)
        qdd[self.bound] = bound
        bias = closure_rows(self.robot, q, qd)[2]
        qdd[self.bound] -= self._least @ (self._rows @ qdd + bias)

    def given_accelerations(self, driven: Array) -> Array:
        """Return the accelerations of the joints `given` by those of the driven ones."""
        return np.asarray(self._ties[self._picked] @ driven)

    def reduce(self, force: Array, out: Array) -> Array:
        """Return the driven joints' torques for generalized forces (n,), at the last positions."""
        multipliers = force[self.bound] @ self._least
        out[:] = force[self.index] - multipliers @ self._rows[:, self.index]
        return out

    def add_friction(self, qd: Array, force: Array) -> None:
        """Add viscous and Coulomb friction of the loops' own joints to a force (n,) in place."""
        add_loop_friction(self.robot, qd, self._axes, force)


def joints_below(tree: Tree, frame: str) -> set[str]:
    """Return the joints between the base and a frame."""
    joints: set[str] = set()
    place = tree.frames[frame].body
    while place >= 0:
        body = tree.bodies[place]
        if body.joint is not None:
            joints.add(body.joint.name)
        place = body.attachment.body
    return joints


def _turns(angles: Array) -> Array:
    """Return the whole turns [rad] nearest to angles [rad]."""
    turn = 2.0 * np.pi
    return np.asarray(turn * np.round(angles / turn))


def driven_motion(
    robot: Robot,
    joints: Sequence[str] | None = None,
    held: Mapping[str, float] | None = None,
    posture: Array | None = None,
    flexible: bool = True,
) -> DrivenMotion:
    """Return the motion of a robot's joints, with its loops if it has any; arguments as there."""
    if robot.tree.loops:
        return LoopedMotion(robot, joints, held, posture, flexible)
    return DrivenMotion(robot, joints, held)
