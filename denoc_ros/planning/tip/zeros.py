"""How long joints move before and after the tip: the robot's zeros."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.dynamics.constrained_dynamics import RANK
from denoc_ros.planning.tip.tip_problem import TipProblem
from denoc_ros.types import Array

DECADES = 5.0  # to which what goes before and after has died down at the window's ends
SHARE = 0.1  # a zero whose real part is less of its size neither grows nor decays


def least_moved(problem: TipProblem) -> float:
    """Return how far the joints of a stiff robot move its frames at least, over the asked motion.

    That is the least singular value of the weighed errors' derivative [m per rad or m], without
    those of directions in which they never move at all.
    """
    q = problem.asked
    jacobian = problem.error_derivatives(q, problem.errors(q))
    tied = np.concatenate([problem.loops.jacobian(q), problem.momentum(q, 0.0 * q).by_qd], axis=1)
    sizes = np.array(
        [
            np.linalg.svd(row @ _rigid_motions(problem, held), compute_uv=False)
            for row, held in zip(jacobian, tied, strict=True)
        ]
    )
    moved = sizes.max(axis=0) > RANK * sizes.max()
    return float(sizes[:, moved].min(initial=np.inf))


def transmission_zeros(problem: TipProblem, q: Array) -> NDArray[np.complex128]:
    """Return the zeros [1/s] from the driven joints to the frames, at rest at q (n,).

    They are the rates of motions in which all frames stand still, and a floating base reacts.
    Directions in which frames do
    not move, and joints' motions that move no frame of a stiff robot, are left out.
    """
    rest = np.zeros((1, problem.robot.n))
    none = np.zeros((1, problem.loops.count))
    equations = problem.equations(q[None], rest, rest, none)
    closure = problem.loops.jacobian(q[None])[0]
    jacobian = problem.error_derivatives(q[None], problem.errors(q[None], slice(0, 1)))[0]
    momentum = problem.momentum(q[None], rest).by_qd[0]
    rigid = _rigid_motions(problem, np.concatenate([closure, momentum]))
    by_joints = jacobian @ rigid
    by_motions = np.zeros((rigid.shape[1], problem.robot.n))
    moved = problem.robot.joint_indices
    by_motions[:, moved] = np.linalg.pinv(rigid[moved])
    still = scipy.linalg.null_space(by_joints, rcond=RANK).T @ by_motions
    rows = [_reachable(jacobian, by_joints), still, closure, momentum]
    basis = scipy.linalg.null_space(np.concatenate(rows), RANK)
    p = len(problem.undriven)
    forces = equations.by_multipliers[0, :p]
    open_to = scipy.linalg.null_space(forces.T, RANK) if forces.size else np.eye(p)
    inertia, damping, stiffness = (
        open_to.T @ part[0, :p] @ basis
        for part in (equations.by_qdd, equations.by_qd, equations.by_q)
    )
    p = len(inertia)
    if basis.shape[1] != p or not p:
        return np.zeros(0, dtype=np.complex128)
    eye, zero = np.eye(p), np.zeros((p, p))
    left = np.block([[zero, eye], [-stiffness, -damping]])
    right = np.block([[eye, zero], [zero, inertia]])
    found = scipy.linalg.eigvals(left, right)
    return np.asarray(found[np.isfinite(found)])


def _rigid_motions(problem: TipProblem, tied: Array) -> Array:
    """Return a basis (n, j) of the joints' motions with links undeformed.

    They keep what is tied (r, n): loops closed, and a floating base without momentum.
    """
    eye = np.eye(problem.robot.n)
    if not len(tied):
        return eye[:, problem.driven]
    fixed = np.concatenate([tied, eye[problem.robot.flexible_indices]])
    return np.asarray(scipy.linalg.null_space(fixed, RANK))


def _reachable(jacobian: Array, joints: Array) -> Array:
    """Return the frames' rows (r, n) in the directions in which the joints move them."""
    directions, sizes, _ = np.linalg.svd(joints, full_matrices=False)
    rows = directions[:, sizes > RANK * sizes.max(initial=1e-300)].T @ jacobian
    return np.asarray(rows)


def settling_times(problem: TipProblem, q: Array) -> tuple[float, float]:
    """Return the times [s] that the joints move before and after the tip, near q (n,).

    Zero where there is nothing that grows or decays.
    """
    zeros = transmission_zeros(problem, q)
    zeros = zeros[np.abs(zeros.real) > SHARE * np.abs(zeros)]
    reach = DECADES * np.log(10.0)
    before = zeros.real[zeros.real > 0.0].min(initial=np.inf)
    after = -zeros.real[zeros.real < 0.0].max(initial=-np.inf)
    return reach / before, reach / after
