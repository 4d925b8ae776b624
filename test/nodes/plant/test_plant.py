"""The plant node on real DDS."""

from __future__ import annotations

import itertools
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_robots import GRAVITY, gripper, two_links
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.model.plant_description import PlantDescription
from denoc_ros.nodes.base.messages import LATCHED
from denoc_ros.nodes.plant import CATCH_UP, PlantNode
from denoc_ros.nodes.predictor import PredictorNode

pytestmark = pytest.mark.ros
RATE = 200.0


@pytest.fixture
def plant(graph: Any, urdf: str) -> Any:
    def make(**parameters: Any) -> Any:
        given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE, **parameters}
        named = {name.replace('__', '.'): value for name, value in given.items()}
        return graph.add(PlantNode, parameters=named)

    return make


def command(label: str, values: list[float]) -> Float64MultiArray:
    message = Float64MultiArray(data=values)
    message.layout.dim = [MultiArrayDimension(label=label, size=len(values))]
    return message


def test_it_moves_as_the_stepper_says(graph: Any, plant: Any, urdf: str) -> None:
    states = graph.collect(JointState, '/plant/true_modal_state')
    plant(brake=False, start=[-1.0, 0.3])
    graph.until(lambda: len(states) > 100)
    robot = load_robot(urdf, gravity=GRAVITY)
    stepper = Stepper(robot, 1.0 / RATE)
    q = robot.static_deflection([-1.0, 0.3])
    qd, tau = np.zeros(robot.n), np.zeros(robot.n)
    history = []
    for _ in range(1000):
        stepper.free(q, qd, tau)
        history.append(q.copy())
    found = []
    for message in states:
        gaps = np.abs(np.array(history) - np.array(message.position)).max(axis=1)
        assert gaps.min() < 1e-12
        found.append(int(gaps.argmin()))
    # a late tick takes several steps at once, none is lost or done twice
    assert all(later > earlier for earlier, later in itertools.pairwise(found))
    assert tuple(states[0].name) == robot.coordinate_names


def test_plant_of_segments_keeps_the_description_of_the_model(
    graph: Any, plant: Any, urdf: str
) -> None:
    states = graph.collect(JointState, '/plant/true_modal_state')
    tips = graph.collect(JointState, '/plant/true_deflection')
    told: list[String] = []
    graph.probe.create_subscription(String, '/robot_description', told.append, LATCHED)
    node = plant(segments=3, start=[-1.0, 0.3])
    model = load_robot(urdf, gravity=GRAVITY)
    truth = model.with_overrides(PlantDescription(segments=3).overrides(model.tree))
    graph.until(lambda: len(states) > 3 and len(tips) > 3 and told)
    assert told[0].data == Path(urdf).read_text()
    assert tuple(states[-1].name) == truth.coordinate_names != model.coordinate_names
    assert 'one/3/y1' in truth.coordinate_names
    still = truth.static_deflection([-1.0, 0.3])
    np.testing.assert_allclose(states[-1].position, still, atol=1e-9)
    bent = dict(zip(tips[-1].name, tips[-1].position, strict=True))
    whole = truth.tip_deflection('one', still)
    assert [bent[f'one/u{axis}'] for axis in 'xyz'] == pytest.approx(whole, abs=1e-12)
    # numbers of whole beams stay live
    (result,) = node.set_parameters([Parameter('beam.one.y.ei', value=2000.0)])
    assert result.successful, result.reason
    assert node._changes or node.robot.n == truth.n
    (result,) = node.set_parameters([Parameter('segments', value=2)])
    assert not result.successful


def test_mimic_joints_follow_their_leader(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / 'gripper.urdf'
    file.write_text(gripper())
    states = graph.collect(JointState, '/joint_states')
    parameters = {'urdf_path': str(file), 'gravity': GRAVITY, 'update_rate': RATE}
    node = graph.add(PlantNode, parameters={**parameters, 'start': [-1.0, 0.3, 0.4]})
    watcher = graph.add(PredictorNode, parameters={**parameters, 'source': 'torque'})
    assert node.joints == watcher.joints == ['j1', 'j2', 'left']
    publisher = graph.publisher(Float64MultiArray, '/feedforward/commands')
    publisher.publish(command('left,j1', [0.3, 20.0]))
    estimates = graph.collect(JointState, '/predictor/modal_state')
    graph.until(lambda: states and abs(states[-1].position[2] - 0.4) > 0.02)
    graph.until(lambda: len(estimates) > 20)
    for message in [*states, *estimates]:
        position = dict(zip(message.name, message.position, strict=True))
        velocity = dict(zip(message.name, message.velocity, strict=True))
        assert abs(position['right'] - (0.1 - position['left'])) < 1e-12
        assert abs(velocity['right'] + velocity['left']) < 1e-12


def test_a_payload_picked_up_bends_the_running_robot(graph: Any, plant: Any, urdf: str) -> None:
    states = graph.collect(JointState, '/plant/true_modal_state')
    node = plant(damping__one__y=0.5, damping__two__y=0.5)
    graph.until(lambda: len(states) > 5)
    robot = load_robot(urdf, gravity=GRAVITY)
    free = robot.static_deflection([0.0, 0.0])
    np.testing.assert_allclose(states[-1].position, free, atol=1e-9)
    (result,) = node.set_parameters([Parameter('payload.two.mass', value=2.0)])
    assert result.successful, result.reason
    robot.set_payload('two', 2.0)
    loaded = robot.static_deflection([0.0, 0.0])
    graph.until(lambda: np.allclose(states[-1].position, loaded, atol=1e-4))
    assert np.abs(loaded - free).max() > 0.01
    (result,) = node.set_parameters([Parameter('beam.one.y.modes', value=3.0)])
    assert 'must keep its coordinates' in result.reason


def test_the_brake_holds_until_the_first_command(graph: Any, plant: Any) -> None:
    states = graph.collect(JointState, '/joint_states')
    node = plant(start=[0.2, -0.4])
    graph.until(lambda: len(states) > 40)
    np.testing.assert_allclose(states[-1].position, [0.2, -0.4], atol=1e-12)
    publisher = graph.publisher(Float64MultiArray, '/feedforward/commands')
    publisher.publish(command('j2,j1', [5.0, 60.0]))
    graph.until(lambda: node.command_input.accepted == 1)
    graph.until(lambda: list(states[-1].effort) == [60.0, 5.0])
    graph.until(lambda: abs(states[-1].position[0] - 0.2) > 1e-3)


def test_each_step_after_a_pause_has_the_command_that_had_come_by_then(
    graph: Any, urdf: str
) -> None:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE}
    node = graph.add(PlantNode, start=False, parameters=given)
    node.trigger_configure()
    node.begin()
    begin, step = time.perf_counter(), 1.0 / RATE
    node._tick_time = begin
    stepper, tau = Stepper(load_robot(urdf, gravity=GRAVITY), step), np.zeros(node.robot.n)
    q, qd = node.q.copy(), node.qd.copy()
    # one comes before the first step's end, the next before the fourth's, one after the tick's
    for came, torque in ((0.5, 1.0), (3.5, 2.0), (6.5, -1.0)):
        node._on_command(serialize_message(command('j1', [torque])), begin + came * step)
    node.tick(6)
    for torque in (1.0, 1.0, 1.0, 2.0, 2.0, 2.0):
        tau[node._index[0]] = torque
        stepper.free(q, qd, tau)
    np.testing.assert_allclose(node.q, q, rtol=0.0, atol=1e-12)
    node.tick(1)
    tau[node._index[0]] = -1.0
    stepper.free(q, qd, tau)
    np.testing.assert_allclose(node.qd, qd, rtol=0.0, atol=1e-12)


@pytest.fixture
def paused(graph: Any, urdf: str) -> Any:
    """A plant at 1 kHz whose ticks the test makes."""
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': 1000.0}
    node = graph.add(PlantNode, start=False, parameters=given)
    node.trigger_configure()
    node.begin()
    return node


def test_a_pause_of_a_tenth_of_a_second_loses_no_time(paused: Any, urdf: str) -> None:
    node, begin, step, missed = paused, paused._tick_time, 0.001, 100
    for k in range(missed):
        raw = serialize_message(command('j1', [0.1 * k]))
        node._on_command(raw, begin + (k + 0.5) * step)
    stepper, tau = Stepper(load_robot(urdf, gravity=GRAVITY), step), np.zeros(node.robot.n)
    q, qd = node.q.copy(), node.qd.copy()
    node.tick(missed)
    for k in range(missed):
        tau[node._index[0]] = 0.1 * k
        stepper.free(q, qd, tau)
    assert node._lost_steps == 0
    np.testing.assert_allclose(node.q, q, rtol=0.0, atol=1e-9)


def test_a_pause_without_end_is_caught_up_for_a_while_only(
    paused: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    # every look at the clock finds that the time is over
    moments = itertools.count()
    monkeypatch.setattr(time, 'thread_time', lambda: float(next(moments)))
    begin = paused._tick_time
    paused.tick(100_000)
    assert paused._lost_steps == 100_000 - CATCH_UP
    assert paused._tick_time - begin == pytest.approx(100.0)


def test_commands_beyond_the_drives_saturate_and_bad_ones_do_nothing(
    graph: Any, plant: Any
) -> None:
    states = graph.collect(JointState, '/joint_states')
    node = plant()
    publisher = graph.publisher(Float64MultiArray, '/feedforward/commands')
    bad = {
        'non_finite': command('j1,j2', [float('nan'), 1.0]),
        'wrong_length': command('j1,j2', [1.0]),
        'unknown_joint': command('j1,j9', [1.0, 1.0]),
        'unnamed': Float64MultiArray(data=[1.0, 1.0]),
    }
    for cause, message in bad.items():
        publisher.publish(message)
        graph.until(lambda cause=cause: node.command_input.rejected[cause] == 1)
    key = 'feedforward/commands rejected '
    graph.until(lambda: all(graph.value('plant: inputs', key + c) == '1' for c in bad))
    assert not np.any(states[-1].effort)
    publisher.publish(command('j1,j2', [1e9, -1e9]))
    graph.until(lambda: list(states[-1].effort) == [80.0, -80.0])


def test_command_timeout_turns_the_drives_off(graph: Any, plant: Any) -> None:
    states = graph.collect(JointState, '/joint_states')
    plant(command_timeout=0.1)
    publisher = graph.publisher(Float64MultiArray, '/feedforward/commands')
    publisher.publish(command('j1', [7.0]))
    graph.until(lambda: states and states[-1].effort[0] == 7.0)
    graph.until(lambda: states[-1].effort[0] == 0.0)


def test_sensors_send_raw_values_of_the_true_state(graph: Any, plant: Any, urdf: str) -> None:
    modal = graph.collect(JointState, '/plant/true_modal_state')
    strain = graph.collect(Float64, '/strain')
    loads = graph.collect(Float64MultiArray, '/loads')
    named = graph.collect(JointState, '/named')
    deflection = graph.collect(JointState, '/plant/true_deflection')
    plant(noise__sensors=False, start=[0.3, 0.2])
    graph.until(lambda: min(map(len, (modal, strain, loads, named, deflection))) > 5)
    robot = load_robot(urdf, gravity=GRAVITY)
    q = np.array(modal[0].position)  # braked and in equilibrium: the same ever after
    gauge, moment, bend = robot.sensor_values(q, np.zeros(robot.n), np.zeros(robot.n))
    assert abs(gauge) > 1e-5
    assert strain[0].data == pytest.approx((gauge - 1.0e-5) / 2.0e-6, rel=1e-9)
    assert list(loads[0].data) == pytest.approx([0.0, moment / 0.5], rel=1e-9)
    assert named[0].name == ['tip']
    assert list(named[0].position) == pytest.approx([bend], rel=1e-9)
    values = dict(zip(deflection[0].name, deflection[0].position, strict=True))
    for link in ('one', 'two'):
        np.testing.assert_allclose(
            [values[f'{link}/u{axis}'] for axis in 'xyz'], robot.tip_deflection(link, q), atol=1e-9
        )


def test_noise_is_added_where_it_is_asked_for(graph: Any, plant: Any) -> None:
    states = graph.collect(JointState, '/joint_states')
    plant(noise__position=1e-3, start=[0.2, 0.1])
    graph.until(lambda: len(states) > 150)
    positions = np.array([state.position for state in states])
    assert 0.5e-3 < positions.std(axis=0).min() < 2e-3
    assert not np.any([state.velocity for state in states])


def test_feedback_follows_the_reference(graph: Any, plant: Any) -> None:
    states = graph.collect(JointState, '/joint_states')
    plant(
        feedback__kp=[2000.0, 800.0],  # far beyond what an explicit step would stand
        feedback__kd=[300.0, 100.0],
        enforce_effort_limits=False,
        brake=False,
        gravity=[0.0, 0.0, 0.0],
    )
    reference = graph.publisher(JointTrajectory, 'reference')
    goal = JointTrajectoryPoint(positions=[0.3, -0.2])
    goal.time_from_start.nanosec = 500_000_000
    start = JointTrajectoryPoint(positions=[0.0, 0.0])
    reference.publish(JointTrajectory(joint_names=['j1', 'j2'], points=[start, goal]))
    graph.until(lambda: states and np.allclose(states[-1].position, [0.3, -0.2], atol=5e-3))


def test_reset_goes_back_to_the_start_and_brakes(graph: Any, plant: Any) -> None:
    states = graph.collect(JointState, '/joint_states')
    node = plant(start=[0.5, 0.0])
    publisher = graph.publisher(Float64MultiArray, '/feedforward/commands')
    publisher.publish(command('j1', [0.0]))
    graph.until(lambda: states and abs(states[-1].position[0] - 0.5) > 0.05)
    client = graph.probe.create_client(Trigger, '/plant/reset')
    graph.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    graph.until(future.done)
    graph.until(lambda: not node.command_input.received)
    graph.until(lambda: abs(states[-1].position[0] - 0.5) < 1e-12)


def test_a_new_start_is_where_the_next_reset_goes(graph: Any, plant: Any) -> None:
    states = graph.collect(JointState, '/joint_states')
    node = plant(start=[0.5, 0.0])
    graph.until(lambda: states and abs(states[-1].position[0] - 0.5) < 1e-12)
    (result,) = node.set_parameters([Parameter('start', value=[0.1, -0.2])])
    assert result.successful, result.reason
    (refused,) = node.set_parameters([Parameter('start', value=[0.1])])
    assert "'start' must have 2 elements, got 1" in refused.reason
    graph.until(lambda: not node._changes)
    assert abs(states[-1].position[0] - 0.5) < 1e-12
    node._reset()
    graph.until(lambda: np.allclose(states[-1].position, [0.1, -0.2], rtol=0, atol=1e-12))


def test_robot_description_is_latched(graph: Any, plant: Any, urdf: str) -> None:
    plant()
    got: list[Any] = []
    graph.probe.create_subscription(String, 'robot_description', got.append, LATCHED)
    graph.until(lambda: got)
    assert got[0].data == Path(urdf).read_text()


def test_a_robot_from_the_topic_and_its_overrides(graph: Any) -> None:
    node = graph.add(
        PlantNode, start=False, gravity=GRAVITY, update_rate=RATE, beam__one__y__ei=600.0
    )
    assert not node.ready
    publisher = graph.probe.create_publisher(String, 'robot_description', LATCHED)
    publisher.publish(String(data=two_links()))
    graph.until(lambda: node.ready)
    node.trigger_configure()
    assert node.state == 'inactive'
    body = next(b for b in node.robot.tree.bodies if b.name == 'one')
    assert body.beam.y.stiffness == 600.0


@pytest.mark.parametrize(
    ('parameters', 'says'),
    [
        ({'start': [1.0]}, "'start' must have 2 elements, got 1"),
        ({'feedback.kp': [1.0, 2.0, 3.0]}, "'feedback.kp' must have 1 or 2 elements"),
        ({'joints': ['j1', 'j7']}, "'joints' must name different joints"),
        ({'gravity': [9.81]}, "'gravity' must have 3 elements"),
        ({'urdf_path': '/nowhere.urdf'}, 'nowhere.urdf'),
    ],
)
def test_bad_parameters_fail_the_configuration_with_one_line(
    graph: Any, urdf: str, parameters: dict[str, Any], says: str
) -> None:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, **parameters}
    node = graph.add(PlantNode, start=False, parameters=given)
    node.trigger_configure()
    assert node.state == 'unconfigured'
    assert says in node.failure


def test_a_simulation_that_diverges_starts_anew_and_says_so(graph: Any, plant: Any) -> None:
    states = graph.collect(JointState, '/joint_states')
    node = plant(brake=True, enforce_effort_limits=False, start=[0.5, 0.0])
    publisher = graph.publisher(Float64MultiArray, '/feedforward/commands')

    def pushed() -> bool:
        publisher.publish(command('j1,j2', [9e8, -9e8]))
        return bool(node.tick_failures)

    publisher.publish(command('j1', [1e300]))
    graph.until(lambda: node.command_input.rejected['out_of_range'])
    graph.until(pushed)
    graph.until(lambda: not node.command_input.received)
    count = len(states)
    graph.until(lambda: len(states) > count + 20)
    assert abs(states[-1].position[0] - 0.5) < 1e-12
    assert np.isfinite([state.position for state in states]).all()
    graph.until(lambda: graph.value('plant: loop', 'failures') not in (None, '0'))


def test_a_state_that_no_robot_has_is_said_with_its_instant(graph: Any, urdf: str) -> None:
    node = graph.add(PlantNode, urdf_path=urdf, update_rate=100.0, position_limit=10.0)
    graph.until(lambda: graph.diagnostics.get('plant: plant') is not None)
    assert 'diverged' not in graph.diagnostics['plant: plant'].message
    states = graph.collect(JointState, '/joint_states')
    node.start[node._index] = 170.0
    node._reset()
    pattern = re.compile(
        r'the simulated state diverged \d+\.\d\d s after its start: .*: position must be from .*, '
        r'got 170; .* feedback\.kp'
    )
    graph.until(lambda: pattern.search(graph.diagnostics['plant: plant'].message))
    node.start[node._index] = 0.1
    node._reset()
    graph.until(lambda: 'diverged' not in graph.diagnostics['plant: plant'].message)
    count = len(states)
    graph.until(lambda: len(states) > count)
    assert max(abs(q) for state in states for q in state.position) <= 10.0
    assert 'diverged' in str(graph.value('plant: plant', 'divergence'))


def test_a_line_says_what_an_active_node_does(graph: Any, urdf: str) -> None:
    node = graph.add(PlantNode, urdf_path=urdf, update_rate=100.0)
    pattern = re.compile(
        r'active at 100 Hz: robot \w+, 2 joints, \d+ amplitudes; listens to .*commands.*; '
        r'publishes .*joint_states'
    )
    assert pattern.fullmatch(node.summary().partition(', /plant')[0]), node.summary()
