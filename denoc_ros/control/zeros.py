"""How long joints move before and after the tip: the robot's zeros."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.control.tip_problem import TipProblem

Array = NDArray[np.float64]

DECADES = 5.0  # to which what goes before and after has died down at the window's ends
SHARE = 0.1  # a zero whose real part is less of its size neither grows nor decays
RANK = 1e-6


def transmission_zeros(problem: TipProblem, q: Array) -> NDArray[np.complex128]:
    """Return the zeros [1/s] from the driven joints to the frames, at rest at q (n,).

    They are the rates of motions in which all frames stand still. Directions in which frames do
    not move, and joints' motions that move no frame of a stiff robot, are left out.
    """
    n = problem.robot.n
    rest = np.zeros(n)
    equations = problem.equations(q[None], rest[None], rest[None])
    jacobian = problem.error_derivatives(q[None], problem.errors(q[None], slice(0, 1)))[0]
    joints = jacobian[:, problem.driven]
    kernel = scipy.linalg.null_space(joints, rcond=RANK)
    still = np.zeros((kernel.shape[1], n))
    still[:, problem.driven] = kernel.T
    basis = scipy.linalg.null_space(np.concatenate([_reachable(jacobian, joints), still]), RANK)
    inertia, damping, stiffness = (
        part[0] @ basis for part in (equations.by_qdd, equations.by_qd, equations.by_q)
    )
    p = len(inertia)
    if basis.shape[1] != p or not p:
        return np.zeros(0, dtype=np.complex128)
    eye, zero = np.eye(p), np.zeros((p, p))
    left = np.block([[zero, eye], [-stiffness, -damping]])
    right = np.block([[eye, zero], [zero, inertia]])
    found = scipy.linalg.eigvals(left, right)
    return np.asarray(found[np.isfinite(found)])


def _reachable(jacobian: Array, joints: Array) -> Array:
    """Return the frames' rows (r, n) in the directions in which the joints move them."""
    directions, sizes, _ = np.linalg.svd(joints, full_matrices=False)
    rows = directions[:, sizes > RANK * sizes.max(initial=1e-300)].T @ jacobian
    return np.asarray(rows)


def settling_times(problem: TipProblem, q: Array) -> tuple[float, float]:
    """Return how long [s] the joints must move before and after the tip, near q (n,).

    Zero where there is nothing that grows or decays.
    """
    zeros = transmission_zeros(problem, q)
    zeros = zeros[np.abs(zeros.real) > SHARE * np.abs(zeros)]
    reach = DECADES * np.log(10.0)
    before = zeros.real[zeros.real > 0.0].min(initial=np.inf)
    after = -zeros.real[zeros.real < 0.0].max(initial=-np.inf)
    return reach / before, reach / after
