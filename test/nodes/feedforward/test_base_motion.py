"""Nodes whose robot stands on a base that moves: `base_motion` in, and what thrusters give out."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from base_robots import floating
from feedforward_bench import FeedforwardBench, joint_state, point
from geometry_msgs.msg import AccelStamped, WrenchStamped
from nav_msgs.msg import Odometry
from node_robots import GRAVITY, JOINTS, two_links
from sensor_msgs.msg import Imu, JointState

from denoc_ros.dynamics.base.reacting_base import ReactingBase
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.nodes.predictor import PredictorNode

pytestmark = pytest.mark.ros

FORCE = (3.0, 8.0, 1.0)  # m/s^2, what an accelerometer on the base shows
RATE = (0.2, -0.1, 0.3)  # rad/s
HUB = '<inertial><mass value="20"/><inertia ixx="2" iyy="2" izz="2" ixy="0" ixz="0" iyz="0"/>'


@pytest.fixture
def adrift(tmp_path: Path) -> str:
    file = tmp_path / 'adrift.urdf'
    file.write_text(floating(two_links(), f'{HUB}</inertial>'))
    return str(file)


def imu(stamp_ns: int, force: tuple[float, ...] = FORCE) -> Imu:
    message = Imu()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    rate, acceleration = message.angular_velocity, message.linear_acceleration
    rate.x, rate.y, rate.z = RATE
    acceleration.x, acceleration.y, acceleration.z = force
    return message


def expected(urdf: str, posture: list[float]) -> Any:
    """Torque of rigid links at rest on the base that the IMU says."""
    robot = load_robot(urdf, gravity=(0, 0, 0))
    q, zero = np.zeros((2, robot.n))
    q[robot.joint_indices] = posture
    base = ((0, 0, 0, *RATE), (*FORCE, 0, 0, 0))
    return robot.inverse_dynamics(q, zero, zero, base=base)[robot.joint_indices]


def feed(bench: FeedforwardBench, publisher: Any, make: Any, condition: Any) -> None:
    sent = [0.0]

    def fed() -> object:
        if time.perf_counter() - sent[0] > 0.01:
            sent[0] = time.perf_counter()
            publisher.publish(make(time.time_ns()))
        return condition()

    bench.until(fed)


@pytest.mark.parametrize('place', [(0.0, 0.0, 0.0), (0.4, -2.0, 0.5)])
def test_feedforward_takes_the_base_from_an_imu(
    graph: Any, urdf: str, place: tuple[float, ...]
) -> None:
    bench = FeedforwardBench(
        graph, urdf, base_motion='imu', base_motion_timeout=0.5, enforce_command_limits=False,
        max_delta_tau=1e3, base_imu_xyz=list(place),
    )  # fmt: skip
    # a steady turn: the IMU feels the centripetal acceleration of its place as well
    felt = tuple(np.array(FORCE) + np.cross(RATE, np.cross(RATE, place)))

    def reading(stamp_ns: int) -> Imu:
        return imu(stamp_ns, felt)

    bench.until(lambda: bench.cause == 'no base_motion yet')
    publisher = graph.publisher(Imu, 'base_motion')
    posture = [0.3, -0.5]
    bench.follow(*(_hold(posture)))
    feed(bench, publisher, reading, lambda: bench.cause == 'following')
    wanted = expected(urdf, posture)

    def arrived() -> bool:
        return bool(
            bench.commands and np.allclose(bench.commands[-1].data, wanted, rtol=1e-6, atol=1e-6)
        )

    feed(bench, publisher, reading, arrived)
    # nothing comes any more: the safe command, which says why
    bench.until(lambda: bench.cause == 'stale base_motion')


def _hold(posture: list[float]) -> list[Any]:
    return [point(0.0, posture, [0.0, 0.0]), point(9.0, posture, [0.0, 0.0])]


def test_bad_readings_of_the_base_are_refused_and_counted(graph: Any, urdf: str) -> None:
    bench = FeedforwardBench(graph, urdf, base_motion='imu')
    publisher = graph.publisher(Imu, 'base_motion')
    monitor = next(m for m in bench.node.monitors if m.topic.endswith('base_motion'))
    publisher.publish(imu(10**9, (np.nan, 0.0, 0.0)))
    bench.until(lambda: monitor.rejected['non_finite'] == 1)
    publisher.publish(imu(10**9, (2e6, 0.0, 0.0)))
    bench.until(lambda: monitor.rejected['out_of_range'] == 1)
    publisher.publish(imu(2 * 10**9))
    publisher.publish(imu(10**9))
    bench.until(lambda: monitor.rejected['backwards_stamp'] == 1)
    assert monitor.accepted == 1
    publisher.publish(imu(2 * 10**9 + 10**7, (0.0, 210.0, 0.0)))
    bench.until(lambda: monitor.rejected['out_of_range'] == 2)
    assert 'acceleration must be at most 200 m/s^2, got 210' in monitor.last_message


def test_a_gyroscope_that_says_what_no_base_does_leaves_no_ringing(graph: Any, urdf: str) -> None:
    """It says +-1000 rad/s for a while; the amplitudes stay those of before."""
    bench = FeedforwardBench(
        graph, urdf, base_motion='imu', base_motion_timeout=0.5, enforce_command_limits=False,
        max_delta_tau=1e3,
    )  # fmt: skip
    publisher = graph.publisher(Imu, 'base_motion')
    monitor = next(m for m in bench.node.monitors if m.topic.endswith('base_motion'))
    posture = [0.3, -0.5]
    bench.follow(*(_hold(posture)))
    wanted = expected(urdf, posture)
    size = np.abs(wanted).max()

    def off() -> float:
        last = bench.commands[-1].data if bench.commands else np.inf
        return float(np.abs(np.array(last) - wanted).max() / size)

    feed(bench, publisher, imu, lambda: bench.cause == 'following' and off() < 1e-6)

    def wild(stamp_ns: int) -> Imu:
        message = imu(stamp_ns)
        message.angular_velocity.z = 1000.0 if stamp_ns // 10**7 % 2 else -1000.0
        return message

    feed(bench, publisher, wild, lambda: bench.cause == 'stale base_motion')
    assert monitor.rejected['out_of_range'] > 10
    feed(bench, publisher, imu, lambda: bench.cause == 'following')
    for _ in range(5):
        count, causes = len(bench.commands), {bench.cause}

        def whole(count: int = count, causes: set[str] = causes) -> bool:
            causes.add(bench.cause)
            return len(bench.commands) > count + 400

        feed(bench, publisher, imu, whole)
        if causes == {'following'}:  # else the machine paused, and the readings were stale
            break
    rung = np.array([command.data for command in bench.commands[count + 200 :]]) - wanted
    assert np.abs(rung).max() < 1e-3 * size


def test_predictor_on_a_base_by_odometry_and_acceleration(graph: Any, urdf: str) -> None:
    """A base that accelerates steadily bends the links as so much gravity does."""
    node = graph.add(
        PredictorNode, urdf_path=urdf, gravity=GRAVITY, update_rate=200.0,
        joint_state_timeout=1.0, base_motion='odometry_accel', base_motion_timeout=1.0,
    )  # fmt: skip
    found = graph.collect(JointState, 'predictor/modal_state')
    joints = graph.publisher(JointState, 'joint_states')
    odometry = graph.publisher(Odometry, 'base_motion')
    beside = graph.publisher(AccelStamped, 'base_acceleration')

    def send(with_base: bool) -> None:
        now = time.time_ns()
        joints.publish(joint_state(JOINTS, [0.2, 0.1], now))
        if not with_base:
            return
        pose, acceleration = Odometry(), AccelStamped()
        for message in (pose, acceleration):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        pose.pose.pose.orientation.z = pose.pose.pose.orientation.w = np.sqrt(0.5)  # a quarter
        acceleration.accel.linear.x = 2.0
        beside.publish(acceleration)
        odometry.publish(pose)

    for _ in range(20):
        send(False)
        graph.spin(0.01)
    assert not found
    robot = load_robot(urdf, gravity=GRAVITY)
    turn = np.eye(4)
    turn[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    still = robot.static_deflection([0.2, 0.1], base=((0,) * 6, (2.0, 0, 0, 0, 0, 0), turn))
    names = list(robot.coordinate_names)

    def settled() -> bool:
        send(True)
        if not found:
            return False
        got = dict(zip(found[-1].name, found[-1].position, strict=True))
        return bool(np.allclose([got[name] for name in names], still, atol=2e-5))

    graph.until(settled)
    assert np.abs(still - robot.static_deflection([0.2, 0.1])).max() > 1e-4
    assert node.observer.base is not None


def test_thrusters_hold_a_base_that_would_float(graph: Any, adrift: str) -> None:
    wrenches = graph.collect(WrenchStamped, '/feedforward/base_wrench')
    bench = FeedforwardBench(
        graph, adrift, base='free_flying', enforce_command_limits=False, max_delta_tau=1e3
    )
    posture = [0.3, -0.5]
    bench.follow(*_hold(posture))
    bench.until(lambda: bench.cause == 'following' and wrenches)
    robot = load_robot(adrift, gravity=GRAVITY)
    q, zero = np.zeros((2, robot.n))
    q[robot.joint_indices] = posture
    tau = robot.inverse_dynamics(q, zero, zero)
    wanted = robot.base_wrench(q, tau)

    def arrived() -> bool:
        force, torque = wrenches[-1].wrench.force, wrenches[-1].wrench.torque
        got = [force.x, force.y, force.z, torque.x, torque.y, torque.z]
        return bool(np.allclose(got, wanted, atol=1e-6))

    bench.until(lambda: wrenches and bench.commands)
    bench.until(arrived)
    assert wrenches[-1].header.frame_id == 'base'
    bench.until(
        lambda: (
            bench.commands
            and np.allclose(bench.commands[-1].data, tau[robot.joint_indices], atol=1e-6)
        )
    )


@pytest.mark.parametrize('model', ['rigid', 'flexible'])
def test_a_free_floating_base_falls_and_asks_for_no_torque(
    graph: Any, adrift: str, model: str
) -> None:
    """In free fall nothing has a weight: joints at rest take no torque."""
    bench = FeedforwardBench(
        graph, adrift, model=model, enforce_command_limits=False, max_delta_tau=1e3
    )
    bench.follow(*_hold([0.3, -0.5]))
    bench.until(lambda: bench.cause == 'following')
    bench.until(lambda: bench.commands and np.abs(bench.commands[-1].data).max() < 1e-6)


def test_a_base_that_drifts_turns_as_its_imu_says(graph: Any, adrift: str) -> None:
    """The base reacts, and centrifugal forces of its measured turn act on the arm."""
    bench = FeedforwardBench(
        graph, adrift, base='drifting', base_motion='imu', base_motion_timeout=0.5,
        enforce_command_limits=False, max_delta_tau=1e3,
    )  # fmt: skip
    bench.until(lambda: bench.cause == 'no base_motion yet')
    publisher = graph.publisher(Imu, 'base_motion')
    posture = [0.3, -0.5]
    bench.follow(*_hold(posture))
    robot = load_robot(adrift, gravity=GRAVITY)
    q, qd, qdd = np.zeros((3, robot.n))
    q[robot.joint_indices] = posture
    base = ReactingBase(robot)
    base.twist = np.array([0.0, 0.0, 0.0, *RATE])
    base.rates(q, qd)
    base.accelerations(q, qd, qdd)
    wanted = robot.inverse_dynamics(q, qd, qdd)[robot.joint_indices]
    assert np.abs(wanted).min() > 0.02

    def arrived() -> bool:
        return bool(bench.commands and np.allclose(bench.commands[-1].data, wanted, rtol=1e-4))

    # what the IMU feels of gravity and of the arm's pull does not matter
    feed(bench, publisher, imu, arrived)
    bench.until(lambda: bench.cause == 'stale base_motion')


def test_a_base_that_drifts_must_be_measured(graph: Any, adrift: str) -> None:
    given = {'urdf_path': adrift, 'base': 'drifting', 'base_motion': 'accel'}
    node = graph.add(FeedforwardNode, parameters=given, start=False)
    node.trigger_configure()
    assert node.state == 'unconfigured'
    rule = "parameter 'base_motion' must be one of odometry, odometry_accel, imu where 'base' is"
    assert f"{rule} drifting, got 'accel'" in node.failure


def test_a_plant_afloat_says_how_its_base_moves(graph: Any, adrift: str) -> None:
    """Arm braked, all falls: as a sensor on the base has it, and a predictor that uses it."""
    found = graph.collect(Odometry, '/base_motion')
    predicted = graph.collect(JointState, 'predictor/modal_state')
    graph.add(
        PredictorNode, urdf_path=adrift, gravity=GRAVITY, update_rate=100.0,
        joint_state_timeout=1.0, base_motion='odometry', base_motion_timeout=1.0,
    )  # fmt: skip
    plant = graph.add(PlantNode, urdf_path=adrift, gravity=GRAVITY, update_rate=100.0)
    graph.until(lambda: len(found) > 60 and len(predicted) > 20)
    robot = plant.robot
    assert (found[0].header.frame_id, found[0].child_frame_id) == ('world_', 'base')
    heights = np.array([m.pose.pose.position.y for m in found])
    speeds = np.array([m.twist.twist.linear.y for m in found])
    # free fall, whatever steps a busy machine leaves out: v^2 = 2 g h
    assert heights[-1] < heights[0] - 0.05
    gained = speeds**2 - speeds[0] ** 2
    np.testing.assert_allclose(gained, 2.0 * GRAVITY[1] * (heights - heights[0]), atol=0.02)
    # what falls has no weight: the links stay straight, and the predictor says so
    # (at one time at least: steps left out look like blows to what differentiates velocities)
    names = list(predicted[-1].name)
    bends = [k for k, name in enumerate(names) if '/' in name]
    straight = min(np.abs(np.array(m.position)[bends]).max() for m in predicted)
    carried = load_robot(two_links(), gravity=GRAVITY).static_deflection([0.0, 0.0])
    assert straight < 0.1 * np.abs(carried).max()
    assert robot.joint_names == tuple(JOINTS)
