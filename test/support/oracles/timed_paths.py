"""Random paths of rigid arms, and their least times by TOPP-RA with Pinocchio's dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio
import toppra
from control_runs import ROBOTS, cycloid
from panda_strip import panda
from scipy.interpolate import CubicSpline
from toppra import algorithm, constraint

import denoc_ros as dn
from denoc_ros.model.joint_friction import SLIP_RATE
from denoc_ros.types import Array

PLACES = np.linspace(0.0, 1.0, 5)  # of the points of a path
TIMES = np.linspace(0.0, 5.0, 401)
GRID = 401  # of TOPP-RA
COULOMB, VISCOUS = 0.05, 0.15  # of the effort limit; viscous at the velocity limit
SHARES = {  # of the file's effort limits, so that they bind
    'ur10': np.array([0.4, 0.5, 0.5, 0.1, 0.1, 0.1]),
    'panda': np.array([0.5, 0.7, 0.5, 0.5, 0.3, 0.3, 0.2]),
}


@dataclass(frozen=True)
class RigidArm:
    """A rigid arm with its limits, in this package and in Pinocchio.

    Attributes
    ----------
    robot : Robot
    peer : pinocchio.Model
        Of the same file, without friction.
    middle, velocity, effort : (joints,) arrays
    viscous, coulomb : (joints,) arrays
        Of the joints [N m s, N m].
    """

    robot: dn.Robot
    peer: pinocchio.Model
    middle: Array
    velocity: Array
    effort: Array
    viscous: Array
    coulomb: Array

    def path(self, seed: int) -> CubicSpline:
        """Return a random path (joints,) over 0 to 1."""
        way = np.random.default_rng(seed).uniform(-1.0, 1.0, (len(PLACES), self.robot.n))
        return CubicSpline(PLACES, self.middle + 0.7 * way)

    def fastest(self, seed: int) -> dn.Plan:
        """Return the plan of a random path in minimum time."""
        share = cycloid(np.zeros(1), np.ones(1), TIMES[-1])(TIMES)[:, 0]
        path = self.path(seed)(share)
        return dn.shape_motion(
            self.robot, TIMES, path, effort=self.effort, velocity=self.velocity, time='minimum'
        )

    def torques(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return Pinocchio's torques (joints,) without friction."""
        return np.asarray(pinocchio.rnea(self.peer, self.peer.createData(), q, qd, qdd))

    def largest_share(self, plan: dn.Plan) -> float:
        """Return the largest share of a limit in a plan, with Pinocchio's torques."""
        rows = zip(plan.q, plan.qd, plan.qdd, strict=True)
        torque = np.array([self.torques(*row) for row in rows])
        torque += self.viscous * plan.qd + self.coulomb * np.tanh(plan.qd / SLIP_RATE)
        parts = np.abs(torque) / self.effort, np.abs(plan.qd) / self.velocity
        return float(max(part.max() for part in parts))

    def toppra_duration(self, seed: int) -> float:
        """Return the least time of a random path by TOPP-RA [s], infinite where it finds none.

        Its torques are linear in the squared pace: viscous friction has no place among them and
        is kept free, as large as it is at the limit of velocity.
        """
        room = self.effort - self.viscous * self.velocity
        limits = [
            constraint.JointVelocityConstraint(np.stack([-self.velocity, self.velocity], 1)),
            constraint.JointTorqueConstraint(
                partial(pinocchio.rnea, self.peer, self.peer.createData()),
                np.stack([-room, room], 1),
                self.coulomb,
                discretization_scheme=constraint.DiscretizationType.Interpolation,
            ),
        ]
        path = toppra.SplineInterpolator(PLACES, self.path(seed)(PLACES))
        theirs = algorithm.TOPPRA(limits, path, np.linspace(0.0, 1.0, GRID))
        found = theirs.compute_trajectory(0, 0)
        return np.inf if found is None else float(found.duration)


def rigid_arm(name: str, friction: bool = False) -> RigidArm:
    """Return the `ur10` or the `panda`, without friction or with both kinds of it."""
    text = (ROBOTS / 'ur10.urdf').read_text() if name == 'ur10' else panda()
    robot = dn.load_robot(text)
    limits = [body.joint.limits for body in robot.tree.bodies if body.joint is not None]
    velocity = np.array([each.velocity for each in limits])
    effort = SHARES[name] * [each.effort for each in limits]
    middle = np.array([0.5 * (each.lower + each.upper) for each in limits])
    viscous, coulomb = friction * VISCOUS * effort / velocity, friction * COULOMB * effort
    changes = {
        f'joint.{joint}.{what}': value
        for what, values in (('damping', viscous), ('friction', coulomb))
        for joint, value in zip(robot.joint_names, values.tolist(), strict=True)
    }
    peer = pinocchio.buildModelFromXML(text)
    robot = robot.with_overrides(changes)
    return RigidArm(robot, peer, middle, velocity, effort, viscous, coulomb)
