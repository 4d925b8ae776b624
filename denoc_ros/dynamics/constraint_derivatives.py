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

from denoc_ros.kernels import constraint_layout

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
    """Return a x b along the first axis; numpy's own takes ten times as long."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
        dtype=complex,
    )


def _turned(rotation: Complex, v: Complex) -> Complex:
    return np.asarray(np.einsum('ijc,jc->ic', rotation, v), dtype=complex)


def _back(rotation: Complex, v: Complex) -> Complex:
    return np.asarray(np.einsum('jic,jc->ic', rotation, v), dtype=complex)


def _moved(robot: Robot, frame: str, q: Array, qd: Array, qdd: Array) -> FrameMotion:
    """Return a frame's motion: a column per coordinate along which q steps, then as many of q'."""
    rotation, position, _jacobian = _posed(robot, frame, q)
    motion = robot.frame_motion(frame, q, qd, qdd)
    twist = np.hstack(robot.frame_velocity_derivatives(frame, q, qd))
    up = np.hstack(robot.frame_acceleration_derivatives(frame, q, qd, qdd)[:2])
    n, step = robot.n, 1j * STEP
    return FrameMotion(
        np.concatenate([rotation, np.repeat(rotation.real[:, :, :1], n, axis=2)], axis=2),
        np.concatenate([position, np.repeat(position.real[:, :1], n, axis=1)], axis=1),
        motion[0, :3, None] + step * twist[:3],
        motion[0, 3:, None] + step * twist[3:],
        motion[1, :3, None] + step * up[:3],
        motion[1, 3:, None] + step * up[3:],
    )


def _posed(robot: Robot, frame: str, q: Array) -> tuple[Complex, Complex, Array]:
    """Return a frame's rotation and position as each coordinate steps, and its Jacobian."""
    pose, jacobian = robot.frame_pose(frame, q), robot.frame_jacobian(frame, q)
    turn = _cross(jacobian[3:, None, :], pose[:3, :3, None])
    step = 1j * STEP
    return pose[:3, :3, None] + step * turn, pose[:3, 3:] + step * jacobian[:3], jacobian


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


class _Tie(NamedTuple):
    """What a loop constraints: directions in its parent's frame, and where its rows stand."""

    kind: int
    linear: Array  # (rows, 3)
    angular: Array
    references: Array
    axis: Array  # (3,)
    second: Array
    slides: bool
    row: int
    axis_row: int  # 0: none

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        crossed = self.kind == constraint_layout.UNIVERSAL
        angular = (
            0 if self.kind == constraint_layout.POINT else 1 if crossed else len(self.angular)
        )
        return len(self.linear) + angular


def _tie(robot: Robot, number: int) -> _Tie:
    """Return what the model's arrays say of a loop."""
    topology = robot.arrays.topology[
        int(robot.arrays.topology[0, constraint_layout.FIRST_CONSTRAINT]) + number
    ]
    constraint = topology.astype(int)
    constants = robot.constants[constraint[constraint_layout.CONSTANTS] :]
    counts = [
        constraint[k]
        for k in (
            constraint_layout.LINEAR,
            constraint_layout.ANGULAR,
            constraint_layout.REFERENCES,
        )
    ]
    edges = constraint_layout.DIRECTIONS + 3 * np.cumsum([0, *counts])
    linear, angular, references = (constants[a:b].reshape(-1, 3) for a, b in pairwise(edges))
    return _Tie(
        int(constraint[constraint_layout.KIND]), linear, angular, references,
        constants[constraint_layout.FREE_AXIS :][:3],
        constants[constraint_layout.SECOND_AXIS :][:3],
        bool(constants[constraint_layout.SLIDES] == 1.0), int(constraint[constraint_layout.ROW]),
        int(constraint[constraint_layout.AXIS_ROW]),
    )  # fmt: skip


def _loop_rows(
    robot: Robot, number: int, q: Array, qd: Array, qdd: Array
) -> tuple[Complex, Complex]:
    """Return g'' (rows, 2 n) of a loop and the rate (1, 2 n) of its free axis, or none."""
    loop, constraint = robot.tree.loops[number], _tie(robot, number)
    child, parent = (_moved(robot, s.frame, q, qd, qdd) for s in (loop.child, loop.parent))
    rotation, slip, slip_up, spin, spin_up = _relative(child, parent)
    rows = [constraint.linear @ slip_up]
    if constraint.kind == constraint_layout.UNIVERSAL:
        there = np.einsum('ijc,j->ic', rotation, constraint.second)
        up = _cross(spin_up, there) + _cross(spin, _cross(spin, there))
        rows.append(-(constraint.axis @ up)[None])
    elif constraint.kind != constraint_layout.POINT:
        rows.append(_angular(rotation, spin, spin_up, constraint.references, constraint.angular))
    rate = (constraint.axis @ (slip if constraint.slides else spin))[None]
    return np.concatenate(rows), np.asarray(rate[: constraint.axis_row > 0], dtype=complex)


def row_derivatives(robot: Robot, q: Array, qd: Array, qdd: Array) -> RowDerivatives:
    """Return how the rows' accelerations g'' = J q'' + J' q' change with a closed state."""
    n, found = robot.n, [_loop_rows(robot, k, q, qd, qdd) for k in range(len(robot.tree.loops))]
    none = np.zeros((0, 2 * n))
    followers = np.zeros((len(robot.constraint_names) - sum(len(x[0]) for x in found), 2 * n))
    rows = np.concatenate([none, *(one[0].imag / STEP for one in found), followers])
    axes = np.concatenate([none, *(one[1].imag / STEP for one in found)])
    return RowDerivatives(rows[:, :n], rows[:, n:], axes[:, :n])


def applied_change(robot: Robot, q: Array, v: Array) -> Array:
    """Return d(J v)/dq (rows, n) with v (n,) constant."""
    return row_derivatives(robot, q, np.zeros(robot.n), v).by_q


def _loop_torque(constraint: _Tie, rotation: Complex, weights: Array) -> Complex:
    """Return the torque (3, c) on a loop's child, its parent's axes, of its angular rows."""
    if constraint.kind == constraint_layout.POINT:
        return np.zeros(rotation.shape[1:], dtype=complex)
    if constraint.kind == constraint_layout.UNIVERSAL:
        there = np.einsum('ijc,j->ic', rotation, constraint.second)
        return _cross(weights[0] * constraint.axis[:, None], there)
    # adjoint of e' = (2 w' - c' e) / c with the terms of _angular
    along = (weights @ constraint.angular)[:, None]
    h = 0.5 if len(constraint.references) == 3 else 1.0
    there = [np.einsum('ijc,j->ic', rotation, each) for each in constraint.references]
    here = [each[:, None] for each in constraint.references]
    c = (1.0 if h == 1.0 else 0.5) + h * sum(
        (a * b).sum(axis=0) for a, b in zip(here, there, strict=True)
    )
    e = 2.0 * h * sum(_cross(a, b) for a, b in zip(here, there, strict=True)) / c
    pulled = (along * e).sum(axis=0)
    torque = sum(
        _cross(b, 2.0 * _cross(along, a) - pulled * a) for a, b in zip(here, there, strict=True)
    )
    return np.asarray(h * torque / c, dtype=complex)


def transposed_change(robot: Robot, q: Array, weights: Array, axis_weights: Array) -> Array:
    """Return d(J^T weights + axes^T axis_weights)/dq (n, n), both weights constant.

    Each loop's weights are a wrench on its child and the opposite one on its parent: they change
    as the frames move, and so does what they do to the coordinates.
    """
    change = np.zeros((robot.n, robot.n))
    left = iter(axis_weights)
    for number, loop in enumerate(robot.tree.loops):
        constraint = _tie(robot, number)
        own = weights[constraint.row : constraint.row + constraint.rows]
        turn_c, place_c, jacobian_c = _posed(robot, loop.child.frame, q)
        turn_p, place_p, jacobian_p = _posed(robot, loop.parent.frame, q)
        rotation = np.einsum('jic,jkc->ikc', turn_p, turn_c)
        force = (own[: len(constraint.linear)] @ constraint.linear)[:, None].astype(complex)
        torque = _loop_torque(constraint, rotation, own[len(constraint.linear) :])
        if constraint.axis_row > 0 and len(axis_weights):
            pull = next(left) * constraint.axis[:, None]
            force, torque = (force + pull, torque) if constraint.slides else (force, torque + pull)
        force = _turned(turn_p, np.broadcast_to(force, torque.shape))
        torque = _turned(turn_p, torque)
        on_parent = np.concatenate([-force, -torque - _cross(place_c - place_p, force)])
        for frame, jacobian, wrench in (
            (loop.child.frame, jacobian_c, np.concatenate([force, torque])),
            (loop.parent.frame, jacobian_p, on_parent),
        ):
            change += jacobian.T @ (wrench.imag / STEP)
            change += robot.load_derivative(q, {frame: wrench[:, 0].real})
    return change
