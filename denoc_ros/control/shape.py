"""One door to all ways of planning motions that leave no swing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.control.plan import Plan
from denoc_ros.control.tip import TipOptions, tip_motion
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError

Array = NDArray[np.float64]
Planner = Callable[..., Plan]  # (robot, times, q_joints, tip frames, **options)


def _tip(
    robot: Robot, times: Array, q_joints: Array, frames: tuple[str, ...], **options: Any
) -> Plan:
    known = [field.name for field in fields(TipOptions)]
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise StateError(f"shape_motion: options of 'tip' must be of {known}, got {unknown}")
    return tip_motion(robot, times, q_joints, frames, TipOptions(**options))


METHODS: dict[str, Planner] = {'tip': _tip}


def shape_motion(
    robot: Robot,
    times: ArrayLike,
    q_joints: ArrayLike,
    method: str = 'tip',
    tip: str | Sequence[str] | None = None,
    **options: Any,
) -> Plan:
    """Plan a motion of a flexible robot that ends without swing.

    Parameters
    ----------
    robot : Robot
        With its gravity and payload as they are set.
    times : (k,) array
        Increasing [s].
    q_joints : (k, joints) array
        Joint positions of the undeformed robot, in the order of `robot.joint_names`, from rest to
        rest [rad, m].
    method : str
        ``tip``: the tip does what the undeformed robot's would (:class:`TipOptions`).
    tip : str or sequence of str, optional
        The frames that matter; default ``tool``, or the last one of the robot.
    **options
        What the method takes.

    Returns
    -------
    Plan

    Raises
    ------
    StateError
        For an unknown method, frame or option, a wrong shape, or numbers that are not finite.
    SolverError
        No such motion was found; with what is left.
    """
    planner = METHODS.get(method)
    if planner is None:
        raise StateError(
            f'shape_motion: method must be one of {", ".join(METHODS)}, got {method!r}'
        )
    at, joints = _motion(robot, times, q_joints)
    return planner(robot, at, joints, _frames(robot, tip), **options)


def _motion(robot: Robot, times: ArrayLike, q_joints: ArrayLike) -> tuple[Array, Array]:
    """Return times (k,) and joints (k, joints) after a check."""
    at, joints = np.array(times, dtype=np.float64), np.array(q_joints, dtype=np.float64)
    if at.ndim != 1 or len(at) < 2 or not np.isfinite(at).all() or (np.diff(at) <= 0.0).any():
        raise StateError(
            f'shape_motion: times must be two or more finite ones that increase, got {at.shape}'
        )
    shape = (len(at), len(robot.joint_names))
    if joints.shape != shape or not np.isfinite(joints).all():
        raise StateError(
            f'shape_motion: q_joints must be finite and have shape {shape} (times, joints), got '
            f'{joints.shape}'
        )
    return at, joints


def _frames(robot: Robot, tip: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the frames that matter, all known."""
    known = tuple(robot.lowered.frame_rows)
    if tip is None:
        return ('tool',) if 'tool' in known else (known[-1],)
    frames = (tip,) if isinstance(tip, str) else tuple(tip)
    unknown = [frame for frame in frames if frame not in known]
    if unknown or not frames or len(set(frames)) != len(frames):
        raise StateError(
            f'shape_motion: tip must be different frames of {", ".join(known)}, got {frames}'
        )
    return frames
