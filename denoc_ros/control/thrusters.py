"""A plan of a robot whose floating base thrusters hold: the wrench that takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from denoc_ros.control.plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array


def on_thrusters(robot: Robot, plan: Plan) -> Plan:
    """Return a plan of the held robot as one of the floating robot, at zero base coordinates.

    Parameters
    ----------
    robot : Robot
        With its floating base.
    plan : Plan
        Of the same robot, its base held (:func:`held_robot`).
    """
    names = list(robot.coordinate_names)
    columns = [names.index(name) for name in plan.coordinate_names]
    motion = q, qd, qdd = np.zeros((3, len(plan.t), robot.n))
    for whole, part in zip(motion, (plan.q, plan.qd, plan.qdd), strict=True):
        whole[:, columns] = part
    wrench = _wrench(robot, robot.inverse_dynamics(q, qd, qdd))
    return replace(plan, q=q, qd=qd, qdd=qdd, coordinate_names=tuple(names), base_wrench=wrench)


def _wrench(robot: Robot, force: Array) -> Array:
    """Return the wrenches (k, 6) of generalized forces (k, n) at zero base coordinates.

    As :meth:`Robot.base_wrench`; there the rotation vector's Jacobian is one.
    """
    still = np.zeros(robot.n)
    turn = robot.base_odometry(still, still)[0][:3, :3]
    own = force[:, robot.base_indices]
    return np.concatenate([own[:, :3] @ turn.T, own[:, 3:] @ turn.T], axis=1)
