"""Derivatives of the rows of loops and mimic joints.

The accelerations g'' = J q'' + J' q' of the rows are written as functions of the motion of each
loop's two frames, whose derivatives `KinematicDerivatives` has; steps along the imaginary axis
take them through to rounding. With q' = 0 and q'' = v they are those of J v.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.kernels import tie_layout

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
STEP = 1e-30


class FrameMotion(NamedTuple):
    """Pose, twist and acceleration of a frame, base axes; columns are directions of change."""

    rotation: Complex  # (3, 3, c)
    position: Complex  # (3, c)
    v: Complex  # (3, c)
    w: Complex
    a: Complex
    al: Complex


class RowDerivatives(NamedTuple):
    """Derivatives of the rows' g'' by q and q', (rows, n), and of the free axes' rates by q."""

    by_q: Array
    by_rate: Array
    axis_rates_by_q: Array  # (axes, n)


def _cross(a: Array | Complex, b: Array | Complex) -> Complex:
    return np.asarray(np.cross(a, b, axis=0), dtype=complex)


def _turned(rotation: Complex, v: Complex) -> Complex:
    return np.asarray(np.einsum('ijc,jc->ic', rotation, v), dtype=complex)


def _back(rotation: Complex, v: Complex) -> Complex:
    return np.asarray(np.einsum('jic,jc->ic', rotation, v), dtype=complex)


def _moved(robot: Robot, frame: str, q: Array, qd: Array, qdd: Array, by: str) -> FrameMotion:
    """Return a frame's motion, a column per coordinate that q or q' (`by`) steps along."""
    pose, motion = robot.frame_pose(frame, q), robot.frame_motion(frame, q, qd, qdd)
    jacobian = robot.frame_jacobian(frame, q)
    zero = np.zeros_like(jacobian)
    velocity = robot.frame_velocity_derivatives(frame, q, qd)
    acceleration = robot.frame_acceleration_derivatives(frame, q, qd, qdd)
    place, twist, up = {
        'q': (jacobian, velocity[0], acceleration[0]),
        'rate': (zero, velocity[1], acceleration[1]),
    }[by]
    step = 1j * STEP
    turn = np.cross(place[3:, None, :], pose[:3, :3, None], axis=0)
    return FrameMotion(
        pose[:3, :3, None] + step * turn,
        pose[:3, 3:] + step * place[:3],
        motion[0, :3, None] + step * twist[:3],
        motion[0, 3:, None] + step * twist[3:],
        motion[1, :3, None] + step * up[:3],
        motion[1, 3:, None] + step * up[3:],
    )


def _relative(child: FrameMotion, parent: FrameMotion) -> tuple[Complex, ...]:
    """Return rotation, d', d'', omega and alpha of a child's frame as its parent's sees them."""
    apart, w = child.position - parent.position, parent.w
    slip = child.v - parent.v - _cross(w, apart)
    slip_up = child.a - parent.a - _cross(parent.al, apart) - _cross(w, _cross(w, apart))
    slip_up = slip_up - 2.0 * _cross(w, slip)
    spin = child.w - w
    spin_up = child.al - parent.al - _cross(w, spin)
    rotation = np.einsum('jic,jkc->ikc', parent.rotation, child.rotation)
    return rotation, *(_back(parent.rotation, x) for x in (slip, slip_up, spin, spin_up))


def _angular(
    rotation: Complex, spin: Complex, spin_up: Complex, references: Array, along: Array
) -> Complex:
    """Return e'' of directions that are the same on both sides (see kernels.loop_motion)."""
    h = 0.5 if len(references) == 3 else 1.0
    c, dc, ddc = (1.0 if h == 1.0 else 0.5) + 0j, 0j, 0j
    w, dw, ddw = (np.zeros_like(spin) for _ in range(3))
    for reference in references:
        here = np.broadcast_to(reference[:, None], spin.shape)
        there = _turned(rotation, np.asarray(here, dtype=complex))
        rate = _cross(spin, there)
        up = _cross(spin_up, there) + _cross(spin, rate)
        w, dw, ddw = (x + h * _cross(here, y) for x, y in ((w, there), (dw, rate), (ddw, up)))
        c, dc, ddc = (
            x + h * (here * y).sum(axis=0) for x, y in ((c, there), (dc, rate), (ddc, up))
        )
    e = 2.0 * w / c
    de = (2.0 * dw - dc * e) / c
    dde = (2.0 * ddw - 2.0 * dc * de - ddc * e) / c
    return np.asarray(along @ dde, dtype=complex)


def _loop_rows(
    robot: Robot, number: int, q: Array, qd: Array, qdd: Array, by: str
) -> tuple[Complex, Complex]:
    """Return g'' (rows, n) of a loop and the rate (1, n) of its free axis, or none (0, n)."""
    loop = robot.tree.loops[number]
    tie = robot.lowered.ints[int(robot.lowered.ints[0, tie_layout.FIRST_TIE]) + number].astype(int)
    constants = robot.reals[tie[tie_layout.CONSTANTS] :]
    counts = [tie[k] for k in (tie_layout.LINEAR, tie_layout.ANGULAR, tie_layout.REFERENCES)]
    edges = tie_layout.DIRECTIONS + 3 * np.cumsum([0, *counts])
    linear, angular, references = (constants[a:b].reshape(-1, 3) for a, b in pairwise(edges))
    child, parent = (_moved(robot, s.frame, q, qd, qdd, by) for s in (loop.child, loop.parent))
    rotation, slip, slip_up, spin, spin_up = _relative(child, parent)
    rows = [linear @ slip_up]
    axis = constants[tie_layout.FREE_AXIS :][:3]
    if tie[tie_layout.KIND] == tie_layout.CROSSED:
        second = constants[tie_layout.SECOND_AXIS :][:3]
        there = np.einsum('ijc,j->ic', rotation, second)
        up = _cross(spin_up, there) + _cross(spin, _cross(spin, there))
        rows.append(-(axis @ up)[None])
    elif tie[tie_layout.KIND] != tie_layout.POINT:
        rows.append(_angular(rotation, spin, spin_up, references, angular))
    free = slip if constants[tie_layout.SLIDES] == 1.0 else spin
    rate = (axis @ free)[None] if tie[tie_layout.AXIS_ROW] > 0 else np.zeros((0, robot.n))
    return np.concatenate(rows), np.asarray(rate, dtype=complex)


def row_derivatives(robot: Robot, q: Array, qd: Array, qdd: Array) -> RowDerivatives:
    """Return how the rows' accelerations g'' = J q'' + J' q' change with a closed state."""
    by_q, axes = _changes(robot, q, qd, qdd, 'q')
    by_rate, _ = _changes(robot, q, qd, qdd, 'rate')
    return RowDerivatives(by_q, by_rate, axes)


def applied_change(robot: Robot, q: Array, v: Array) -> Array:
    """Return d(J v)/dq (rows, n) with v (n,) constant."""
    return _changes(robot, q, np.zeros(robot.n), v, 'q')[0]


def transposed_change(robot: Robot, q: Array, weights: Array, axis_weights: Array) -> Array:
    """Return d(J^T weights + axes^T axis_weights)/dq (n, n), both weights constant."""
    zero, change = np.zeros(robot.n), np.zeros((robot.n, robot.n))
    for j, unit in enumerate(np.eye(robot.n)):
        change[j] = weights @ applied_change(robot, q, unit)
        if len(axis_weights):
            change[j] += axis_weights @ _changes(robot, q, unit, zero, 'q')[1]
    return change


def _changes(robot: Robot, q: Array, qd: Array, qdd: Array, by: str) -> tuple[Array, Array]:
    """Return derivatives of g'' (rows, n) and of the free axes' rates (axes, n) by q or q'."""
    found = [_loop_rows(robot, k, q, qd, qdd, by) for k in range(len(robot.tree.loops))]
    none = np.zeros((0, robot.n))
    followers = np.zeros((len(robot.lowered.tie_names) - sum(len(x[0]) for x in found), robot.n))
    rows = np.concatenate([none, *(one[0].imag / STEP for one in found), followers])
    return rows, np.concatenate([none, *(one[1].imag / STEP for one in found)])
