"""A robot that MuJoCo simulates, beside our model with many segments."""

from __future__ import annotations

from pathlib import Path

import mujoco_arm
import numpy as np
import pytest
from segmented_robots import rod

from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, ModelError, StateError
from denoc_ros.export.mujoco_robot import MujocoRobot, MujocoSettings
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.model.overrides import with_overrides
from denoc_ros.simulation.simulated_robot import Drives, ModalRobot
from denoc_ros.types import Array

ROBOTS = Path(__file__).resolve().parents[2] / 'config' / 'robots'
STEP = 1e-3
GRAVITY = (0.3, -1.0, -0.5)
SENSORS = """<sensor name="root" type="strain_gauge" link="boom" station="0.1" direction="y"
surface="0.02" topic="/root"/><sensor name="tip" type="imu" link="hand" topic="/imu"/>"""


def arm_text(floating: bool = False) -> str:
    """A hub, a boom that bends in both planes and twists, a hand with a ball at its end."""
    base = 'type="floating"' if floating else 'type="fixed"'
    return f"""<robot name="arm"><link name="world"/>
    <link name="hub"><inertial><mass value="30"/><inertia ixx="3" iyy="4" izz="5" ixy="0" ixz="0"
    iyz="0"/></inertial></link>{rod('boom', 2.0, 2.0, 5e-4)}
    <link name="hand"><inertial><origin xyz="0.1 0 0.05"/><mass value="1"/><inertia ixx="0.01"
    iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.3 0 0"/><geometry><sphere radius="0.05"/></geometry></collision>
    </link>
    <joint name="base" {base}><parent link="world"/><child link="hub"/>
    <origin xyz="0 0 1" rpy="0.2 -0.1 0.4"/></joint>
    <joint name="j1" type="revolute"><parent link="hub"/><child link="boom"/>
    <origin xyz="0.2 0 0.1"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="100" velocity="9"/></joint>
    <joint name="j2" type="revolute"><parent link="boom"/><child link="hand"/>
    <origin xyz="2 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="9"/></joint>
    <flexibility><beam link="boom" length="2"><bending direction="y" ei="400" modes="2"/>
    <bending direction="z" ei="600" modes="2"/><torsion gj="300" modes="1"/></beam>
    <actuator joint="j1" armature="0.3"/><actuator joint="j2" armature="0.1"/>
    {SENSORS}</flexibility></robot>"""


def drives_of(
    robot: Robot, kp: float = 0.0, kd: float = 0.0, posture: Array | None = None
) -> Drives:
    motion = driven_motion(robot, posture=posture)
    count = len(motion.joints)
    return Drives(motion.given, motion.index, np.full(count, kp), np.full(count, kd))


def in_mujoco(
    robot: Robot, start: Array, drives: Drives | None = None, **given: object
) -> MujocoRobot:
    settings = MujocoSettings()._replace(**given)  # type: ignore[arg-type]
    return MujocoRobot(robot, robot.tree, STEP, start, drives or drives_of(robot), settings)


def divided(robot: Robot, segments: int = 8) -> Robot:
    changes = {f'beam.{beam.link}.segments': segments for beam in whole_beams(robot.tree)}
    return Robot(with_overrides(robot.tree, changes), tuple(robot.gravity))


def test_it_moves_and_reads_as_a_model_of_many_segments() -> None:
    robot = load_robot(arm_text(), gravity=GRAVITY)
    fine = divided(robot)
    joints = np.array([0.2, -0.3])
    ours = ModalRobot(fine, 0.25 * STEP, fine.static_deflection(joints), drives_of(fine))
    theirs = in_mujoco(robot, robot.static_deflection(joints))
    np.testing.assert_allclose(theirs.q[robot.joint_indices], joints, atol=1e-12)
    seen, wanted = list[Array](), list[Array]()
    for k in range(400):
        push = np.array([8.0, 2.0]) * np.sin([6e-3 * k, 9e-3 * k]) ** 2
        tau, tau_fine = np.zeros(robot.n), np.zeros(fine.n)
        tau[robot.joint_indices], tau_fine[fine.joint_indices] = push, push
        theirs.free(tau)
        for _ in range(4):
            ours.free(tau_fine)
        if k % 20 == 19:
            for each, rows in ((theirs, seen), (ours, wanted)):
                place, rate = np.zeros((2, 6))
                each.tip_deflections(place, rate)
                at = each.robot.joint_indices
                strain, gyro = 100.0 * each.sensor_values()[0], each.inertial_values()[1:4]
                rows.append(np.hstack([each.q[at], each.qd[at], place, rate, strain, gyro]))
    found, there = np.array(seen), np.array(wanted)
    largest = np.abs(there).max(axis=0)
    np.testing.assert_array_less(np.abs(found - there).max(axis=0), 0.02 * largest + 1e-4)
    assert largest.min() > 1e-4  # every number moves


def test_an_imu_reads_gravity_at_rest() -> None:
    robot = load_robot(arm_text(), gravity=GRAVITY)
    drives = drives_of(robot)
    theirs = in_mujoco(robot, robot.static_deflection([0.2, -0.3]), drives)
    for _ in range(5):
        theirs.hold()
    wanted = robot.sensor_values(theirs.q, theirs.qd, np.zeros(robot.n))[1:]
    np.testing.assert_allclose(theirs.inertial_values()[1:4], np.zeros(3), atol=1e-9)
    np.testing.assert_allclose(theirs.inertial_values()[4:], wanted[3:], atol=2e-3)


def test_held_and_driven_joints_move_as_they_are_told() -> None:
    robot = load_robot(arm_text(), gravity=GRAVITY)
    theirs = in_mujoco(robot, robot.static_deflection([0.2, -0.3]))
    at = robot.joint_indices
    for _ in range(50):
        theirs.hold()
    np.testing.assert_array_equal(theirs.q[at], [0.2, -0.3])
    np.testing.assert_allclose(theirs.qd, 0.0, atol=1e-7)  # equilibrium stays
    accelerations = np.array([0.7, -1.1])
    for _ in range(100):
        theirs.drive(accelerations)
    np.testing.assert_allclose(theirs.qd[at], 0.1 * accelerations, rtol=1e-9)
    np.testing.assert_allclose(theirs.q[at], [0.2, -0.3] + 0.005 * accelerations, rtol=1e-9)
    assert np.abs(theirs.qd).max() > 1e-3


def test_feedback_of_its_own_holds_it() -> None:
    robot = load_robot(arm_text(), gravity=GRAVITY)
    drives = drives_of(robot, 2000.0, 300.0)
    start = robot.static_deflection([0.2, -0.3])
    theirs = in_mujoco(robot, start, drives)
    tau = np.zeros(robot.n)
    tau[drives.coordinates] = 2000.0 * np.array([0.25, -0.3])
    for _ in range(2500):
        theirs.controlled(tau)
    settled = robot.inverse_dynamics(
        robot.static_deflection([0.25, -0.3]), *np.zeros((2, robot.n))
    )
    wanted = [0.25, -0.3] - settled[drives.coordinates] / 2000.0
    np.testing.assert_allclose(theirs.q[drives.coordinates], wanted, atol=2e-3)


def test_a_floating_base_moves_as_ours() -> None:
    robot = load_robot(arm_text(floating=True), gravity=(0.0, 0.0, 0.0))
    fine = divided(robot)
    start, start_fine = np.zeros(robot.n), np.zeros(fine.n)
    for q, model in ((start, robot), (start_fine, fine)):
        q[model.base_indices] = [0.1, -0.2, 0.3, 0.4, -0.5, 0.6]
        q[model.joint_indices] = [0.3, -0.4]
    ours = ModalRobot(fine, 0.25 * STEP, start_fine, drives_of(fine))
    theirs = in_mujoco(robot, start)
    np.testing.assert_allclose(theirs.q, start, atol=1e-12)
    for k in range(300):
        push = 5.0 * np.sin(8e-3 * k) * np.array([1.0, -0.3])
        tau, tau_fine = np.zeros(robot.n), np.zeros(fine.n)
        tau[robot.joint_indices], tau_fine[fine.joint_indices] = push, push
        theirs.free(tau)
        for _ in range(4):
            ours.free(tau_fine)
    for found, wanted in ((theirs.q, ours.q), (theirs.qd, ours.qd)):
        there = wanted[fine.base_indices]
        np.testing.assert_allclose(found[robot.base_indices], there, atol=2e-3)
    assert np.abs(ours.qd[fine.base_indices]).max() > 5e-3
    momentum = robot.momentum(theirs.q, theirs.qd)
    np.testing.assert_allclose(momentum, 0.0, atol=2e-2)  # of the model's projection of it


def test_elastic_joints_move_as_ours() -> None:
    robot = load_robot(mujoco_arm.urdf(), gravity=(0.0, 0.0, -9.81))
    start = robot.static_deflection(mujoco_arm.START)
    ours = ModalRobot(robot, 0.1 * STEP, start, drives_of(robot))
    theirs = in_mujoco(robot, start)
    np.testing.assert_allclose(theirs.q, start, atol=1e-8)
    for _ in range(200):
        theirs.free(np.zeros(robot.n))
        for _ in range(10):
            ours.free(np.zeros(robot.n))
    np.testing.assert_allclose(theirs.q, ours.q, atol=1e-4)


def test_loops_stay_closed() -> None:
    robot = load_robot(ROBOTS / 'five_bar_frrf.urdf', gravity=GRAVITY)
    posture = robot.assemble(np.zeros(robot.n))
    joints = [name for name in robot.joint_names if robot.tree.loops][:2]
    motion = driven_motion(robot, joints, posture=posture)
    drives = Drives(motion.given, motion.index, np.zeros(2), np.zeros(2))
    theirs = in_mujoco(robot, motion.posture, drives, segments=4)
    tau = np.zeros(robot.n)
    tau[drives.coordinates] = 0.01
    for _ in range(100):
        theirs.free(tau)
    assert np.abs(theirs.qd[drives.coordinates]).max() > 1e-3
    apart = [
        np.linalg.norm(
            theirs.data.site(loop.parent.frame).xpos - theirs.data.site(loop.child.frame).xpos
        )
        for loop in robot.tree.loops
    ]
    assert max(apart) < 1e-4


def test_a_step_depends_on_state_and_effort_only() -> None:
    robot = load_robot(arm_text(), gravity=GRAVITY)
    start = robot.static_deflection([0.2, -0.3])
    theirs, again = in_mujoco(robot, start), in_mujoco(robot, start)
    tau = np.linspace(-1.0, 1.0, robot.n)
    for _ in range(20):
        theirs.free(tau)
    again.follow(theirs)
    for each in (theirs, again):
        for _ in range(20):
            each.free(tau)
    np.testing.assert_array_equal(theirs.q, again.q)
    np.testing.assert_array_equal(theirs.qdd, again.qdd)
    theirs.place()
    np.testing.assert_array_equal(theirs.q, theirs.start)
    assert not theirs.qd.any()


FLOOR = """<mujoco model="floor"><worldbody><geom name="floor" type="plane" size="9 9 1"
pos="0 0 {z}" solref="0.004 1" priority="1"/></worldbody></mujoco>"""


def test_the_hand_stops_at_the_floor_of_a_scene(tmp_path: Path) -> None:
    scene = tmp_path / 'floor.xml'
    robot = load_robot(arm_text().replace('rpy="0.2 -0.1 0.4"', ''), gravity=(0.0, 0.0, 0.0))
    turned, depths = [], []
    for z in (-9.0, 0.85):  # its ball, 0.3 m out, touches that one at asin(0.2 / 0.3) = 0.73 rad
        scene.write_text(FLOOR.format(z=z))
        theirs = in_mujoco(robot, np.zeros(robot.n), scene=str(scene))
        assert theirs.model.geom('scene/floor').id >= 0
        tau = np.zeros(robot.n)
        tau[robot.joint_indices[1]] = 2.0
        lowest = np.inf
        for _ in range(600):
            theirs.free(tau)
            hand = theirs.data.body('hand')
            lowest = min(lowest, hand.xpos[2] + 0.3 * hand.xmat[6] - 0.05 - z)
        depths.append(lowest)
        turned.append(theirs.q[robot.joint_indices[1]])
    assert turned[0] > 2.0 * turned[1] > 1.0
    assert depths[0] > 9.0
    assert -2e-3 < depths[1] < 1e-3  # it touches, and hardly sinks in


def test_what_a_scene_must_not_be_is_refused(tmp_path: Path) -> None:
    robot = load_robot(arm_text(), gravity=GRAVITY)
    start = robot.static_deflection([0.2, -0.3])
    file = tmp_path / 'scene.xml'
    with pytest.raises(ModelError, match='the file must be readable, got'):
        in_mujoco(robot, start, scene=str(file))
    file.write_text('<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><mujoco>&b;</mujoco>')
    with pytest.raises(ModelError, match='no DOCTYPE and no entities'):
        in_mujoco(robot, start, scene=str(file))
    file.write_text('<robot name="a"/>')
    with pytest.raises(ModelError, match='the root element must be <mujoco>, got <robot>'):
        in_mujoco(robot, start, scene=str(file))
    file.write_text('<mujoco><worldbody><geom type="cloud"/></worldbody></mujoco>')
    with pytest.raises(ConfigError, match='the scene must be a model for MuJoCo, got'):
        in_mujoco(robot, start, scene=str(file))


def test_a_state_that_is_lost_is_told(capfd: pytest.CaptureFixture[str]) -> None:
    robot = load_robot(arm_text(), gravity=GRAVITY)
    theirs = in_mujoco(robot, robot.static_deflection([0.2, -0.3]))
    with pytest.raises(StateError, match='the state must be finite'):
        theirs.free(np.full(robot.n, np.nan))
    theirs.place()
    theirs.hold()
    assert np.isfinite(theirs.q).all()
