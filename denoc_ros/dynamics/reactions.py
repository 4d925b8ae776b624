"""Reactions: the wrenches that joints and loops transmit, in the base frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import with_motors
from denoc_ros.kernels.dynamics import world
from denoc_ros.kernels.layout import constraint_layout
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.model.loop_constraints import directions
from denoc_ros.types import Array


class Reactions(NamedTuple):
    """Wrenches and where they act.

    joints: (bodies, 6), what carries a body exerts on it, at `origins` (bodies, 3);
    loops: (loops, 6), a loop's parent exerts on its child, at `pins` (loops, 3).
    All in the base frame, linear first [N, N m], [m].
    """

    origins: Array
    joints: Array
    pins: Array
    loops: Array


def reactions(
    robot: Robot, q: Array, qd: Array, qdd: Array, multipliers: Array | None = None
) -> Reactions:
    """Return the wrenches that a motion takes.

    Parameters
    ----------
    q, qd, qdd : (n,) arrays
    multipliers : (rows,) array, optional
        Of the loops; needed where there are any.

    Returns
    -------
    Reactions
        Bodies in the order of `robot.tree.bodies`, loops in file order.

    Notes
    -----
    The recursion's inward pass leaves, at each body, the wrench that it and all beyond it need
    (book, section 3.2). What loops give on the way is taken off.
    """
    robot = with_motors(robot)
    robot.inverse_dynamics(q, qd, qdd)
    starts = robot.arrays.topology[1 : robot.arrays.bodies + 1, at_.WORK].astype(int)
    work = robot.work
    needed = np.array(
        [
            work[
                [
                    *range(k + at_.FORCE, k + at_.FORCE + 3),
                    *range(k + at_.TORQUE, k + at_.TORQUE + 3),
                ]
            ]
            for k in starts
        ]
    )
    world.place_bodies(robot.handle, q)
    turns = np.array([work[k + at_.WORLD_ROTATION :][:9].reshape(3, 3) for k in starts])
    origins = np.array([work[k + at_.WORLD_POSITION :][:3] for k in starts])
    joints = np.einsum('bij,bkj->bki', turns, needed.reshape(-1, 2, 3)).reshape(-1, 6)
    pins, loops = _loop_wrenches(robot, q, multipliers)
    for loop, pin, wrench in zip(robot.tree.loops, pins, loops, strict=True):
        for frame, sign in ((loop.child.frame, 1.0), (loop.parent.frame, -1.0)):
            row = int(robot.arrays.topology[robot.arrays.frame_rows[frame], at_.PARENT])
            while row > 0:
                arm = pin - origins[row - 1]
                moment = wrench[3:] + np.cross(arm, wrench[:3])
                joints[row - 1] -= sign * np.concatenate([wrench[:3], moment])
                row = int(robot.arrays.topology[row, at_.PARENT])
    own = np.array(robot.arrays.body_rows, dtype=int) - 1
    return Reactions(origins[own], joints[own], pins, loops)


def _loop_wrenches(robot: Robot, q: Array, multipliers: Array | None) -> tuple[Array, Array]:
    loops = robot.tree.loops
    pins, wrenches = np.zeros((len(loops), 3)), np.zeros((len(loops), 6))
    row = 0
    for k, loop in enumerate(loops):
        assert multipliers is not None
        parent, child = (robot.frame_pose(end.frame, q) for end in (loop.parent, loop.child))
        kind, linear, angular, _ = directions(loop)
        force, moment = linear.T, parent[:3, :3] @ angular.T
        if kind == constraint_layout.UNIVERSAL:
            assert loop.axis is not None
            assert loop.axis2 is not None
            across = np.cross(parent[:3, :3] @ loop.axis, child[:3, :3] @ loop.axis2)
            moment = (across / np.linalg.norm(across))[:, None]
        parts = (parent[:3, :3] @ force, moment)
        pins[k] = child[:3, 3]
        for part, columns in zip((slice(0, 3), slice(3, 6)), parts, strict=True):
            end = row + columns.shape[1]
            wrenches[k, part] = columns @ multipliers[row:end]
            row = end
    return pins, wrenches
