"""Joints whose states mean the link side: the robot as they see it, and its motors behind.

A joint that is measured behind its spring turns with the link. So the robot that joint states
describe has no spring there, and its effort is what the gear gives out, t. What drives such a
joint is the motor: q = x - s with k s + d s' = -t, and
tau = t + armature q'' + damping q' + friction(q').
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import GearSprings, deflection, elasticity
from denoc_ros.model.coordinates import names, spring_name
from denoc_ros.model.joint_friction import Friction
from denoc_ros.model.link_side import is_measured_behind, motors_behind, seen_from_links
from denoc_ros.model.tree import Tree
from denoc_ros.types import Array


class LinkEncoderRobot(Robot):
    """A robot without the springs behind which its joints are measured.

    Its `tree` is that of the whole robot, so that overrides reach the springs and the motors.
    """

    @staticmethod
    def _modelled(tree: Tree) -> Tree:
        return seen_from_links(tree)


def measured_robot(robot: Robot) -> Robot:
    """Return the robot that its joint states describe: itself, unless some mean the link side."""
    if isinstance(robot, LinkEncoderRobot) or seen_from_links(robot.tree) is robot.tree:
        return robot
    seen = LinkEncoderRobot(robot.tree, robot.gravity, robot.geometric_stiffness)
    seen._take_payloads(robot)
    seen.move_base(robot.base_motion)
    return seen


def whole_robot(robot: Robot) -> Robot:
    """Return the robot with all its springs that :func:`measured_robot` has made another of."""
    if not isinstance(robot, LinkEncoderRobot):
        return robot
    whole = Robot(robot.tree, robot.gravity, robot.geometric_stiffness)
    whole._take_payloads(robot)
    whole.move_base(robot.base_motion)
    return whole


class MeasuredStates:
    """Map from joint states to the motion of a whole robot.

    Parameters
    ----------
    robot : Robot
        With all its springs.
    joints : sequence of str, optional
        In the order of all arrays here; default all.

    Attributes
    ----------
    index : (joints,) array of int
        Coordinates of the joints.
    any_behind : bool
        Whether there are joints that are measured behind their springs.
    """

    def __init__(self, robot: Robot, joints: Sequence[str] | None = None) -> None:
        names_of = robot.joint_names if joints is None else joints
        behind = [is_measured_behind(robot.tree.joints[name]) for name in names_of]
        self._robot = robot
        self._joints = np.flatnonzero(behind)
        self.any_behind = any(behind)
        self.index = np.asarray(robot.indices(names_of), dtype=np.intp)
        self._springs = self.index[self._joints] + 1

    def positions(self, q: Array, out: Array) -> None:
        """Write positions, or rates, (joints,) from those of the coordinates (n,)."""
        out[:] = q[self.index]
        if self.any_behind:
            out[self._joints] += q[self._springs]

    def posture(self, q: Array) -> Array:
        """Return the positions, or rates, (joints,) of those of the coordinates (n,)."""
        found = np.zeros(len(self.index))
        self.positions(q, found)
        return found

    def efforts(self, q: Array, qd: Array, out: Array) -> None:
        """Write the gears' output torque into efforts (joints,) of joints measured behind them."""
        if self.any_behind:
            force = elasticity(self._robot, q)[0] + self._robot.damping * qd
            out[self._joints] = -force[self._springs]


def described_coordinates(robot: Robot) -> tuple[str, ...]:
    """Coordinates of a robot that are observable through its joint states."""
    hidden = {spring_name(joint) for joint in motors_behind(robot.tree)}
    return tuple(name for name in robot.coordinate_names if name not in hidden)


class WholeCoordinates:
    """The coordinates of a whole robot from those that its joint states describe.

    Parameters
    ----------
    robot : Robot
        As :func:`measured_robot` gives it, or any other.

    Attributes
    ----------
    names : tuple of str
        All coordinates, with the springs behind which joints are measured.
    hidden : tuple of str
        Joints with such a spring, in the order of all arrays of springs here.
    """

    def __init__(self, robot: Robot) -> None:
        seen = isinstance(robot, LinkEncoderRobot)
        joints = robot.tree.joints.values()
        behind = [joint for joint in joints if seen and is_measured_behind(joint)]
        self.springs = [joint.spring for joint in behind if joint.spring is not None]
        self.hidden = tuple(joint.name for joint in behind)
        self.names = tuple(names(robot.tree)[0]) if behind else robot.coordinate_names
        springs = [spring_name(name) for name in self.hidden]
        self._described, self._motors, self._springs = (
            np.array([self.names.index(name) for name in some], dtype=np.intp)
            for some in (robot.coordinate_names, self.hidden, springs)
        )
        self.places = [robot.coordinate_names.index(name) for name in self.hidden]

    def write(self, described: Array, springs: Array, out: Array) -> None:
        """Write coordinates (..., all) from those described (..., n) and of springs.

        The motor's side is that of the link less the spring. Rates alike.
        """
        out[..., self._described] = described
        out[..., self._motors] -= springs
        out[..., self._springs] = springs


def measured_equilibrium(robot: Robot, joints: Array) -> Array:
    """Return coordinates (n,) in static equilibrium at measured positions (joints,) [rad, m].

    A spring with play stands beyond its corners, which are sharp here.

    Raises
    ------
    SolverError
        There is no equilibrium there.
    """
    seen = measured_robot(robot)
    if seen is robot:
        return robot.static_deflection(joints)
    # weight depends on the links, not on the motors behind: it tells what the gears carry
    bent, still = seen.static_deflection(joints), np.zeros(seen.n)
    force, whole = seen.inverse_dynamics(bent, still, still), WholeCoordinates(seen)
    carried = zip(whole.springs, force[whole.places], strict=True)
    springs = np.array([deflection(spring, -torque) for spring, torque in carried])
    q = np.zeros(robot.n)
    whole.write(bent, springs, q)
    return q


class MotorSide:
    """The motors of driven joints that are measured, and move as desired, behind their springs.

    Parameters
    ----------
    robot : Robot
        As :func:`measured_robot` gives it.
    joints : sequence of str
        The driven joints, in the order of all arrays here.
    """

    def __init__(self, robot: Robot, joints: Sequence[str]) -> None:
        behind = [robot.tree.joints[name] for name in joints]
        self._at = np.array(
            [k for k, joint in enumerate(behind) if is_measured_behind(joint)], dtype=int
        )
        motors = [behind[k] for k in self._at] if isinstance(robot, LinkEncoderRobot) else []
        self._at = self._at[: len(motors)]
        self._springs = GearSprings([joint.spring for joint in motors if joint.spring])
        self._whole = WholeCoordinates(robot)
        hidden = self._whole.hidden
        self._places = np.array([hidden.index(joint.name) for joint in motors], dtype=int)
        self._wound = np.zeros(len(hidden))
        self._armature, viscous, coulomb = (
            np.array([getattr(joint, name) for joint in motors])
            for name in ('armature', 'damping', 'friction')
        )
        self._friction = Friction(viscous, coulomb)

    @property
    def any(self) -> bool:
        """Whether there are such motors."""
        return len(self._at) > 0

    def reset(self) -> None:
        """Forget the springs: the next update finds them at rest under the gear's torque."""
        self._springs.reset()

    def add(
        self,
        torque: Array,
        motion: tuple[Array, Array],
        elapsed: float,
        inertia: bool = True,
        friction: bool = True,
    ) -> None:
        """Convert gear torque to motor torque (driven joints,), in place.

        Parameters
        ----------
        torque : (driven,) array [N m, N]
        motion : pair of (driven,) arrays
            Desired rates and accelerations of the link side.
        elapsed : float
            s since the last update.
        inertia, friction : bool
            Whether the motor's inertia counts, and its friction.
        """
        if not len(self._at):
            return
        springs = self._springs
        springs.follow(torque[self._at], elapsed)
        rate = motion[0][self._at] - springs.rate
        torque[self._at] += self._own(
            rate, motion[1][self._at] - springs.acceleration, inertia, friction
        )

    def whole_motion(self, motion: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Return q, q' and q'' of the whole robot from (n,) arrays that joint states describe.

        Springs of joints that are not driven count as undeformed. Without springs behind which
        joints are measured, the arrays themselves are returned.
        """
        if not self._whole.hidden:
            return motion
        springs = self._springs
        known = springs.deflection, springs.rate, springs.acceleration
        found = np.zeros((3, len(self._whole.names)))
        for out, described, spring in zip(found, motion, known, strict=True):
            self._wound[self._places] = spring
            self._whole.write(described, self._wound, out)
        return found[0], found[1], found[2]

    def take_off(self, torque: Array, motion: tuple[Array, Array]) -> None:
        """Convert motor torque (driven joints,) to gear torque, in place.

        Parameters
        ----------
        torque : (driven,) array [N m, N]
        motion : pair of (driven,) arrays
            Rates and accelerations of the link side, which those of the motors are taken for.
        """
        if len(self._at):
            rate, acceleration = motion[0][self._at], motion[1][self._at]
            torque[self._at] -= self._own(rate, acceleration, inertia=True, friction=True)

    def driven_by(self, torque: Array, motion: tuple[Array, Array]) -> Array:
        """Motor torque (..., driven) for a gear torque.

        Parameters
        ----------
        torque : (..., driven) array [N m, N]
        motion : pair of (..., driven) arrays
            Rates and accelerations of the link side, which those of the motors are taken for.
        """
        found = np.array(torque, dtype=np.float64)
        if len(self._at):
            rate, acceleration = motion[0][..., self._at], motion[1][..., self._at]
            found[..., self._at] += self._own(rate, acceleration, inertia=True, friction=True)
        return found

    def _own(self, rate: Array, acceleration: Array, inertia: bool, friction: bool) -> Array:
        """Torque of the motors' own inertia and friction."""
        needed = np.zeros_like(rate)
        if friction:
            needed += self._friction.force(rate)
        if inertia:
            needed += self._armature * acceleration
        return needed
