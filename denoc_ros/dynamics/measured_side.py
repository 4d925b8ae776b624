"""Joints whose states mean the link side: the robot as they see it, and its motors behind.

A joint that is measured behind its spring turns with the link. So the robot that joint states
describe has no spring there, and its effort is what the gear gives out, t. What drives such a
joint is the motor: q = x - s with k s + d s' = -t, and
tau = t + armature q'' + damping q' + friction(q').
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import elasticity
from denoc_ros.model.coordinates import spring_name
from denoc_ros.model.link_side import is_measured_behind, motors_behind, seen_from_links
from denoc_ros.model.tree import Joint, Spring, Tree
from denoc_ros.types import Array

CUTOFF = 100.0  # Hz, of the filter that gives a spring's rate and acceleration
ROUNDS = 5  # of an equilibrium at positions of the link side
SHARE = 0.1  # of the rate of the updates: at most so much


class MeasuredRobot(Robot):
    """A robot without the springs behind which its joints are measured.

    Its `tree` is that of the whole robot, so that overrides reach the springs and the motors.
    """

    @staticmethod
    def _modelled(tree: Tree) -> Tree:
        return seen_from_links(tree)


def measured_robot(robot: Robot) -> Robot:
    """Return the robot that its joint states describe: itself, unless some mean the link side."""
    if isinstance(robot, MeasuredRobot) or seen_from_links(robot.tree) is robot.tree:
        return robot
    seen = MeasuredRobot(robot.tree, robot.gravity, robot.geometric_stiffness)
    seen._take_payloads(robot)
    seen.move_base(robot.base_motion)
    return seen


class MeasuredStates:
    """The motion of a whole robot from joint states.

    Parameters
    ----------
    robot : Robot
        With all its springs.
    """

    def __init__(self, robot: Robot) -> None:
        described = {body.joint.name: body.joint for body in robot.tree.bodies if body.joint}
        behind = [is_measured_behind(described[name]) for name in robot.joint_names]
        self._robot = robot
        self._joints = np.flatnonzero(behind)
        self._index = np.ascontiguousarray(robot.joint_indices)
        self._springs = self._index[self._joints] + 1

    def positions(self, q: Array, out: Array) -> None:
        """Write positions, or rates, (joints,) from those of the coordinates (n,)."""
        out[:] = q[self._index]
        if len(self._joints):
            out[self._joints] += q[self._springs]

    def efforts(self, q: Array, qd: Array, out: Array) -> None:
        """Put what the gears give out into efforts (joints,) of joints measured behind them."""
        if len(self._joints):
            force = elasticity(self._robot, q)[0] + self._robot.damping * qd
            out[self._joints] = -force[self._springs]


def described_coordinates(robot: Robot) -> tuple[str, ...]:
    """Return the coordinates of a robot that what is made of its joint states can have."""
    hidden = {spring_name(joint) for joint in motors_behind(robot.tree)}
    return tuple(name for name in robot.coordinate_names if name not in hidden)


def measured_equilibrium(robot: Robot, joints: Array) -> Array:
    """Return coordinates (n,) in static equilibrium at measured positions (joints,) [rad, m].

    Raises
    ------
    SolverError
        There is no equilibrium there.
    """
    states, seen = MeasuredStates(robot), np.empty(len(joints))
    q = robot.static_deflection(joints)
    states.positions(q, seen)
    for _ in range(ROUNDS):
        if np.array_equal(seen, joints):
            break
        # weight depends on the links, not on the motors behind: each round comes much nearer
        q = robot.static_deflection(q[robot.joint_indices] + joints - seen)
        states.positions(q, seen)
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
        described: dict[str, Joint] = {b.joint.name: b.joint for b in robot.tree.bodies if b.joint}
        behind = [described[name] for name in joints]
        self._at = np.array(
            [k for k, joint in enumerate(behind) if is_measured_behind(joint)], dtype=int
        )
        motors = [behind[k] for k in self._at] if isinstance(robot, MeasuredRobot) else []
        self._at = self._at[: len(motors)]
        self._springs = [joint.spring for joint in motors if joint.spring is not None]
        self._damping = np.array([spring.damping for spring in self._springs])
        self._slip_rate = robot.slip_rate
        self._armature, self._viscous, self._friction = (
            np.array([getattr(joint, name) for joint in motors])
            for name in ('armature', 'damping', 'friction')
        )
        self._deflection, self._rate, self._acceleration = np.zeros((3, len(motors)))
        self._started = False

    def reset(self) -> None:
        """Forget the springs: the next update finds them at rest under the gear's torque."""
        self._started = False

    def add(
        self,
        torque: Array,
        motion: tuple[Array, Array],
        elapsed: float,
        inertia: bool = True,
        friction: bool = True,
    ) -> None:
        """Turn what gears give out into what their motors need (driven joints,), in place.

        Parameters
        ----------
        torque : (driven,) array [N m, N]
        motion : pair of (driven,) arrays
            Desired rates and accelerations of the link side.
        elapsed : float
            s since the last update.
        inertia, friction : bool
            Whether the motor's inertia counts, and its friction.

        Notes
        -----
        A critically damped filter gives s, s' and s'' of the spring from the torque. Its lag is
        twice its time constant; the rate is taken back by so much.
        """
        if not len(self._at):
            return
        self._follow(torque[self._at], elapsed)
        rate = motion[0][self._at] - self._rate
        if friction:
            torque[self._at] += self._viscous * rate
            torque[self._at] += self._friction * np.tanh(rate / self._slip_rate)
        if inertia:
            torque[self._at] += self._armature * (motion[1][self._at] - self._acceleration)

    def _follow(self, torque: Array, elapsed: float) -> None:
        force = -torque - self._damping * self._rate
        wanted = np.array([deflection(s, f) for s, f in zip(self._springs, force, strict=True)])
        if not self._started or elapsed <= 0.0:
            self._filtered = [wanted, 0.0 * wanted]
            self._rate, self._acceleration = 0.0 * wanted, 0.0 * wanted
            self._started = True
            return
        omega = 2.0 * math.pi * min(CUTOFF, SHARE / elapsed)
        s, rate = self._filtered
        # implicit, so that it is stable for any elapsed time
        change = omega**2 * (wanted - s - elapsed * rate) - 2.0 * omega * rate
        acceleration = change / (1.0 + 2.0 * omega * elapsed + (omega * elapsed) ** 2)
        rate = rate + elapsed * acceleration
        self._filtered = [s + elapsed * rate, rate]
        lag = 2.0 / omega
        self._rate = rate + lag * acceleration
        self._acceleration = acceleration


def deflection(spring: Spring, force: float) -> float:
    """Return the deflection at which a spring gives a force, beyond the corners of its play."""
    k, k3 = spring.stiffness, spring.stiffness3
    e = force / k
    for _ in range(20 if k3 > 0.0 else 0):  # Newton's steps from outside: each comes nearer
        e -= (k * e + k3 * e**3 - force) / (k + 3.0 * k3 * e * e)
    return e + math.copysign(0.5 * spring.backlash, force) if force else 0.0
