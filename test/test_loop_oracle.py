"""The oracle with loops against closed forms: what it says must itself be true."""

from __future__ import annotations

import numpy as np
import pytest
from loop_oracle import LoopOracle

from denoc_ros.model.reading.urdf import load_tree

MASS, LENGTH, G = 2.0, 0.8, 9.81
STAGES = """<robot name="pinned"><link name="base"/><link name="cart"/><link name="lift"/>
<link name="rod"><inertial><origin xyz="0.4 0 0"/><mass value="2"/>
  <inertia ixx="0" ixy="0" ixz="0" iyy="0.10666666666666667" iyz="0" izz="0.10666666666666667"/>
</inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
  <limit effort="1" velocity="1" lower="-1" upper="1"/></joint>
<joint name="y" type="prismatic"><parent link="cart"/><child link="lift"/><axis xyz="0 1 0"/>
  <limit effort="1" velocity="1" lower="-1" upper="1"/></joint>
<joint name="turn" type="continuous"><parent link="lift"/><child link="rod"/><axis xyz="0 0 1"/>
</joint>
<flexibility><loop name="pin" type="{type}"><parent link="base"/><child link="rod"/>{inner}</loop>
</flexibility></robot>"""


def pinned(kind: str, inner: str = '') -> LoopOracle:
    """A rod that could slide in a plane, pinned to the base at its end."""
    return LoopOracle(load_tree(STAGES.format(type=kind, inner=inner)), gravity=(0.0, -G, 0.0))


@pytest.mark.parametrize(
    ('kind', 'inner'), [('spherical', ''), ('revolute', '<axis xyz="0 0 1"/>')]
)
def test_a_pinned_rod_is_a_pendulum(kind: str, inner: str) -> None:
    angle, rate, torque = 0.7, 1.3, 0.4
    oracle = pinned(kind, inner)
    qdd, wrenches, _ = oracle.constrained_forward_dynamics(
        np.array([0.0, 0.0, angle]), np.array([0.0, 0.0, rate]), np.array([0.0, 0.0, torque])
    )
    half, along = LENGTH / 2, np.array([np.cos(angle), np.sin(angle)])
    swing = (torque - MASS * G * half * along[0]) / (MASS * LENGTH**2 / 3)
    np.testing.assert_allclose(qdd, [0.0, 0.0, swing], atol=1e-12)
    across = np.array([-along[1], along[0]])
    centre = half * (swing * across - rate**2 * along)
    # the sliders carry nothing, so the pin carries all
    force = MASS * (centre + [0.0, G])
    np.testing.assert_allclose(wrenches[0], [*force, 0, 0, 0, 0], atol=1e-12)


def test_friction_and_damping_of_the_pin_slow_it() -> None:
    dynamics = '<axis xyz="0 0 1"/><dynamics damping="0.3" friction="0.2"/>'
    q, qd = np.array([0.0, 0.0, 0.7]), np.array([0.0, 0.0, 1.3])
    free = pinned('revolute', '<axis xyz="0 0 1"/>')
    slowed, *_ = pinned('revolute', dynamics).constrained_forward_dynamics(q, qd, np.zeros(3))
    torque = np.array([0.0, 0.0, -0.3 * 1.3 - 0.2])
    expected, *_ = free.constrained_forward_dynamics(q, qd, torque)
    np.testing.assert_allclose(slowed, expected, atol=1e-12)


def test_a_fixed_rod_stands_still_and_its_clamp_carries_the_weight() -> None:
    oracle = pinned('fixed')
    qdd, wrenches, _ = oracle.constrained_forward_dynamics(np.zeros(3), np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(qdd, 0.0, atol=1e-12)
    weight = MASS * G
    np.testing.assert_allclose(wrenches[0], [0, weight, 0, 0, 0, weight * LENGTH / 2], atol=1e-12)


def test_a_rod_in_a_guide_slides_and_its_guide_carries_the_rest() -> None:
    oracle = pinned('prismatic', '<axis xyz="0 1 0"/>')
    q = np.array([0.0, 0.5, 0.0])
    qdd, wrenches, _ = oracle.constrained_forward_dynamics(q, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(qdd, [0.0, -G, 0.0], atol=1e-12)
    np.testing.assert_allclose(wrenches[0], 0.0, atol=1e-12)
    torque, wrenches, _ = oracle.constrained_inverse_dynamics(q, 0 * q, 0 * q, [1])
    np.testing.assert_allclose(torque, [MASS * G], atol=1e-12)
    np.testing.assert_allclose(wrenches[0], [0, 0, 0, 0, 0, MASS * G * LENGTH / 2], atol=1e-12)


def test_assembly_closes_and_hybrid_dynamics_returns_what_was_given() -> None:
    oracle = pinned('spherical')
    q = oracle.assemble(np.array([0.1, -0.2, 0.7]), fixed=[2])
    np.testing.assert_allclose(q, [0.0, 0.0, 0.7], atol=1e-14)
    qd = oracle.assemble_rates(q, np.array([0.3, 0.1, 1.1]), fixed=[2])
    np.testing.assert_allclose(qd, [0.0, 0.0, 1.1], atol=1e-14)
    torque, qdd, *_ = oracle.constrained_hybrid_dynamics(q, qd, np.array([2.5]), [2])
    tau = np.array([0.0, 0.0, torque[0]])
    again, *_ = oracle.constrained_forward_dynamics(q, qd, tau)
    np.testing.assert_allclose(again, qdd, atol=1e-11)
    np.testing.assert_allclose(qdd, [0.0, 0.0, 2.5], atol=1e-12)
