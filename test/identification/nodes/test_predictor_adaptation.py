"""The predictor that tracks a payload: found, shown, let go, refused."""

from __future__ import annotations

import random
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_robots import GRAVITY, two_links
from node_robots import JOINTS as PAIR
from predictor_bench import begun
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from tracked_bags import is_as_heard, write_tracked
from tracked_runs import TrackedRun, simulated, swinging, with_noise
from trust import states as states_of
from trust.stage import stamp

import denoc_ros as dn
from denoc_ros.identification.tracking.tracked_recording import AdaptSettings
from denoc_ros.nodes.predictor import PredictorNode

pytestmark = pytest.mark.ros

ARM = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'canadarm_gauges.urdf'
TOOL = 'payload.tool.mass'
JOINTS = ['joint_1', 'joint_2', 'joint_3']
PERIOD = 0.005
KNOWN, TRUE = 100.0, 120.0


@cache
def swing() -> TrackedRun:
    robot = dn.load_robot(ARM, gravity=(0.0, 0.0, 0.0))
    robot.set_payload('tool', TRUE)
    return with_noise(simulated(robot, swinging(3), 3.0, PERIOD))


def parameters(**more: Any) -> dict[str, Any]:
    return {
        'urdf_path': str(ARM),
        'gravity': [0.0, 0.0, 0.0],
        'update_rate': 1.0 / PERIOD,
        'joint_state_timeout': 0.2,  # a busy machine pauses for as long
        TOOL: KNOWN,
        'adapt': [TOOL],
        **more,
    }


def ticked(node: Any, run: TrackedRun, rows: range) -> None:
    """Let the loop's own function hear joint states, each at its time."""
    for k in rows:
        node._queue.append((run.t[k], run.q[k], run.qd[k], run.effort[k]))
        node.tick(1)


@pytest.mark.parametrize('strain', ['ignore', 'fuse'])
def test_the_model_in_use_carries_what_is_found(graph: Any, strain: str) -> None:
    node = begun(graph.add(PredictorNode, start=False, parameters=parameters(strain=strain)))
    run = swing()
    ticked(node, run, range(len(run.t)))
    found = node.adaptation.tracker.values[0]
    assert abs(found - TRUE) < 0.04 * TRUE  # as test_parameter_tracker has it, 5 ms apart
    robots = [node.observer.robot, node.observer._stepper.robot]
    if strain == 'fuse':
        robots.append(node.observer.fusion.filter._robot)
    for robot in robots:
        assert robot.payload_mass('tool') == pytest.approx(found, rel=1e-9)
    # what follows from other parameters is built with the value that was found
    (result,) = node.set_parameters([Parameter('horizon', value=0.05)])
    assert result.successful, result.reason
    ticked(node, run, range(len(run.t) - 1, len(run.t)))
    assert node.observer.robot.payload_mass('tool') == pytest.approx(found, rel=1e-9)
    assert node.adaptation.tracker.values[0] == pytest.approx(found, rel=1e-9)
    # another mass by parameter is where the tracking starts anew
    (result,) = node.set_parameters([Parameter(TOOL, value=110.0)])
    assert result.successful, result.reason
    node.tick(1)
    assert node.adaptation.tracker.values[0] == 110.0
    assert node.observer.robot.payload_mass('tool') == pytest.approx(110.0)


def test_a_bag_of_the_run_says_what_the_node_says(graph: Any, tmp_path: Path) -> None:
    robot = dn.load_robot(ARM, gravity=(0.0, 0.0, 0.0)).with_overrides({TOOL: KNOWN})
    node = begun(graph.add(PredictorNode, start=False, parameters=parameters(strain='fuse')))
    run, values = swing(), []
    for k, t in enumerate(run.t.tolist()):
        node.sensors.queue.extend((place, t, x) for place, x in enumerate(run.sensors[k].tolist()))
        ticked(node, run, range(k, k + 1))
        values.append(node.adaptation.tracker.values[0])
    bag = write_tracked(run, robot, tmp_path / 'run.mcap')
    lag = node.adaptation.tracker.settings.lag
    adapt = AdaptSettings((TOOL,), tracker=dn.TrackerSettings(lag=lag))
    found = dn.replay_bag(bag, robot, adapt=adapt).adapted
    assert found is not None
    assert found.last[0] != KNOWN
    assert is_as_heard(found, run, np.array(values))


def swing_once(graph: Any, states: Any, run: TrackedRun) -> None:
    """Publish the run's joint states in real time."""
    start_ns, start = time.time_ns(), time.perf_counter()
    message = JointState(name=JOINTS)
    for k, t in enumerate(run.t.tolist()):
        graph.until(lambda due=start + t: time.perf_counter() >= due)
        stamp = start_ns + round(1e9 * t)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.position, message.velocity = run.q[k].tolist(), run.qd[k].tolist()
        message.effort = run.effort[k].tolist()
        states.publish(message)


def test_the_value_is_published_and_reported(graph: Any) -> None:
    node = graph.add(PredictorNode, parameters=parameters())
    shown = graph.collect(JointState, 'predictor/model_parameters')
    states = graph.publisher(JointState, 'joint_states')
    run = swing()
    blocks = 'predictor: adaptation', 'blocks'
    swings = 0  # a busy machine needs more than one; the arm jumps back for each
    while swings < 5 and (len(shown) < 10 or float(graph.value(*blocks) or 0) < 10.0):
        swing_once(graph, states, run)
        swings += 1
    assert list(shown[-1].name) == [TOOL]
    values = np.array([each.position[0] for each in shown])
    assert np.all((values >= 50.0) & (values <= 150.0))
    assert shown[-1].effort[0] > 0.0
    found = node.adaptation.tracker.values[0]
    # unless a busy machine lost joint states: then it knows less
    if swings == 1 and node.joint_input.accepted > 0.9 * len(run.t):
        assert abs(found - TRUE) < 10.0
    assert graph.value('predictor: adaptation', f'{TOOL} supported') in ('yes', 'no')
    assert float(graph.value('predictor: adaptation', TOOL)) == pytest.approx(found, abs=20.0)
    client = graph.probe.create_client(Trigger, 'predictor/reset')
    graph.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    graph.until(future.done)
    graph.until(lambda: node.adaptation.tracker.values[0] == KNOWN)
    (result,) = node.set_parameters([Parameter('adapt', Parameter.Type.STRING_ARRAY, [])])
    assert result.successful, result.reason
    graph.until(lambda: node.adaptation.tracker is None)
    assert node.observer.robot.payload_mass('tool') == pytest.approx(KNOWN)


class Feed:
    """What the campaign's faults are made of: a robot that swings, and says so."""

    def __init__(self) -> None:
        self.begin = time.perf_counter()

    def state(self, positions: Any = None, names: Any = None) -> JointState:
        t = time.perf_counter() - self.begin
        count = 2 if positions is None else len(positions)
        message = JointState(name=list(names or PAIR))
        message.position = list(positions or [0.4 + 0.3 * np.sin(6.0 * t), -0.7])
        message.velocity = ([1.8 * np.cos(6.0 * t), 0.0] * count)[:count]
        message.effort = ([40.0 * np.sin(6.0 * t), 10.0] * count)[:count]
        stamp(message, time.time_ns())
        return message


def wild(feed: Feed) -> JointState:
    message = feed.state()
    message.effort = [random.uniform(-1e6, 1e6) for _ in PAIR]
    return message


def without_effort(feed: Feed) -> JointState:
    message = feed.state()
    message.effort = []
    return message


def test_faults_of_inputs_never_take_a_value_beyond_its_bounds(graph: Any, tmp_path: Path) -> None:
    """The campaign's faults of joint states, silence, wild efforts and gauges that lie."""
    file = tmp_path / 'arm.urdf'
    file.write_text(two_links())
    paths = ['payload.two.mass', 'beam.one.y.ei']
    low, high = np.array([0.5, 200.0]), np.array([3.0, 400.0])
    node = graph.add(
        PredictorNode,
        parameters={
            'urdf_path': str(file),
            'gravity': GRAVITY,
            'update_rate': 200.0,
            'payload.two.mass': 1.0,
            'adapt': paths,
            'adapt_bounds': [0.5, 3.0, 200.0, 400.0],
        },
    )
    shown = graph.collect(JointState, 'predictor/model_parameters')
    states = graph.publisher(JointState, 'joint_states')
    gauge = graph.probe.create_publisher(Float64, '/strain', 10)
    feed: Any = Feed()  # the faults ask nothing but `state` of a stage
    faults = (
        states_of.not_finite, states_of.wrong_length, states_of.wrong_joints, states_of.shuffled,
        states_of.bytes_of_nothing, states_of.backwards, states_of.jumped, wild, without_effort,
    )  # fmt: skip
    for fault in faults:
        for k in range(60):
            states.publish(fault(feed) if k % 3 == 0 else feed.state())
            gauge.publish(Float64(data=random.choice([0.0, np.nan, np.inf, 1e3, -1e9])))
            graph.spin(0.004)
        if fault is wild:
            graph.spin(0.4)  # silence: longer than is integrated over
    graph.until(lambda: len(shown) > 10)
    values = np.array([message.position for message in shown])
    assert list(shown[-1].name) == paths
    assert np.all((values >= low) & (values <= high))
    assert np.isfinite([message.effort for message in shown]).all()
    assert sum(node.joint_input.rejected.values()) > 60
    assert node.state == 'active'


def test_it_is_off_by_default(graph: Any) -> None:
    given = parameters()
    del given['adapt']
    node = graph.add(PredictorNode, parameters=given)
    assert node.adaptation.tracker is None
    assert node.adaptation.status() is None


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('adapt', ['payload.nothing.mass'], "'adapt': 'payload.nothing.mass' must be of one of"),
        ('adapt', ['payload.link_1'], "bounds of 'payload.link_1.mass' must be 0 <= low"),
        ('adapt_bounds', [90.0], 'bounds must be the lowest and highest value of each of payload'),
        ('adapt_bounds', [110.0, 130.0], 'must have its value 100 within, got 110 and 130'),
        ('adapt_rate', 0.0, "'adapt_rate' must be > 0"),
    ],
)
def test_wrong_parameters_are_refused_at_configure_and_live(
    graph: Any, name: str, value: Any, reason: str
) -> None:
    node = graph.add(PredictorNode, parameters=parameters())
    before = node.adaptation
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    assert node.adaptation is before
    graph.remove(node)
    if name == 'adapt_rate':  # a parameter out of range does not make a node at all
        return
    wrong = graph.add(PredictorNode, start=False, parameters=parameters(**{name: value}))
    wrong.trigger_configure()
    assert wrong.state == 'unconfigured'
    assert reason in wrong.failure
