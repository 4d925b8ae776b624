"""The exported model in MuJoCo: frequencies, sag, torques, damping, gauges."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import mujoco
import mujoco_arm
import numpy as np
import pytest
from segmented_robots import rod, spatial_text

from denoc_ros.cli.postures import posture
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, ModelError, SolverError
from denoc_ros.export.mjcf import mjcf
from denoc_ros.export.mujoco_chain import ChainComparison, MujocoChain, compare
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.model.overrides import with_overrides

ROBOTS = Path(__file__).resolve().parents[2] / 'config' / 'robots'
# wrists of the book with inertia about one axis alone
IMPOSSIBLE = ('puma', 'stanford', 'stanford_flexible')
SHIPPED = sorted(path.stem for path in ROBOTS.glob('*.urdf') if path.stem not in IMPOSSIBLE)
FLEXIBLE = [name for name in SHIPPED if '<beam' in (ROBOTS / f'{name}.urdf').read_text()]
GRAVITY = (0.3, -1.0, -0.5)
CONVERGED = 16  # segments of our own model: its lowest frequencies are then right to 1e-4


def robot_of(source: Path | str, segments: int = 1) -> Robot:
    """A robot, its beams divided; one that floats without gravity."""
    tree = load_robot(source).tree
    beams = [beam.link for beam in whole_beams(tree) if segments > 1]
    divided = {f'beam.{link}.segments': segments for link in beams}
    tree = with_overrides(tree, divided)
    floats = any(body.floating for body in tree.bodies)
    return Robot(tree, gravity=(0.0, 0.0, 0.0) if floats else GRAVITY)


def compared(robot: Robot, hinges: int) -> ChainComparison:
    """A robot with all joints at zero, or closed near it, beside its chain."""
    q = posture(robot, [0.0] * len(robot.joint_names)).q
    return compare(robot, mjcf(robot.tree, robot.gravity, hinges).text, q)


def planes(robot: Robot) -> int:
    """Number of the robot's deformations: so many lowest frequencies have one hump each."""
    return sum(modes > 0 for beam in whole_beams(robot.tree) for modes in beam.segment.modes)


@pytest.mark.parametrize('name', FLEXIBLE)
def test_frequencies_and_sag_are_those_of_a_converged_model(name: str) -> None:
    coarse, fine = (robot_of(ROBOTS / f'{name}.urdf', n) for n in (1, CONVERGED))
    q = posture(fine, [0.0] * len(fine.joint_names)).q
    count = 2 * planes(fine)
    for hinges, bound in ((8, 1e-2), (16, 3e-3), (32, 1e-3)):
        found = compare(fine, mjcf(coarse.tree, coarse.gravity, hinges).text, q)
        np.testing.assert_allclose(found.mujoco[:count], found.ours[:count], rtol=bound)
        assert found.sags
        assert max(sag.difference for sag in found.sags) < 1e-3


def test_a_force_at_the_tip_bends_a_chain_exactly() -> None:
    # F l^3 / (3 EI) whatever the number of hinges
    text = f"""<robot name="weight"><link name="base"/>{rod('strip', 1.0, 1e-9)}
    <link name="ball"><inertial><mass value="1e-4"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="clamp" type="fixed"><parent link="base"/><child link="strip"/></joint>
    <joint name="end" type="fixed"><parent link="strip"/><child link="ball"/>
    <origin xyz="1 0 0"/></joint><flexibility><beam link="strip" length="1">
    <bending direction="y" ei="2" modes="2"/></beam></flexibility></robot>"""
    robot = load_robot(text, gravity=(0.0, -1.0, 0.0))
    for hinges in (1, 2, 3, 5, 8):
        chain = MujocoChain(mjcf(robot.tree, robot.gravity, hinges).text, {})
        chain.settle()
        sag = chain.site('strip/tip', 'strip')[1]
        assert sag == pytest.approx(-1e-4 / (3.0 * 2.0), rel=2e-5)  # 1e-9 kg of strip, (u / l)^2


def test_every_rod_counts_in_space() -> None:
    # two beams off their links' axes that bend, twist and carry links where they stand
    robot = load_robot(spatial_text(6), gravity=GRAVITY)
    found = compared(robot, 48)
    # its sections are so wide that MuJoCo's rods need their rotary inertia, which lowers the rest
    np.testing.assert_allclose(found.mujoco[:2], found.ours[:2], rtol=2e-3)
    np.testing.assert_allclose(found.mujoco[:6], found.ours[:6], rtol=8e-3)
    assert max(sag.difference for sag in found.sags) < 3e-3


@pytest.mark.parametrize('name', [name for name in SHIPPED if name != 'clamped_beam'])
def test_rigid_torques_equal_mujocos(name: str) -> None:
    text = (ROBOTS / f'{name}.urdf').read_text()
    text = re.sub(r'<sensor[^>]*/>|damping_ratio="[^"]*"', '', text)
    tree = load_robot(text).tree
    stiff: dict[str, float] = {}
    for body in tree.bodies:
        for part in ('y', 'z', 'torsion'):
            if body.beam is not None and getattr(body.beam, part) is not None:
                stiff[f'beam.{body.name}.{part}.modes'] = 0
        if body.joint is not None:
            stiff[f'joint.{body.joint.name}.friction'] = 0.0
    robot = Robot(with_overrides(tree, stiff), gravity=GRAVITY)
    chain = MujocoChain(mjcf(robot.tree, robot.gravity).text, {})
    rng = np.random.default_rng(7)
    for _ in range(5):
        q, qd, qdd = np.zeros((3, robot.n))
        at = robot.joint_indices
        q[at], qd[at], qdd[at] = rng.uniform(-1.0, 1.0, (3, len(at)))
        ours = robot.inverse_dynamics(q, qd, qdd)[at]
        rows = [dict(zip(robot.joint_names, x[at], strict=True)) for x in (q, qd, qdd)]
        theirs = chain.inverse_dynamics(*rows)
        found = [theirs[name] for name in robot.joint_names]
        # MuJoCo wants moments of inertia about a rod's axis: 1e-10 of the others
        np.testing.assert_allclose(found, ours, rtol=0.0, atol=1e-8 * (1.0 + np.abs(ours).max()))


def test_elastic_joints_are_two_hinges() -> None:
    robot = load_robot(mujoco_arm.urdf(), gravity=(0.0, 0.0, -9.81))
    found = compared(robot, 1)
    np.testing.assert_allclose(found.mujoco, found.ours, rtol=1e-6)


def test_modes_keep_their_damping() -> None:
    text = (ROBOTS / 'one_flexible_link.urdf').read_text()
    text = re.sub(r'damping_ratio="[^"]*"', 'damping_ratio="0.01 0.004"', text)
    robot = load_robot(text, gravity=(0.0, 0.0, 0.0))
    still = dict.fromkeys(robot.joint_names, 0.0)
    chain = MujocoChain(mjcf(robot.tree, robot.gravity, 16).text, still)
    chain.settle()
    data, model = chain.data, chain.model
    damping = np.zeros((model.nv, model.nv))
    for k in range(model.nv):
        data.qvel[:] = np.eye(model.nv)[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        damping[:, k] = -data.qfrc_passive
    free = chain.free
    frequencies, shapes = chain.natural_modes()
    modal = np.einsum('ij,ik,kj->j', shapes, damping[np.ix_(free, free)], shapes)
    ratios = modal / (4.0 * np.pi * frequencies)
    np.testing.assert_allclose(ratios[:2], [0.01, 0.004], rtol=2e-2)
    assert (ratios[2:] > 0.004).all()  # no mode of the chain rings on for ever


def test_gauges_read_what_the_beam_does() -> None:
    robot = robot_of(ROBOTS / 'canadarm_gauges.urdf', 16)
    q = posture(robot, [0.2, 0.4, -0.3]).q
    names = dict(zip(robot.joint_names, q[robot.joint_indices], strict=True))
    chain = MujocoChain(mjcf(robot.tree, robot.gravity, 32).text, names)
    chain.settle()
    ours = robot.sensor_values(q)
    for sensor, value in zip(robot.tree.sensors, ours, strict=True):
        raw = (value - sensor.offset) / sensor.gain if sensor.gain != 1.0 else value
        assert chain.sensor(sensor.name)[0] == pytest.approx(raw, rel=2e-3)


@pytest.mark.parametrize('name', ['canadarm', 'five_bar_frrf'])
def test_the_time_step_is_stable(name: str) -> None:
    robot = robot_of(ROBOTS / f'{name}.urdf')
    q = posture(robot, [0.0] * len(robot.joint_names)).q
    names = dict(zip(robot.joint_names, q[robot.joint_indices], strict=True))
    chain = MujocoChain(mjcf(robot.tree, robot.gravity, 8).text, {}, names)
    for _ in range(400):
        mujoco.mj_step(chain.model, chain.data)
    assert np.isfinite(chain.data.qpos).all()
    assert np.abs(chain.data.qvel).max() < 1e3
    assert not chain.data.warning.number.any()


def test_what_mjcf_cannot_hold_is_refused_by_name() -> None:
    for name in IMPOSSIBLE:
        with pytest.raises(
            ModelError, match=r"link 'link_4': inertia must be that of a real body"
        ):
            mjcf(load_robot(ROBOTS / f'{name}.urdf').tree, np.zeros(3))
    loose = mujoco_arm.urdf().replace('stiffness="20000.0"', 'stiffness="20000.0" backlash="0.01"')
    with pytest.raises(ModelError, match=r"'joint1': backlash must be 0 in MJCF"):
        mjcf(load_robot(loose).tree, np.zeros(3))
    bar = (ROBOTS / 'four_bar_rrr.urdf').read_text()
    damped = bar.replace('</loop>', '<dynamics damping="1"/></loop>')
    with pytest.raises(ModelError, match=r"loop 'joint_4': damping and friction must be 0"):
        mjcf(load_robot(damped).tree, np.zeros(3))
    slide = bar.replace('name="joint_4" type="revolute"', 'name="joint_4" type="prismatic"')
    with pytest.raises(ModelError, match='type must be revolute, spherical or fixed in MJCF'):
        mjcf(load_robot(slide).tree, np.zeros(3))
    with pytest.raises(ModelError, match='segments: must be 1 to 200, got 0'):
        mjcf(load_robot(bar).tree, np.zeros(3), 0)


def test_mujoco_that_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    text = mjcf(load_robot(ROBOTS / 'rigid_pendulum.urdf').tree, np.zeros(3)).text
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    with pytest.raises(ConfigError, match=r"MuJoCo must be installed \(pip install 'denoc_ros"):
        MujocoChain(text, {})
    monkeypatch.undo()
    with pytest.raises(ConfigError, match='the model must be one for MuJoCo, got'):
        MujocoChain(text.replace('hinge', 'knee'), {})


def test_an_equilibrium_that_is_not_there_is_told() -> None:
    robot = robot_of(ROBOTS / 'rigid_pendulum.urdf')
    chain = MujocoChain(mjcf(robot.tree, np.array([np.inf, 0.0, 0.0])).text, {})
    with pytest.raises(SolverError, match='an equilibrium must be found in 50 Newton steps'):
        chain.settle()
