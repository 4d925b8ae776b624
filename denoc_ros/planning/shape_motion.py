"""The one entry to all methods that plan motions without residual vibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.base.reacting_base import held_robot
from denoc_ros.dynamics.driven.driven_joints import DrivenJoints
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.planning.rest.joint_plans import (
    RestOptions,
    ShaperOptions,
    rest_motion,
    shaper_motion,
    with_spread,
)
from denoc_ros.planning.shapers import impulses
from denoc_ros.planning.tip.reaction import in_free_fall
from denoc_ros.planning.tip.tip import tip_motion
from denoc_ros.planning.tip.tip_options import TipOptions
from denoc_ros.types import Array

BASES = ('free_floating', 'free_flying')


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


OPTIONS: dict[str, type[TipOptions | ShaperOptions]] = {
    'tip': TipOptions,
    **dict.fromkeys(impulses.METHODS, ShaperOptions),
    'rest_to_rest': RestOptions,
}


def _options(method: str, given: Mapping[str, Any]) -> TipOptions | ShaperOptions:
    """Return the options of a method after a check of their names."""
    if method not in OPTIONS:
        raise StateError(
            f'shape_motion: method must be one of {", ".join(OPTIONS)}, got {method!r}'
        )
    known = [field.name for field in fields(OPTIONS[method])]
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise StateError(f'shape_motion: options of {method!r} must be of {known}, got {unknown}')
    return OPTIONS[method](**given)


def shape_motion(
    robot: Robot,
    times: ArrayLike,
    q_joints: ArrayLike,
    method: str = 'tip',
    tip: str | Sequence[str] | None = None,
    **options: Any,
) -> Plan:
    """Plan a motion of a flexible robot without residual vibration.

    Parameters
    ----------
    robot : Robot
        With its gravity and payload as they are set.
    times : (k,) array
        Increasing [s].
    q_joints : (k, joints) array
        Positions of the driven joints of the undeformed robot, in the order of
        `robot.joint_names`, from rest to rest [rad, m]. Mimic joints follow their leaders and have
        no column; a motion with columns of all joints is taken as well.
    method : str
        ``tip``: the tip does what the undeformed robot's would (:class:`TipOptions`). ``zv``,
        ``zvd``, ``ei``: the joints do it through an input shaper, later (:class:`ShaperOptions`).
        ``rest_to_rest``: the joints go from the first to the last posture as they like and every
        mode rests there (:class:`RestOptions`).
    tip : str or sequence of str, optional
        The frames that matter; default ``tool``, or the last link in the file that moves.
    base : str, optional
        By name, as the options. Of a robot whose base floats. ``free_floating``, the default: it
        reacts to the arm, from rest at zero coordinates, and falls freely: gravity has no effect.
        Tips are where they are to be in the world: where those of the undeformed robot would be,
        whose base reacts as well. ``free_flying``: thrusters hold it, and the plan has the wrench
        that takes.
    **options
        What the method takes.

    Returns
    -------
    Plan

    Raises
    ------
    StateError
        For an unknown method, frame or option, a wrong shape, or numbers that are not finite; a
        `base` where none floats.
    SolverError
        No such motion was found; with what is left.
    """
    flies = _flies(robot, options.pop('base', None))
    chosen = _options(method, options)
    at, joints = _motion(robot, times, q_joints)
    planned = held_robot(robot) if flies else in_free_fall(robot)
    frames = tip_frames(planned, tip)
    if isinstance(chosen, TipOptions):
        plan = tip_motion(planned, at, joints, frames, chosen)
    elif isinstance(chosen, RestOptions):
        plan = rest_motion(planned, at, joints, frames, chosen)
    else:
        plan = shaper_motion(method, planned, at, joints, frames, chosen)
    plan = with_spread(planned, plan, frames, chosen)
    return on_thrusters(robot, plan) if flies else plan


def _flies(robot: Robot, base: str | None) -> bool:
    """Say whether thrusters hold a base that would float, after a check."""
    if base is not None and not len(robot.base_indices):
        raise StateError(
            f'shape_motion: base must be None for {robot.tree.name}, whose base does not float, '
            f'got {base!r}'
        )
    if base not in (None, *BASES):
        raise StateError(f'shape_motion: base must be one of {", ".join(BASES)}, got {base!r}')
    return base == 'free_flying'


def _motion(robot: Robot, times: ArrayLike, q_joints: ArrayLike) -> tuple[Array, Array]:
    """Return times (k,) and joints (k, joints) after a check."""
    at, joints = np.array(times, dtype=np.float64), np.array(q_joints, dtype=np.float64)
    if at.ndim != 1 or len(at) < 2 or not np.isfinite(at).all() or (np.diff(at) <= 0.0).any():
        raise StateError(
            f'shape_motion: times must be two or more finite ones that increase, got {at.shape}'
        )
    loops = bool(robot.tree.loops)
    driven = robot.joint_names if loops else robot.tree.non_mimic_joints
    if joints.shape == (len(at), len(driven)) and not loops:
        joints = DrivenJoints(robot, 'shape_motion').all(joints)
    shape = (len(at), len(robot.joint_names))
    if joints.shape != shape:
        raise StateError(
            f'shape_motion: q_joints must have shape {(len(at), len(driven))} '
            f'(times, driven joints {list(driven)}), got {joints.shape}'
        )
    if not np.isfinite(joints).all():
        row, column = np.argwhere(~np.isfinite(joints))[0]
        raise StateError(
            f'shape_motion: q_joints must be finite, got {joints[row, column]} of '
            f'{robot.joint_names[column]!r} at {at[row]:.4g} s'
        )
    return at, joints


def tip_frames(robot: Robot, tip: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the frames that matter, all known."""
    known = tuple(robot.frame_names)
    if tip is None:
        return (_last_frame(robot),)
    frames = (tip,) if isinstance(tip, str) else tuple(tip)
    unknown = [frame for frame in frames if frame not in known]
    if unknown or not frames or len(set(frames)) != len(frames):
        raise StateError(
            f'shape_motion: tip must be different frames of {", ".join(known)}, got {frames}'
        )
    return frames


def _last_frame(robot: Robot) -> str:
    """Return ``tool``, or the last link of the file that a joint moves."""
    links = [name for name in robot.frame_names if '/' not in name]
    if 'tool' in links:
        return 'tool'
    still = np.zeros(robot.n)
    own = np.setdiff1d(np.arange(robot.n), robot.base_indices)
    moving = [name for name in links if robot.frame_jacobian(name, still)[:, own].any()]
    return moving[-1] if moving else links[-1]
