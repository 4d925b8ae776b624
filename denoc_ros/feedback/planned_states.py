"""All coordinates along a motion of the joints: operating points of the state feedback."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.driven.measured_side import measured_robot, whole_robot
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.structure import body_amplitudes
from denoc_ros.feedback.deviation_model import PlannedState
from denoc_ros.types import Array

Sample = Callable[[float, Array, Array, Array], None]
Row = tuple[Array, Array, Array]  # q, qd, qdd, (n,) each

STEP = 4e-3  # s of the integration of the amplitudes, at most
AFTER = 1.0  # s after the end whose swing counts as that of the last posture
SPACING = 0.25  # s between states along a plan, at least
MOST_STATES = 200  # states along a plan
ROWS = 16  # of the motion, from one operating point to the next, at most
DEFLECTION = 3e-3  # of its length that a beam of a streamed reference may bend


@dataclass(frozen=True)
class PlannedMotion:
    """A motion of all coordinates.

    Attributes
    ----------
    times : (k,) array
        Of the states [s], evenly spaced.
    states : list of PlannedState
        Operating points.
    step : float
        Time between rows [s]: that between states is a multiple.
    rows : list of (q, qd, qdd)
        From the first state to the last one; the very last row is at rest.
    """

    times: Array
    states: list[PlannedState]
    step: float
    rows: list[Row]


def motion_along(
    robot: Robot,
    joints: Sequence[str],
    sample: Sample,
    duration: float,
    period: float,
    posture: Array | None = None,
) -> PlannedMotion:
    """Return a motion of the driven joints with that of all coordinates.

    The joints move as asked while the amplitudes move freely, as in the `flexible` feedforward.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread. Of one with joints measured
        behind their springs the link sides move as asked; states and rows are of the whole robot.
    joints : sequence of str
        That are driven.
    sample : callable
        `(t, q, qd, qdd)` writes the motion at t [s] into (joints,) arrays.
    duration : float
        [s].
    period : float
        Of the loop [s].
    posture : (n,) array, optional
        Near which loops are closed; of the robot that joint states describe.

    Raises
    ------
    StateError, SolverError
        A motion that the model cannot make.
    """
    apart = spacing(duration, period)
    between = min(ROWS, round(apart / period))  # rows, also 2^j periods apart
    per_row = max(1, round(apart / between / STEP))
    per_node = between * per_row
    step = apart / per_node
    nodes = int(np.ceil(duration / apart - 1e-9)) + 1
    count = (nodes - 1) * per_node + int(np.ceil(AFTER / step)) + 1
    source = TorqueFeedforward(
        measured_robot(robot), joints, 'flexible', step=step, posture=posture
    )
    robot = whole_robot(robot)
    flexible, driven = robot.flexible_indices, robot.indices(joints)
    q, qd, qdd = np.zeros((3, len(driven)))
    torques, bent = np.zeros((count, len(driven))), np.zeros((count, len(flexible)))
    states: list[tuple[Array, Array, Array]] = []
    rows: list[Row] = []
    for index in range(count):
        sample(index * step, q, qd, qdd)
        torques[index] = source.update(q, qd, qdd, step if index else 0.0)
        whole = source.whole_motion()
        bent[index] = np.abs(whole[0][flexible])
        if index % per_row == 0 and index < (nodes - 1) * per_node:
            rows.append((whole[0].copy(), whole[1].copy(), whole[2].copy()))
        if index % per_node == 0 and len(states) < nodes:
            states.append((whole[0].copy(), whole[1].copy(), torques[index].copy()))
    np.abs(torques, out=torques)
    found = []
    for node, (there, rates, torque) in enumerate(states):
        last = node == nodes - 1
        at = node * per_node
        about = slice(
            at if last else max(0, at - 2 * per_node), count if last else at + 2 * per_node
        )
        tau = np.zeros(robot.n)
        tau[driven] = torque
        found.append(
            PlannedState(there, rates, tau, torques[about].max(axis=0), bent[about].max(axis=0))
        )
    source.reset()
    zero = np.zeros(len(driven))
    source.update(q, zero, zero, 0.0)
    rows.append((source.whole_motion()[0].copy(), np.zeros(robot.n), np.zeros(robot.n)))
    times = np.asarray(apart * np.arange(nodes), dtype=np.float64)
    return PlannedMotion(times, found, apart / between, rows)


def spacing(duration: float, period: float) -> float:
    """Return the time between states along a plan of a duration [s]: 2^j periods."""
    wanted = max(SPACING, duration / MOST_STATES)
    return period * 2.0 ** math.ceil(math.log2(wanted / period) - 1e-9)


def state_at(
    robot: Robot,
    joints: Sequence[str],
    position: Array,
    torque: Array,
    posture: Array | None = None,
) -> PlannedState:
    """Return the state at rest with the driven joints at positions (joints,).

    Parameters
    ----------
    robot, joints, posture
        As of :func:`motion_along`.
    position : (joints,) array
        [rad, m].
    torque : (joints,) array
        Sizes of the torques [N m, N] that a reference, of which nothing else is known, may ask.

    Raises
    ------
    SolverError
        There is no equilibrium.
    """
    source = TorqueFeedforward(measured_robot(robot), joints, 'flexible', posture=posture)
    robot = whole_robot(robot)
    zero = np.zeros(len(position))
    held = source.update(position, zero, zero, 0.0)
    tau = np.zeros(robot.n)
    tau[robot.indices(joints)] = held
    q = source.whole_motion()[0].copy()
    bent = np.abs(q[robot.flexible_indices])
    reach = DEFLECTION * _lengths(robot)
    return PlannedState(q, np.zeros(robot.n), tau, np.maximum(torque, np.abs(held)),
                        np.maximum(bent, reach))  # fmt: skip


def _lengths(robot: Robot) -> Array:
    """Return the length [m] of each amplitude's beam, 1 rad for twist."""
    lengths = np.ones(robot.n)
    for k, body in enumerate(robot.tree.bodies):
        if body.amplitudes:  # of a link of several segments, each is a body
            lengths[body_amplitudes(robot, k)] = body.spans
    return np.asarray(lengths[robot.flexible_indices])
