"""Nodes by simulated time: outputs by stamp are the same however the clock goes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from node_robots import GRAVITY
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.nodes.base.messages import time_message
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.planning.shaper import ShaperNode
from denoc_ros.viewer.viewer import ViewerNode

pytestmark = pytest.mark.ros
RATE = 200.0
PERIOD = 5_000_000  # ns
START, END = 3_000_000_000, 3_600_000_000  # ns
JOINTS = ['j1', 'j2']
EVERY = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
Schedule = Callable[['Simulation'], None]


def simulation_angle(t: float) -> float:
    """Return where the first joint is [rad] at a time [s]; the second is opposite."""
    return float(0.3 * (1.0 - np.cos(2.0 * t)))


class Simulation:
    """A simulator that others wrote: joint states, then /clock, when the test says."""

    def __init__(self, graph: Any) -> None:
        self.graph = graph
        publisher = graph.probe.create_publisher
        self._clock = publisher(Clock, '/clock', EVERY)
        self._states = publisher(JointState, 'joint_states', EVERY)
        self.reference = publisher(JointTrajectory, 'reference', EVERY)
        self.now = 0

    def to(self, now: int) -> None:
        """Publish the joint states of the periods up to a time [ns], then that time."""
        first = self.now + PERIOD if 0 <= now - self.now < 10**9 else now
        for each in range(first, now + 1, PERIOD):
            t = 1e-9 * each
            angle, rate = simulation_angle(t), 0.6 * np.sin(2.0 * t)
            state = JointState(name=JOINTS, position=[angle, -angle], velocity=[rate, -rate])
            state.header.stamp = time_message(each)
            self._states.publish(state)
        self._clock.publish(Clock(clock=time_message(now)))
        self.now = now

    def run(self, end: int, factor: float, stride: int = 1) -> None:
        """Go on to a time [ns] at a real-time factor, so many periods at a time."""
        while self.now < end:
            self.to(min(end, self.now + stride * PERIOD))
            self.graph.spin(1e-9 * stride * PERIOD / factor)


def motion(start: int, angle: float = 0.6) -> JointTrajectory:
    """Return a whole motion by an angle [rad] that starts at a stamp [ns]."""
    message = JointTrajectory(joint_names=JOINTS)
    message.header.stamp = time_message(start)
    for position, after in ((0.0, 0), (angle, 400_000_000)):
        point = JointTrajectoryPoint(positions=[position, -position])
        point.velocities, point.accelerations = [0.0, 0.0], [0.0, 0.0]
        point.time_from_start.nanosec = after
        message.points.append(point)
    return message


def even(factor: float, stride: int = 1) -> Schedule:
    return lambda simulation: simulation.run(END, factor, stride)


def pausing(simulation: Simulation) -> None:
    simulation.run(START + 250_000_000, 1.0)
    simulation.graph.spin(1.0)  # longer than every timeout
    simulation.run(END, 1.0)


def jumping_ahead(simulation: Simulation) -> None:
    simulation.run(START + 200_000_000, 1.0)
    simulation.run(START + 400_000_000, 1.0, stride=40)
    simulation.run(END, 1.0)


SCHEDULES: dict[str, Schedule] = {
    'factor 1': even(1.0),
    'factor 0.1': even(0.1),
    'factor 5': even(5.0),
    'factor 2': even(2.0),
    'factor 0.3': even(0.3),
    'coarse': even(1.0, stride=4),
    'pausing': pausing,
    'jumping ahead': jumping_ahead,
}


def by_stamp(messages: list[Any], values: Callable[[Any], list[float]]) -> dict[int, list[float]]:
    """Return values of messages by their stamps [ns]."""
    found = {}
    for message in messages:
        stamp = message.header.stamp
        found[stamp.sec * 10**9 + stamp.nanosec] = values(message)
    return found


def require_same(runs: dict[str, dict[int, list[float]]]) -> None:
    """Require that all runs have what the first one has, from its first stamp to the end."""
    first = runs['factor 1']
    wanted = [stamp for stamp in range(START + PERIOD, END + 1, PERIOD) if stamp >= min(first)]
    assert len(wanted) > 100
    for name, found in runs.items():
        assert [each for each in wanted if each not in found] == [], name
        got = np.array([found[each] for each in wanted])
        np.testing.assert_allclose(
            got, [first[each] for each in wanted], rtol=1e-9, atol=1e-9, err_msg=name
        )


@pytest.fixture
def simulation(graph: Any) -> Simulation:
    """Return a simulator whose time stands at the start."""
    return Simulation(graph)


def begin(simulation: Simulation, node: Any) -> None:
    """Go back to the start, or there for the first time; the node begins anew."""

    def begun() -> bool:
        simulation.to(START)
        return bool(node.clock.now_ns() == START and node.joint_input.received)

    simulation.now = 0
    simulation.graph.until(begun)


def test_feedforward_follows_by_stamp(graph: Any, simulation: Simulation, urdf: str) -> None:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE, 'use_sim_time': True}
    node = graph.add(FeedforwardNode, parameters={**given, 'joint_state_timeout': 0.1})
    efforts = graph.collect(JointState, '/feedforward/effort')
    runs = {}
    for name, schedule in SCHEDULES.items():
        begin(simulation, node)
        before = node.reference_input.accepted
        simulation.reference.publish(motion(START + 100_000_000))
        graph.until(lambda before=before: node.reference_input.accepted > before)
        efforts.clear()
        schedule(simulation)
        graph.until(lambda: efforts and efforts[-1].header.stamp == time_message(END))
        runs[name] = by_stamp(efforts, lambda m: [*m.position, *m.velocity, *m.effort])
        assert node._cause == 'following'
    require_same(runs)
    # against the closed form: where a quintic at rest is at half its time
    middle = runs['factor 5'][START + 300_000_000]
    np.testing.assert_allclose(middle[:2], [0.3, -0.3], atol=1e-9)


def test_predictor_estimates_by_stamp(graph: Any, simulation: Simulation, urdf: str) -> None:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE, 'use_sim_time': True}
    node = graph.add(PredictorNode, parameters=given)
    found = graph.collect(JointState, '/predictor/modal_state')
    runs = {}
    for name, schedule in SCHEDULES.items():
        begin(simulation, node)
        found.clear()
        schedule(simulation)
        graph.until(lambda: found and found[-1].header.stamp == time_message(END))
        runs[name] = by_stamp(found, lambda m: [*m.position, *m.velocity])
        assert node.observer.restarts == node.observer.late == 0
    require_same(runs)


def test_streamed_motion_is_shaped_by_stamp(graph: Any, simulation: Simulation, urdf: str) -> None:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE, 'use_sim_time': True}
    node = graph.add(ShaperNode, parameters={**given, 'method': 'zvd'})
    shaped = graph.collect(JointTrajectory, '/reference')
    points = graph.publisher(JointTrajectory, '/shaper/input', 1000)
    to = simulation.to

    def with_points(now: int) -> None:
        """Stream points for the periods that time passes over, as joint states."""
        for each in range(simulation.now + PERIOD, now + 1, PERIOD):
            if START < each <= START + 300_000_000:
                message = JointTrajectory(joint_names=JOINTS)
                message.header.stamp = time_message(each)
                angle = 0.3 * (1.0 - np.cos(2.0e-9 * START)) + 1e-9 * (each - START)
                point = JointTrajectoryPoint(positions=[angle, -angle], velocities=[1.0, -1.0])
                message.points.append(point)
                points.publish(message)
        to(now)

    runs = {}
    for name, schedule in SCHEDULES.items():
        simulation.to = to  # type: ignore[method-assign]
        begin(simulation, node)
        shaped.clear()
        simulation.to = with_points  # type: ignore[method-assign]
        schedule(simulation)
        graph.until(lambda: shaped and shaped[-1].header.stamp == time_message(END))
        runs[name] = by_stamp(shaped, lambda m: [*m.points[0].positions, *m.points[0].velocities])
    require_same(runs)


def test_whole_motion_is_planned_for_its_stamp(
    graph: Any, simulation: Simulation, urdf: str
) -> None:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE, 'use_sim_time': True}
    node = graph.add(ShaperNode, parameters={**given, 'method': 'zvd'})
    plans = graph.collect(JointTrajectory, '/reference')
    motions = graph.publisher(JointTrajectory, '/shaper/input')
    found = []
    for factor in (0.5, 5.0):
        begin(simulation, node)
        plans.clear()
        motions.publish(motion(START + 300_000_000, 0.1))
        graph.until(lambda: plans)
        found.append(plans[0])
        simulation.run(START + 200_000_000, factor)
    assert found[0] == found[1]
    assert found[0].header.stamp == time_message(START + 300_000_000)


def test_viewer_draws_by_the_clock(
    graph: Any, simulation: Simulation, urdf: str, watch: Any
) -> None:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'use_sim_time': True, 'timeout': 0.3}
    node = graph.add(ViewerNode, parameters={**given, 'port': 0, 'rate': 50.0})
    shown: list[tuple[float, Any]] = []
    node.page.show = lambda snapshot: shown.append((time.perf_counter(), snapshot))
    watch(node.page.address)

    def drawn() -> bool:
        simulation.now = 0
        simulation.to(START)
        return bool(shown)

    graph.until(drawn)

    # the time of what is drawn is the clock's: a fifth of the wall's at a factor of 0.2
    simulation.run(START + 100_000_000, 0.2)
    begin = len(shown)
    simulation.run(START + 400_000_000, 0.2)
    (wall, first), (end, last) = shown[begin - 1], shown[-1]
    passed = last.t - first.t
    assert 0.2 < passed < 0.35
    assert passed < 0.21 * (end - wall) + 2.0 * PERIOD * 1e-9
    for _, each in shown[begin:]:  # what was said last, of a moment that has just been
        since = simulation_angle(START * 1e-9 + each.t - last.t + 0.4)
        assert abs(each.q[0] - since) < 0.03

    # a clock that stands is a pause: the robot stays as it is, longer than `timeout`
    graph.spin(0.2)
    count, still = len(shown), shown[-1][1]
    graph.spin(1.0)
    assert len(shown) > count
    for _, each in shown[count:]:
        assert each.t == still.t
        np.testing.assert_array_equal(each.q, still.q)


def test_clock_that_is_dead_is_told(
    graph: Any, urdf: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('denoc_ros.runtime.loop.status.SILENT_CLOCK', 1.0)
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE, 'use_sim_time': True}
    graph.add(FeedforwardNode, parameters=given)

    def said(text: str) -> bool:
        status = graph.diagnostics.get('feedforward: clock')
        return status is not None and text in status.message

    graph.until(lambda: said('time waits; /clock has 0 publishers'))
    clock = graph.publisher(Clock, '/clock')
    clock.publish(Clock(clock=time_message(START)))
    graph.until(lambda: said('time stands at 3.000 s; /clock has 1 publisher'))


def test_simulated_time_is_for_good(graph: Any, urdf: str) -> None:
    node = graph.add(FeedforwardNode, parameters={'urdf_path': urdf, 'gravity': GRAVITY})
    (answer,) = node.set_parameters([Parameter('use_sim_time', value=True)])
    assert not answer.successful
    assert 'must be given when the node starts' in answer.reason
    (answer,) = node.set_parameters([Parameter('use_sim_time', value=False)])
    assert answer.successful
