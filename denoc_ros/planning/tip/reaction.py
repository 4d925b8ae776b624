"""Motion of a floating base as the undeformed robot moves its joints at zero momentum."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import left_jacobians, rotation_vectors, rotations
from denoc_ros.errors import SolverError
from denoc_ros.types import Array

FARTHEST = 5.0  # rad that a base may turn in a plan: at 2 pi a rotation vector is singular
STEPS = 400  # of the integration, at least
LONGEST_STEP = 0.02  # s
GAUSS = np.sqrt(3.0) / 6.0  # from the middle of a step to the points where rates are taken


def in_free_fall(robot: Robot) -> Robot:
    """Return a copy; with a floating base it falls freely: gravity does nothing to it."""
    own = robot.copy()
    if len(own.base_indices):
        own.move_base((np.zeros(6), np.append(own.gravity, np.zeros(3))))
    return own


def base_gain(robot: Robot, q: Array) -> Array:
    """Return G (k, 6, n): the base's rates are G times all others', without momentum.

    Its columns of the base are zero.
    """
    base = robot.base_indices
    rows = robot.inertia_matrix(q)[:, base]
    gain: Array = np.asarray(-np.linalg.solve(rows[:, :, base], rows))
    gain[:, :, base] = 0.0
    return gain


def base_change(robot: Robot, before: Array, after: Array) -> Array:
    """Return how a floating base (6,) reacts to a small change of all others, (n,) each."""
    return np.asarray(base_gain(robot, before[None])[0] @ (after - before))


def reaction(
    robot: Robot, motion: Callable[[Array, int], Array], duration: float
) -> tuple[Array, Array]:
    """Return times (k,) and the base's coordinates (k, 6) during a motion of the joints.

    The robot is undeformed; its base starts at zero coordinates, without momentum.

    Parameters
    ----------
    robot : Robot
    motion : callable
        Takes times (k,) and 0 or 1: joints (k, joints) [rad, m], or their rates.
    duration : float
        s.

    Raises
    ------
    SolverError
        The base turns by more than `FARTHEST`.

    Notes
    -----
    The base's twist in its own axes is a function of the joints and their rates alone. Its pose is
    the product of exponentials of twists: Magnus' method of fourth order, which has no coordinates
    of attitude.
    """
    count = max(STEPS, int(np.ceil(duration / LONGEST_STEP)))
    times: Array = np.linspace(0.0, duration, count + 1)
    step = duration / count
    middle = times[:-1] + 0.5 * step
    first, second = (_twists(robot, motion, middle + s * GAUSS * step) for s in (-1.0, 1.0))
    twist = 0.5 * step * (first + second) + 0.5 * GAUSS * step**2 * _bracket(first, second)
    turn = twist[:, 3:]
    moved = np.einsum('kij,kj->ki', left_jacobians(turn), twist[:, :3])
    turned = rotations(turn)
    position, attitude = np.zeros((count + 1, 3)), np.tile(np.eye(3), (count + 1, 1, 1))
    for k in range(count):
        position[k + 1] = position[k] + attitude[k] @ moved[k]
        attitude[k + 1] = attitude[k] @ turned[k]
    vectors = continuous(rotation_vectors(attitude))
    require_attitude(robot, vectors)
    return times, np.concatenate([position, vectors], axis=1)


def _twists(robot: Robot, motion: Callable[[Array, int], Array], times: Array) -> Array:
    """Return the base's twist (k, 6) in its own axes: velocity, then angular velocity."""
    q, rate = np.zeros((2, len(times), robot.n))
    q[:, robot.joint_indices], rate[:, robot.joint_indices] = motion(times, 0), motion(times, 1)
    return np.asarray(np.einsum('kij,kj->ki', base_gain(robot, q), rate))


def _bracket(first: Array, second: Array) -> Array:
    """Return the commutator (k, 6) of two twists (k, 6) each."""
    v, w, v2, w2 = first[:, :3], first[:, 3:], second[:, :3], second[:, 3:]
    return np.concatenate([np.cross(w, v2) - np.cross(w2, v), np.cross(w, w2)], axis=1)


def continuous(vectors: Array) -> Array:
    """Return the same attitudes (k, 3) [rad] by rotation vectors that do not jump.

    phi and phi (1 + 2 pi m / |phi|) are the same attitude.
    """
    found: Array = vectors.copy()
    for k in range(1, len(found)):
        angle = float(np.linalg.norm(found[k]))
        if angle < 1e-9:
            continue
        axis = found[k] / angle
        turns = np.round((float(axis @ found[k - 1]) - angle) / (2.0 * np.pi))
        found[k] += 2.0 * np.pi * turns * axis
    return found


def require_attitude(robot: Robot, vectors: Array) -> None:
    """Raise SolverError where a base turns by more than `FARTHEST` from its start."""
    largest = float(np.linalg.norm(vectors, axis=-1).max(initial=0.0))
    if not largest <= FARTHEST:
        raise SolverError(
            f'shape_motion: {robot.tree.name}: the floating base must turn by at most '
            f'{FARTHEST:g} rad in one motion, got {largest:.3g} (split the motion where it rests)'
        )
