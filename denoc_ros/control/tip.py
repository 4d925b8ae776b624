"""Tip-exact motions: joints and links move so that the tip follows a stiff robot's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from denoc_ros.control.asked_motion import AskedMotion
from denoc_ros.control.limit_rows import LimitRows
from denoc_ros.control.plan import Plan
from denoc_ros.control.stretching import within_limits
from denoc_ros.control.tip_grid import Int, TipGrids, turn_weight
from denoc_ros.control.tip_minimum_time import fastest
from denoc_ros.control.tip_options import TipOptions
from denoc_ros.control.tip_path import checked_path, joints_along
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array

CLOSED = 1e-9  # m, rad: loops of the asked motion that are closed as they are
POINTS = 10  # of a motion: with fewer, its rates at the ends are not known
MOVING = 0.1  # of the largest rate: more is no rest
STANDS = 1e-9  # rad/s, m/s: what rounding leaves of joints that stand still


def tip_motion(
    robot: Robot,
    times: Array,
    q_joints: Array,
    frames: Sequence[str],
    options: TipOptions,
) -> Plan:
    """Return the plan of a tip-exact motion (see :func:`denoc_ros.shape_motion`).

    Parameters
    ----------
    robot : Robot
    times : (k,) array
        Increasing [s].
    q_joints : (k, joints) array
        Of the undeformed robot, from rest to rest.
    frames : sequence of str
        Those that are to be where the undeformed robot would have them.
    options : TipOptions
    """
    driven = robot.indices(options.joints or robot.tree.non_mimic_joints)
    path = None
    if options.path is not None:
        poses = checked_path(options.path, frames, len(times))
        turn = turn_weight(robot, driven, poses, options)
        q_joints = joints_along(robot, frames, poses, q_joints[0], turn)
        path = dict(zip(frames, poses, strict=True)) if len(robot.base_indices) else None
    joints = _closed(robot, driven, q_joints)
    _require_rest(robot, times, joints)
    limits = options.limits(robot)
    rows = LimitRows(robot, driven, tuple(frames), limits)
    grids = TipGrids(robot, frames, driven, options)

    def asked(stretch: float) -> AskedMotion:
        return AskedMotion(robot, stretch * (times - times[0]), joints, path)

    def plan(stretch: float) -> Plan:
        motion = asked(stretch)
        return replace(grids.plan(grids.solve(motion), motion), stretch=stretch)

    if options.time == 'minimum':
        made = fastest(grids, asked(1.0), rows)
    else:
        made = within_limits(robot, plan, rows, options.stretch)
    if options.progress is not None:
        options.progress(1.0)
    return replace(made, t=made.t + times[0])


def _require_rest(robot: Robot, times: Array, joints: Array) -> None:
    """Raise StateError where a motion (k, joints) of at least `POINTS` begins or ends fast.

    A plan rests at both ends; a motion that does not would be bent to rest within a few points.
    """
    if len(times) < POINTS:
        return
    rates = make_interp_spline(times, joints, k=5)(times, 1)
    fastest = float(np.abs(rates).max(initial=0.0))
    for place, row in (('begin', 0), ('end', -1)):
        joint = int(np.abs(rates[row]).argmax())
        if abs(rates[row, joint]) > max(MOVING * fastest, STANDS):
            raise StateError(
                f'shape_motion: q_joints must {place} at rest, got {rates[row, joint]:.3g} rad/s '
                f'(or m/s) of {robot.joint_names[joint]}'
            )


def _closed(robot: Robot, driven: Int, joints: Array) -> Array:
    """Return the joints (k, joints) with loops closed and mimic joints on their leaders.

    Driven joints stay; the others start from where they are given.
    """
    if not robot.constraint_names:
        return joints
    q = np.zeros((len(joints), robot.n))
    q[:, robot.joint_indices] = joints
    fixed = [robot.coordinate_names[k] for k in driven]
    open_rows = np.flatnonzero(np.abs(robot.closure(q)).max(axis=1) > CLOSED)
    for row in open_rows:
        q[row] = robot.assemble(q[row], fixed=fixed)
        q[row, robot.flexible_indices] = 0.0
    return np.asarray(q[:, robot.joint_indices])
