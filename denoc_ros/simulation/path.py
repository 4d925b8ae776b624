"""Joint motions that carry a frame along a circle, loops closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.assembling import least_change
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

KNOTS = 120  # per turn: quintics between them are true to 1e-9 of the radius
CLOSED = 1e-11  # m, rad
ITERATIONS = 50
SMALL = 1e-5  # step of a central difference, of 1 / the largest rate


@dataclass(frozen=True)
class Circle:
    """A circle in the base frame's X-Y directions, from rest to rest (eq. 4.1's law of time).

    phase = start + 2 pi turns (s - sin(2 pi s) / (2 pi)), s = t / duration.
    """

    frame: str
    centre: Array  # (3,) m, base frame
    radius: float  # m
    duration: float  # s
    start: float = 0.0  # rad
    turns: float = 1.0

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (3,) at a time [s]."""
        w = 2.0 * np.pi / self.duration
        rate = self.turns * w * (1.0 - np.cos(w * t))
        angle = self.start + self.turns * (w * t - np.sin(w * t))
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        along = np.array([-out[1], out[0], 0.0])
        bend = self.turns * w * w * np.sin(w * t)
        r = self.radius
        return self.centre + r * out, r * rate * along, r * (bend * along - rate * rate * out)


def follow(robot: Robot, circle: Circle, guess: Array) -> SplineTrajectory:
    """Return the joints' motion with which a rigid robot carries a frame along a circle.

    Parameters
    ----------
    robot : Robot
        All of its coordinates are joints.
    circle : Circle
        The frame keeps the directions that it has at the guess.
    guess : (n,) array
        Near the start.

    Raises
    ------
    SolverError
        A point is out of reach.
    """
    directions = robot.frame_pose(circle.frame, guess)[:3, :3]
    times = np.linspace(0.0, circle.duration, round(KNOTS * max(1.0, circle.turns)) + 1)
    q, qd, qdd = np.zeros((3, len(times), robot.n))
    near = guess
    for k, t in enumerate(times):
        point, velocity, acceleration = circle.sample(float(t))
        near = q[k] = _reach(robot, circle.frame, point, directions, near)
        rows = _rows(robot, circle.frame, near)
        none = np.zeros(len(rows) - 6)
        turning = np.zeros(3)
        qd[k] = least_change(np.concatenate([none, velocity, turning]), rows)
        bias = _bias(robot, circle.frame, near, qd[k])
        qdd[k] = least_change(np.concatenate([none, acceleration, turning]) - bias, rows)
    return SplineTrajectory(times, q, qd, qdd)


def _rows(robot: Robot, frame: str, q: Array) -> Array:
    return np.vstack([robot.closure_jacobian(q), robot.frame_jacobian(frame, q)])


def _bias(robot: Robot, frame: str, q: Array, qd: Array) -> Array:
    """Return the accelerations of loops and frame at constant rates."""
    step = SMALL / max(1.0, float(np.max(np.abs(qd))))
    after, before = (robot.frame_jacobian(frame, q + sign * step * qd) for sign in (1.0, -1.0))
    return np.concatenate([robot.closure_bias(q, qd), (after - before) @ qd / (2.0 * step)])


def _reach(robot: Robot, frame: str, point: Array, directions: Array, guess: Array) -> Array:
    """Return a closed configuration with the frame at a point, by Gauss-Newton steps."""
    q: Array = guess.copy()
    for _ in range(ITERATIONS):
        pose = robot.frame_pose(frame, q)
        turn = directions @ pose[:3, :3].T
        twist = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        wanted = np.concatenate([-robot.closure(q), point - pose[:3, 3], twist])
        if np.max(np.abs(wanted)) <= CLOSED:
            return q
        q += least_change(wanted, _rows(robot, frame, q))
    raise SolverError(
        f'simulate: frame {frame!r} must reach {np.round(point, 6).tolist()} m with its '
        f'directions kept, got no closer than {np.max(np.abs(wanted)):.3g} m or rad'
    )
