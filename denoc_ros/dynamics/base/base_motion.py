"""A base that moves: its twist and acceleration, and where gravity then points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.validation import as_states, require_finite
from denoc_ros.errors import StateError
from denoc_ros.types import Array

Base = Sequence[Any]  # (twist, acceleration) or (twist, acceleration, pose)
Result = TypeVar('Result')
# arguments of verbs that may be rows of states
STATES = ('q', 'qd', 'qdd', 'tau', 'q_joints', 'qdd_joints', 'qdd_actuated')
ORTHONORMAL = 1e-6  # of a pose's rotation: what a message's float32 or a rounded matrix leaves


class BaseMotion(NamedTuple):
    """Motion of a robot's base frame, in its own axes; a plain tuple works as well.

    Attributes
    ----------
    twist : (6,) or (k, 6)
        Velocity of the base frame's origin and angular velocity [m/s, rad/s], in base axes.
    acceleration : (6,) or (k, 6)
        Classical acceleration of the base frame's origin (the second derivative of its position,
        without gravity) and angular acceleration [m/s^2, rad/s^2], in base axes.
    pose : (4, 4) or (k, 4, 4), optional
        The base frame seen from the world. Gravity is then given in world axes, and potential
        energy is zero at the world's origin. Without a pose gravity stays as it is in base axes.
    """

    twist: Array
    acceleration: Array
    pose: Array | None = None

    @property
    def rows(self) -> int | None:
        """Number of rows; None for one motion."""
        counts = [len(self.twist)] if self.twist.ndim == 2 else []
        counts += [len(self.acceleration)] if self.acceleration.ndim == 2 else []
        counts += [len(self.pose)] if self.pose is not None and self.pose.ndim == 3 else []
        if len(set(counts)) > 1:
            raise StateError(
                f'base: twist, acceleration and pose must have the same number of rows, '
                f'got {counts}'
            )
        return counts[0] if counts else None

    def for_kernels(self) -> tuple[Array, Array, Array | None]:
        """Return twist, acceleration and the rotation to world axes of one motion."""
        return self.twist, self.acceleration, None if self.pose is None else self.pose[:3, :3]

    def row(self, k: int) -> BaseMotion:
        """Return the motion of one row."""
        pose = self.pose
        return BaseMotion(
            self.twist[k] if self.twist.ndim == 2 else self.twist,
            self.acceleration[k] if self.acceleration.ndim == 2 else self.acceleration,
            pose[k] if pose is not None and pose.ndim == 3 else pose,
        )


AT_REST = BaseMotion(np.zeros(6), np.zeros(6))


def as_base_motion(base: Base) -> BaseMotion:
    """Return a base's motion after a check.

    Parameters
    ----------
    base : (twist, acceleration) or (twist, acceleration, pose)

    Raises
    ------
    StateError
        For another number of parts, a wrong shape, or a number that is not finite.
    """
    if not isinstance(base, Sequence) or len(base) not in (2, 3):
        got = f'{len(base)} parts' if isinstance(base, Sequence) else f'{base!r}'
        raise StateError(
            f'base must be (twist, acceleration) or (twist, acceleration, pose), got {got}'
        )
    twist = as_states('base twist', base[0], 6)
    acceleration = as_states('base acceleration', base[1], 6)
    pose = base[2] if len(base) == 3 else None
    return BaseMotion(twist, acceleration, None if pose is None else _as_pose(pose))


def _as_pose(value: ArrayLike) -> Array:
    pose = np.asarray(value, dtype=np.float64)
    if pose.shape[-2:] != (4, 4) or pose.ndim not in (2, 3):
        raise StateError(f'base pose must have shape (4, 4) or (k, 4, 4), got {pose.shape}')
    require_finite({'base pose': pose})
    rotation = pose[..., :3, :3]
    error = float(np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(initial=0.0))
    if error > ORTHONORMAL or float(np.linalg.det(rotation).min(initial=1.0)) < 0.0:
        raise StateError(f'base pose must have a proper rotation, got one off by {error:.3g}')
    return pose


class HasBase(Protocol):
    """A robot whose base can be moved."""

    @property
    def base_motion(self) -> BaseMotion | None:
        """The present motion of the base; None: it is at rest."""

    def move_base(self, base: Base | None) -> None:
        """Set the motion of the base for every verb from now on."""


def on_base(robot: HasBase, verb: Callable[..., Result], given: Mapping[str, Any]) -> Result:
    """Return a verb's result under a base motion; the previous base motion is then restored.

    Parameters
    ----------
    given : mapping of str
        Its arguments by name, as locals() has them at its start: `self` is left out, and `base`,
        (twist, acceleration[, pose]): one motion, or one for each row of the states.
    """
    options = {name: value for name, value in given.items() if name not in ('self', 'base')}
    motion, before = as_base_motion(given['base']), robot.base_motion
    count = motion.rows
    try:
        if not count:
            robot.move_base(motion if count is None else None)
            return verb(**options)
        return cast('Result', _each_row(robot, motion, count, verb, options))
    finally:
        robot.move_base(before)


def _each_row(
    robot: HasBase,
    motion: BaseMotion,
    count: int,
    verb: Callable[..., Any],
    options: dict[str, Any],
) -> Any:
    """Return the verb's results of each row with its own motion of the base, stacked."""
    states = {name: np.asarray(options[name]) for name in STATES if options.get(name) is not None}
    split = {name: state for name, state in states.items() if state.ndim == 2}
    lengths = {len(state) for state in split.values()}
    if lengths - {count}:
        raise StateError(
            f'base and states must have the same number of rows, got {count} and {sorted(lengths)}'
        )
    out = options.pop('out', None)
    rows = []
    for k in range(count):
        robot.move_base(motion.row(k))
        rows.append(verb(**options | {name: state[k] for name, state in split.items()}))
    return _stacked(rows, out)


def _stacked(rows: Sequence[Any], out: Any) -> Any:
    if not isinstance(rows[0], tuple):
        return np.stack(rows, out=out)
    given = [None] * len(rows[0]) if out is None else out
    parts = [
        np.stack(part, out=one) for part, one in zip(zip(*rows, strict=True), given, strict=True)
    ]
    kind: Any = type(rows[0])
    return kind(*parts) if hasattr(kind, '_fields') else tuple(parts)
