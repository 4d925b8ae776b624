"""Reactions against joint torques, weight, the multipliers' generalized forces and free bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from strategies import seeded_robot

import denoc_ros as dn
from denoc_ros.dynamics.reactions import reactions
from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.tree import JointKind
from denoc_ros.types import Array

LOOPED = ('five_bar_ffff', 'rssr_fff', 'planar_3dof_3ff', 'four_bar_rrr')


def moving_state(robot: Robot, seed: int) -> tuple[Array, Array, Array, Array, Array]:
    """Return q, qd, tau, qdd and multipliers of a motion under random joint torques."""
    rng = np.random.default_rng(seed)
    q, qd = rng.uniform(-1.0, 1.0, robot.n), rng.uniform(-0.3, 0.3, robot.n)
    q[robot.flexible_indices] *= 0.01
    if robot.tree.loops:
        q = robot.assemble(q)
        qd = robot.assemble_rates(q, qd)
    tau = np.zeros(robot.n)
    tau[robot.joint_indices] = rng.uniform(-1.0, 1.0, len(robot.joint_indices))
    qdd, multipliers = robot.constrained_forward_dynamics(q, qd, tau)
    return q, qd, tau, qdd, multipliers


def joint_losses(robot: Robot, qd: Array, qdd: Array) -> Array:
    """Return what armature, damping and friction take off the joints' torques (n,)."""
    lost = np.zeros(robot.n)
    for body in robot.tree.bodies:
        if body.joint is not None and body.joint.kind is not JointKind.FIXED:
            (k,) = robot.indices([body.joint.name])
            joint = body.joint
            slip = np.tanh(qd[k] / 1e-3)  # the width of Coulomb friction's step, as documented
            lost[k] = joint.armature * qdd[k] + joint.damping * qd[k] + joint.friction * slip
    return lost


def test_along_its_axis_a_joint_transmits_its_torque(repository: Path) -> None:
    robots = [
        *(dn.load_robot(seeded_robot(seed)) for seed in range(4)),
        *(dn.load_robot(repository / f'config/robots/{name}.urdf') for name in LOOPED),
    ]
    for robot in robots:
        q, qd, tau, qdd, multipliers = moving_state(robot, 5)
        found = reactions(robot, q, qd, qdd, multipliers)
        torque = tau - joint_losses(robot, qd, qdd)
        size = np.abs(found.joints).max()
        for body, wrench in zip(robot.tree.bodies, found.joints, strict=True):
            if body.joint is None or body.joint.kind is JointKind.FIXED:
                continue
            (k,) = robot.indices([body.joint.name])
            axis = robot.frame_pose(body.name, q)[:3, :3] @ body.joint.axis
            along = wrench[:3] if body.joint.kind is JointKind.PRISMATIC else wrench[3:]
            if body.joint.kind is JointKind.REVOLUTE:  # about the joint, not the beam's root
                arm = found.origins[robot.tree.bodies.index(body)]
                along = along + np.cross(arm - robot.frame_pose(body.name, q)[:3, 3], wrench[:3])
            # accelerations carry the rounding of a solution
            assert axis @ along == pytest.approx(torque[k], abs=1e-9 * (1.0 + size))


@pytest.mark.parametrize('name', LOOPED)
def test_loop_wrenches_are_the_multipliers(repository: Path, name: str) -> None:
    robot = dn.load_robot(repository / 'config' / 'robots' / f'{name}.urdf')
    q, qd, _, qdd, multipliers = moving_state(robot, 6)
    found = reactions(robot, q, qd, qdd, multipliers)
    force = np.zeros(robot.n)
    for loop, wrench in zip(robot.tree.loops, found.loops, strict=True):
        force += robot.frame_jacobian(loop.child.frame, q).T @ wrench
        force -= robot.frame_jacobian(loop.parent.frame, q).T @ wrench
    expected = robot.closure_jacobian(q).T @ multipliers
    assert np.abs(expected).max() > 1.0
    # loops close to 1e-10 m
    np.testing.assert_allclose(force, expected, atol=1e-8 * np.abs(multipliers).max())


def test_the_root_carries_the_weight_of_a_robot_at_rest(repository: Path) -> None:
    robot = dn.load_robot(repository / 'config' / 'robots' / 'two_flexible_links.urdf')
    q = robot.static_deflection(np.array([0.3, -0.5]))
    zero = np.zeros(robot.n)
    found = reactions(robot, q, zero, zero)
    mass = sum(
        body.inertia.mass + (body.beam.mass_per_length * body.beam.length if body.beam else 0.0)
        for body in robot.tree.bodies
    )
    # static deflection is in equilibrium to 1e-14 of its size
    np.testing.assert_allclose(found.joints[0, :3], [0.0, 0.0, 9.81 * mass], atol=1e-9)


def test_a_tip_load_is_felt_by_every_joint_below(repository: Path) -> None:
    robot = dn.load_robot(repository / 'config' / 'robots' / 'two_flexible_links.urdf')
    q, zero = np.zeros(robot.n), np.zeros(robot.n)
    bare = reactions(robot, q, zero, zero)
    robot.set_payload('link_2', 2.0)
    loaded = reactions(robot, q, zero, zero)
    change = loaded.joints[:, :3] - bare.joints[:, :3]
    carried = [body.name in ('link_1', 'drive', 'link_2') for body in robot.tree.bodies]
    expected = np.outer(carried, [0.0, 0.0, 2.0 * 9.81])
    np.testing.assert_allclose(change, expected, atol=1e-12)
