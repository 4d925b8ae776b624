"""The peers of the benchmark: Pinocchio, and dense Cholesky of the same model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg.lapack import dposv

from denoc_ros.bench.timing import Subject
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.types import Array

State = tuple[Array, ...]


class Pinocchio:
    """Pinocchio's model of a URDF text whose joints turn within limits.

    Parameters
    ----------
    text : str

    Raises
    ------
    DenocError
        It is not installed.
    """

    def __init__(self, text: str) -> None:
        try:
            import pinocchio
        except ImportError as error:
            raise DenocError(
                "Pinocchio must be installed for this comparison: pip install 'denoc_ros[test]' "
                '(or pip install pin)'
            ) from error
        self.pin: Any = pinocchio
        self.model: Any = pinocchio.buildModelFromXML(text)
        self.data: Any = self.model.createData()

    def inverse_dynamics(self, states: Sequence[State]) -> Subject:
        """Return `pin.rnea` with nothing around it, over states (q, qd, qdd)."""
        return self._subject(self.pin.rnea, states)

    def forward_dynamics(self, states: Sequence[State]) -> Subject:
        """Return `pin.aba` over states (q, qd, tau)."""
        return self._subject(self.pin.aba, states)

    def inertia_matrix(self, states: Sequence[State]) -> Subject:
        """Return `pin.crba` over states (q, …); it fills the upper triangle."""
        return self._subject(self.pin.crba, [state[:1] for state in states])

    def inverse_derivatives(self, states: Sequence[State]) -> Subject:
        """Return `pin.computeRNEADerivatives` over states (q, qd, qdd)."""
        return self._subject(self.pin.computeRNEADerivatives, states)

    def forward_derivatives(self, states: Sequence[State]) -> Subject:
        """Return `pin.computeABADerivatives` over states (q, qd, tau)."""
        return self._subject(self.pin.computeABADerivatives, states)

    def constrained_dynamics(self, states: Sequence[State], robot: Robot) -> Subject:
        """Return `pin.constraintDynamics` with the robot's loops as points that coincide.

        Such a point has a redundant row in a planar mechanism, which the proximal iteration of
        Pinocchio is for.
        """
        pin, rows = self.pin, pin_points(self.pin, self.model, robot)
        data, settings = self.model.createData(), pin.ProximalSettings(1e-12, 1e-10, 20)
        each = pin.StdVec_RigidConstraintData()
        for row in rows:
            each.append(row.createData())
        pin.initConstraintDynamics(self.model, data, rows, each)
        found = [(self.model, data, *state, rows, each, settings) for state in states]
        return Subject(pin.constraintDynamics, found)

    def _subject(self, algorithm: Any, states: Sequence[State]) -> Subject:
        return Subject(algorithm, [(self.model, self.data, *state) for state in states])


def pin_points(pin: Any, model: Any, robot: Robot) -> Any:
    """Return the revolute loops of a rigid robot as Pinocchio's 3D constraints."""
    ends = []
    zero = np.zeros(robot.n)
    data = model.createData()
    pin.forwardKinematics(model, data, zero)
    for loop in robot.tree.loops:
        for side in (loop.parent, loop.child):
            frame = model.frames[model.getFrameId(side.link)]
            world = pin.SE3(robot.frame_pose(side.frame, zero))
            ends.append((frame.parentJoint, data.oMi[frame.parentJoint].inverse() * world))
    rows = pin.StdVec_RigidConstraintModel()
    for one, other in zip(ends[::2], ends[1::2], strict=True):
        kind = pin.ContactType.CONTACT_3D
        rows.append(pin.RigidConstraintModel(kind, model, *one, *other, pin.LOCAL))
    return rows


class Dense:
    """Forward dynamics by inertia matrix, bias and Cholesky, O(n^3)."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._inertia = np.zeros((robot.n, robot.n))

    def forward_dynamics(self, q: Array, qd: Array, tau: Array) -> Array:
        """Return I^-1 (tau - h)."""
        inertia = self._robot.inertia_matrix(q, out=self._inertia)
        force = tau - self._robot.bias_forces(q, qd)
        # the matrix is symmetric: its transpose is the same in the order that LAPACK wants
        _, result, status = dposv(inertia.T, force, overwrite_a=True, overwrite_b=True)
        if status != 0:
            raise DenocError(f'the inertia matrix must be positive definite, got pivot {status}')
        return np.asarray(result)
