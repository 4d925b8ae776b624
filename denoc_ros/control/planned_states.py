"""All coordinates along a motion of the joints: operating points of the state feedback."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from denoc_ros.control.deviation_model import PlannedState
from denoc_ros.control.gain_schedule import spacing
from denoc_ros.dynamics.feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

Sample = Callable[[float, Array, Array, Array], None]

STEP = 4e-3  # s of the integration of the amplitudes, at most
AFTER = 1.0  # s after the end whose swing counts as that of the last posture
DEFLECTION = 3e-3  # of its length that a beam of a streamed reference may bend


def states_along(
    robot: Robot,
    joints: Sequence[str],
    sample: Sample,
    duration: float,
    period: float,
    posture: Array | None = None,
) -> tuple[Array, list[PlannedState]]:
    """Return times (k,) [s] and states along a motion of the driven joints.

    The joints move as asked while the amplitudes move freely, as in the `flexible` feedforward.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    joints : sequence of str
        That are driven.
    sample : callable
        `(t, q, qd, qdd)` writes the motion at t [s] into (joints,) arrays.
    duration : float
        [s].
    period : float
        Of the loop [s].
    posture : (n,) array, optional
        Near which loops are closed.

    Raises
    ------
    StateError, SolverError
        A motion that the model cannot make.
    """
    apart = spacing(duration, period)
    per_node = max(1, round(apart / STEP))
    step = apart / per_node
    nodes = int(np.ceil(duration / apart - 1e-9)) + 1
    count = (nodes - 1) * per_node + int(np.ceil(AFTER / step)) + 1
    source = TorqueFeedforward(robot, joints, 'flexible', step=step, posture=posture)
    flexible, driven = robot.flexible_indices, source.motion.index
    q, qd, qdd = np.zeros((3, len(driven)))
    torques, bent = np.zeros((count, len(driven))), np.zeros((count, len(flexible)))
    states: list[tuple[Array, Array, Array]] = []
    for index in range(count):
        sample(index * step, q, qd, qdd)
        torques[index] = source.update(q, qd, qdd, step if index else 0.0)
        bent[index] = np.abs(source.q[flexible])
        if index % per_node == 0 and len(states) < nodes:
            states.append((source.q.copy(), source.qd.copy(), torques[index].copy()))
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
    return np.asarray(apart * np.arange(nodes), dtype=np.float64), found


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
        As of :func:`states_along`.
    position : (joints,) array
        [rad, m].
    torque : (joints,) array
        Sizes of the torques [N m, N] that a reference, of which nothing else is known, may ask.

    Raises
    ------
    SolverError
        There is no equilibrium.
    """
    source = TorqueFeedforward(robot, joints, 'flexible', posture=posture)
    zero = np.zeros(len(position))
    held = source.update(position, zero, zero, 0.0)
    tau = np.zeros(robot.n)
    tau[source.motion.index] = held
    bent = np.abs(source.q[robot.flexible_indices])
    reach = DEFLECTION * _lengths(robot)
    return PlannedState(source.q.copy(), np.zeros(robot.n), tau, np.maximum(torque, np.abs(held)),
                        np.maximum(bent, reach))  # fmt: skip


def _lengths(robot: Robot) -> Array:
    """Return the length [m] of each amplitude's beam, 1 rad for twist."""
    lengths = np.ones(robot.n)
    for body in robot.tree.bodies:
        if body.beam is not None and any(body.beam.modes):
            first = robot.amplitudes(body.name).start
            lengths[first : first + body.beam.modes[0] + body.beam.modes[1]] = body.beam.length
    return np.asarray(lengths[robot.flexible_indices])
