"""The peers of the benchmark: Pinocchio, and dense Cholesky of the same model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from book.benchmarks.timing import Subject
from scipy.linalg.lapack import dposv

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.types import Array

State = tuple[Array, ...]


class Pinocchio:
    """Pinocchio's model of a URDF text whose joints turn within limits."""

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


LENGTH = 0.5  # m, of every link
MASS = 2.0  # kg
EI = 2.0e4  # N m^2: some millimetres of sag over a chain of some metres
HUB_MASS = 0.5  # kg, of what is rigid at a flexible link's joint
HUB_INERTIA = 2.0e-3  # kg m^2, about any axis
GJ = 1.0e4  # N m^2
POLAR_INERTIA = 2.0e-3  # kg m
# Pinocchio has code of its own for joints about these axes: the chain is its best case
AXES = ('0 0 1', '0 1 0', '1 0 0')


def rigid_chain(n: int) -> str:
    """Return a chain of n rigid links, turned and offset in general, joints about z, y, x, z, …"""
    parts = ['<robot name="rigid_chain"><link name="link_0"/>']
    for k in range(1, n + 1):
        turn = f'{0.4 * math.sin(k)!r} {0.3 * math.cos(2 * k)!r} {0.2 * math.sin(3 * k)!r}'
        parts.append(
            f'<link name="link_{k}"><inertial><origin xyz="0.2 0.03 -0.02"/>'
            f'<mass value="{MASS}"/><inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.05" '
            'iyz="0.003" izz="0.06"/></inertial></link>'
        )
        parts.append(_joint(k, f'<origin xyz="0.3 0.05 0.1" rpy="{turn}"/>', AXES[k % 3]))
    return ''.join([*parts, '</robot>'])


def flexible_chain(n: int, y: int, z: int, torsion: int) -> str:
    """Return a chain of n flexible links, each clamped to its joint, axes z, y, z, …

    Parameters
    ----------
    y, z, torsion : int
        Modes per link: of bending in two directions and of torsion; 0 leaves it rigid.
    """
    parts = ['<robot name="flexible_chain"><link name="link_0"/>']
    mass = MASS + HUB_MASS
    centre = 0.5 * LENGTH * MASS / mass
    about_root = HUB_INERTIA + MASS * LENGTH**2 / 3
    across = about_root - mass * centre**2
    along = HUB_INERTIA + POLAR_INERTIA * LENGTH
    for k in range(1, n + 1):
        parts.append(
            f'<link name="link_{k}"><inertial><origin xyz="{centre!r} 0 0"/>'
            f'<mass value="{mass}"/><inertia ixx="{along!r}" ixy="0" ixz="0" iyy="{across!r}" '
            f'iyz="0" izz="{across!r}"/></inertial></link>'
        )
        origin = f'<origin xyz="{LENGTH if k > 1 else 0.0} 0 0"/>'
        parts.append(_joint(k, origin, AXES[k % 2]))
    parts.append('<flexibility>')
    parts += [_beam(k, y, z, torsion) for k in range(1, n + 1)]
    return ''.join([*parts, '</flexibility></robot>'])


def _joint(k: int, origin: str, axis: str) -> str:
    return (
        f'<joint name="joint_{k}" type="revolute"><parent link="link_{k - 1}"/>'
        f'<child link="link_{k}"/>{origin}<axis xyz="{axis}"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="10"/></joint>'
    )


def _beam(k: int, y: int, z: int, torsion: int) -> str:
    parts = [f'<beam link="link_{k}" length="{LENGTH}" mass_per_length="{MASS / LENGTH}">']
    for direction, modes in (('y', y), ('z', z)):
        if modes:
            parts.append(f'<bending direction="{direction}" ei="{EI}" modes="{modes}"/>')
    if torsion:
        parts.append(f'<torsion gj="{GJ}" polar_inertia="{POLAR_INERTIA}" modes="{torsion}"/>')
    return ''.join([*parts, '</beam>'])
