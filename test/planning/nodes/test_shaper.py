"""The shaper node on real DDS."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from child_processes import gone
from node_robots import GRAVITY, JOINTS, two_links
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from shaped_runs import cycloid, held_spline, swing_after
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.planning.shaper import ShaperNode
from denoc_ros.planning.shapers.joint_servo import joint_servo
from denoc_ros.runtime.inputs.trajectory_messages import read_trajectory
from denoc_ros.runtime.reference.reference import ReferenceFollower
from denoc_ros.trajectories import SplineTrajectory

pytestmark = pytest.mark.ros
END = [0.4, -0.3]
LONG = 300.0  # s for a plan, with kernels to compile on a slow machine
DURATION = 0.6
QUICK = 10.0  # s: at once, on a machine that is busy with others
TOOL = """<link name="tool"/><joint name="flange" type="fixed"><parent link="two"/>
<child link="tool"/><origin xyz="1 0 0"/></joint>"""


@pytest.fixture
def urdf(tmp_path: Path) -> str:
    file = tmp_path / 'arm.urdf'
    file.write_text(two_links().replace('<flexibility>', f'{TOOL}<flexibility>'))
    return str(file)


class ShaperBench:
    """A shaper, who talks to it and what comes out."""

    def __init__(self, graph: Any, urdf: str, **parameters: Any) -> None:
        self.graph = graph
        self.robot = load_robot(urdf, gravity=tuple(GRAVITY))
        given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': 200.0}
        given.update({'limits__effort': [500.0], **parameters})
        self.node = graph.add(ShaperNode, **given)
        self.out = graph.collect(JointTrajectory, 'reference')
        self.input = graph.publisher(JointTrajectory, 'shaper/input')
        graph.until(lambda: self.node._reference.get_subscription_count() > 0)

    def value(self, key: str) -> str | None:
        return str(self.graph.value('shaper: shaper', key))

    def rejected(self, cause: str) -> int:
        return int(self.node.input.rejected[cause])

    def send(self, t: Any, q: Any, names: list[str] = JOINTS, stamp_ns: int = 0) -> None:
        message = JointTrajectory(joint_names=names)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        for when, row in zip(t, np.asarray(q).tolist(), strict=True):
            point = JointTrajectoryPoint(positions=row)
            point.time_from_start.sec, point.time_from_start.nanosec = divmod(
                round(1e9 * when), 10**9
            )
            message.points.append(point)
        self.input.publish(message)

    def send_motion(
        self, stamp_ns: int = 0, start: Any = (0.0, 0.0), duration: float = DURATION
    ) -> tuple[Any, Any]:
        t = np.linspace(0.0, duration, 61)
        q = start + cycloid(t, duration)[:, None] * END
        self.send(t, q, stamp_ns=stamp_ns)
        return t, q


@pytest.fixture
def bench(graph: Any, urdf: str) -> Any:
    return lambda **parameters: ShaperBench(graph, urdf, **parameters)


def rows(message: Any) -> tuple[Any, Any, Any, Any]:
    """Return times, positions, velocities and accelerations of a message."""
    points = message.points
    t = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
    q, qd, qdd = (
        np.array([getattr(point, name) for point in points])
        for name in ('positions', 'velocities', 'accelerations')
    )
    return np.array(t), q, qd, qdd


def start_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


@pytest.mark.parametrize(
    'method', ['tip', *(pytest.param(m, marks=pytest.mark.long) for m in ('zvd', 'rest_to_rest'))]
)
def test_whole_motion_comes_out_once_and_leaves_no_swing(bench: Any, method: str) -> None:
    # a cold kernel cache compiles within the first plan
    arm = bench(method=method, start_margin=2.0, solve_timeout=LONG)
    now_ns = time.time_ns()
    # stretched and fast there is no bounded tip-exact motion
    start, duration = ((0.3, 0.9), 1.5) if method == 'tip' else ((0.0, 0.0), DURATION)
    asked_t, asked = arm.send_motion(0, start, duration)
    arm.graph.until(lambda: arm.out or arm.rejected('not_shaped'), LONG)
    assert len(arm.out) == 1, arm.node.input.last_message
    # it is being carried out: another motion would be half of one
    arm.send_motion()
    arm.graph.until(lambda: arm.rejected('in_motion'))
    arm.graph.spin(0.1)
    assert len(arm.out) == 1
    message = arm.out[0]
    assert list(message.joint_names) == JOINTS
    assert start_ns(message) > now_ns + 2 * 10**9  # room for who follows it
    t, q, qd, qdd = rows(message)
    assert t[0] == 0.0
    np.testing.assert_allclose(q[0], start, atol=0.2 if method == 'tip' else 1e-6)
    np.testing.assert_allclose(qd[[0, -1]], 0.0, atol=0.05)
    step = t[1] - t[0]
    slope = np.gradient(q, step, axis=0)[1:-1]
    assert np.abs(slope - qd[1:-1]).max() < 0.05 * np.abs(qd).max()
    assert qdd.shape == q.shape
    left = swing_after(arm.robot, t, q, 'tool', 1.0)
    assert left < 0.1 * swing_after(arm.robot, asked_t, asked, 'tool', 1.0)
    arm.graph.until(lambda: arm.value('planned') == '1' and float(arm.value('solve_last_s')) > 0.0)


def test_the_fastest_motion_takes_less_time_within_the_limits(bench: Any) -> None:
    effort, asked_duration = 200.0, 1.5
    arm = bench(
        method='tip',
        fastest=True,
        margin=0.05,
        start_margin=2.0,
        solve_timeout=LONG,
        limits__effort=[effort],
    )
    arm.send_motion(0, (0.3, 0.9), asked_duration)
    arm.graph.until(lambda: arm.out or arm.rejected('not_shaped'), LONG)
    assert len(arm.out) == 1, arm.node.input.last_message
    t, q, qd, _ = rows(arm.out[0])
    assert t[-1] < 0.8 * asked_duration
    np.testing.assert_allclose(q[-1], np.array((0.3, 0.9)) + END, atol=0.2)  # links sag
    np.testing.assert_allclose(qd[[0, -1]], 0.0, atol=0.05)
    assert swing_after(arm.robot, t, q, 'tool', 1.0) < 0.01


def test_stamp_with_room_is_kept_with_the_preaction_before_it(bench: Any) -> None:
    arm = bench(method='zv', servo__bandwidth=[8.0], servo__damping=[0.6], servo__delay=[0.05])
    wanted = time.time_ns() + 5 * 10**9
    asked = arm.send_motion(wanted)
    arm.graph.until(lambda: arm.out)
    t, q, _, _ = rows(arm.out[0])
    early = wanted - start_ns(arm.out[0])
    assert 0.05e9 <= early <= 0.065e9  # the servo's delay, and at most a step more
    # behind such servos the joints do what leaves no swing
    fine = np.arange(0.0, t[-1] + 0.3, 1e-3)
    reached = joint_servo(2, 8.0, 0.6, 0.05).response(fine, held_spline(t, q)(fine))
    left = swing_after(arm.robot, fine, reached, 'tool', 1.0)
    assert left < 0.1 * swing_after(arm.robot, asked[0], asked[1], 'tool', 1.0)
    assert swing_after(arm.robot, fine, reached, 'tool', 1.0, since=t[-1] + 0.05) < 1.5 * left


def test_what_cannot_be_shaped_is_refused_or_passed_on(bench: Any) -> None:
    arm = bench(method='zv', limits__velocity=[0.1])
    _, asked = arm.send_motion()
    arm.graph.until(lambda: arm.rejected('not_shaped'))
    assert not arm.out
    assert 'velocity limit of' in arm.node.input.last_message
    arm.node.set_parameters([_parameter('on_failure', 'pass_on')])
    arm.send_motion()
    arm.graph.until(lambda: arm.out)
    _, q, _, _ = rows(arm.out[0])
    np.testing.assert_allclose(q, asked)
    arm.graph.until(lambda: arm.value('passed on') == '1' and arm.value('refused') == '1')


def _parameter(name: str, value: Any) -> Any:
    from rclpy.parameter import Parameter

    return Parameter(name, value=value)


def test_planner_that_dies_is_noticed_and_started_anew(bench: Any) -> None:
    arm = bench(method='zv')
    planner = arm.node.planning.planner
    os.kill(planner.pid, signal.SIGSTOP)  # it has the motion and does not answer
    first = planner.pid
    arm.send_motion()
    arm.graph.until(lambda: planner.busy)
    os.kill(first, signal.SIGKILL)
    arm.graph.until(lambda: arm.rejected('not_shaped'))
    assert 'got its end (-9)' in arm.node.input.last_message
    arm.graph.until(lambda: planner.starts == 2)
    arm.send_motion()  # waits for the new one
    arm.graph.until(lambda: arm.out)
    assert planner.deaths == 1
    assert len(arm.out) == 1


def test_planner_that_takes_too_long_is_ended(bench: Any) -> None:
    arm = bench(method='zv', solve_timeout=0.3)
    planner = arm.node.planning.planner
    first = planner.pid
    os.kill(first, signal.SIGSTOP)
    arm.send_motion()
    arm.graph.until(lambda: arm.rejected('not_shaped'))
    assert 'must take at most 0.3 s' in arm.node.input.last_message
    arm.graph.until(lambda: planner.pid not in (None, first))
    arm.graph.until(lambda: gone(first))


def answer(arm: Any, name: str) -> Any:
    """Return the answer of a Trigger service of the shaper, which must come at once."""
    client = arm.graph.probe.create_client(Trigger, f'shaper/{name}')
    arm.graph.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    began = time.perf_counter()
    arm.graph.until(future.done)
    assert time.perf_counter() - began < QUICK
    return future.result()


def test_planner_that_is_stopped_while_it_loads_keeps_nobody_waiting(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('denoc_ros.planning.shaper.LOADING_PATIENCE', 0.0)
    monkeypatch.setattr('denoc_ros.planning.motion_planning.LOADING', 5.0)
    arm = bench(method='zv')
    planner = arm.node.planning.planner

    def stopped() -> int:
        arm.graph.until(lambda: planner.pid is not None)
        os.kill(planner.pid, signal.SIGSTOP)
        return int(planner.pid)

    first = stopped()
    arm.graph.until(lambda: arm.value('doing') == 'loading')
    assert answer(arm, 'reload_model').success
    assert gone(first)
    second = stopped()
    arm.send_motion()  # waits for a planner that has loaded
    arm.graph.until(lambda: arm.node.planning.busy)
    monkeypatch.setattr('denoc_ros.planning.motion_planning.LOADING', 60.0)
    arm.graph.until(lambda: planner.pid not in (None, second))
    arm.graph.until(lambda: arm.out)
    assert gone(second)


@pytest.mark.long
def test_planner_that_is_stopped_with_a_full_pipe_keeps_nobody_waiting(bench: Any) -> None:
    arm = bench(method='zv')
    planner = arm.node.planning.planner
    pid = planner.pid
    os.kill(pid, signal.SIGSTOP)
    t = np.linspace(0.0, DURATION, 5001)  # far more bytes than a pipe holds
    arm.send(t, cycloid(t, DURATION)[:, None] * END)
    arm.graph.until(lambda: planner.busy)
    assert answer(arm, 'stop').success
    arm.graph.until(lambda: gone(pid))
    arm.send_motion()
    arm.graph.until(lambda: arm.out)


def test_planner_ends_with_the_node(bench: Any) -> None:
    arm = bench(method='zv')
    pid = arm.node.planning.planner.pid
    arm.graph.remove(arm.node)
    assert gone(pid)


def test_node_works_after_another_life_cycle(bench: Any) -> None:
    arm = bench(method='zv')
    first = arm.node.planning.planner.pid
    arm.node.trigger_deactivate()
    arm.send_motion()
    arm.graph.until(lambda: arm.rejected('inactive') == 1)
    arm.node.trigger_cleanup()
    assert arm.node.planning.planner.pid is None
    arm.node.trigger_configure()
    arm.node.trigger_activate()
    assert arm.node.state == 'active', arm.node.failure
    assert arm.node.planning.planner.pid not in (None, first)
    arm.graph.until(lambda: arm.node._reference.get_subscription_count() > 0)
    arm.send_motion()
    arm.graph.until(lambda: arm.out)


def test_bad_motions_are_refused_by_cause(bench: Any) -> None:
    arm = bench(method='zv')
    t = [0.0, 0.5, 1.0]
    still = np.zeros((3, 2))
    bad = {
        'unknown_joint': (t, still, ['j1', 'elbow']),
        'non_finite': (t, np.full((3, 2), np.nan)),
        'times_not_increasing': (t[::-1], still),
        'out_of_range': (t, still + 50.0),
        'missing_joint': (t, still[:, :1], ['j1']),
    }
    for cause, motion in bad.items():
        arm.send(*motion)
        arm.graph.until(lambda cause=cause: arm.rejected(cause) == 1)
    arm.send([0.5, 1.0], still[:2])  # from where?
    arm.graph.until(lambda: arm.rejected('missing_joint') == 2)
    assert not arm.out


def test_unnamed_joints_stand_where_they_are_measured(bench: Any) -> None:
    arm = bench(method='zv')
    states = arm.graph.publisher(JointState, 'joint_states')
    states.publish(JointState(name=JOINTS, position=[0.0, 0.7]))
    arm.graph.until(lambda: arm.node.joint_input.received)
    arm.send([0.0, 0.3, 0.6], [[0.0], [0.1], [0.2]], ['j1'])
    arm.graph.until(lambda: arm.out)
    assert list(arm.out[0].joint_names) == ['j1']
    _, q, _, _ = rows(arm.out[0])
    np.testing.assert_allclose(q[-1], 0.2, atol=1e-6)


def test_stream_is_shaped_and_comes_to_rest(bench: Any) -> None:
    arm = bench(method='zvd', stream_timeout=1.0)
    began = time.perf_counter()
    while (now := time.perf_counter() - began) < DURATION:
        arm.send([0.0], [cycloid(np.array([now]), DURATION)[0] * np.array(END)])
        arm.graph.spin(0.01)
    for _ in range(5):
        arm.send([0.0], [END])
        arm.graph.spin(0.01)
    arm.graph.until(lambda: not arm.node.stream.active)
    points = [message.points[0] for message in arm.out]
    assert len(points) > 50
    assert all(len(p.velocities) == len(p.accelerations) == 2 for p in points)
    q = np.array([p.positions for p in points])
    np.testing.assert_allclose(q[-1], END, atol=1e-6)
    assert np.abs(points[-1].velocities).max() == 0.0
    # later than what came in, and no further
    assert np.abs(q).max(axis=0) == pytest.approx(np.abs(END), abs=0.03)
    stamps = [start_ns(message) for message in arm.out]
    assert (np.diff(stamps) > 0).all()


def test_single_points_need_a_shaper_for_streams(bench: Any) -> None:
    arm = bench(method='tip')
    arm.send([0.0], [[0.1, 0.1]])
    arm.graph.until(lambda: arm.rejected('not_shaped'))
    assert 'needs whole motions' in arm.node.input.last_message


def test_stop_drops_what_is_planned(bench: Any) -> None:
    arm = bench(method='zv')
    planner = arm.node.planning.planner
    os.kill(planner.pid, signal.SIGSTOP)
    arm.send_motion()
    arm.graph.until(lambda: planner.busy)
    client = arm.graph.probe.create_client(Trigger, 'shaper/stop')
    arm.graph.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    arm.graph.until(future.done)
    assert future.result().success
    assert not arm.node.planning.busy
    arm.graph.until(lambda: planner.pid is not None)
    arm.graph.spin(0.2)
    assert not arm.out
    assert not arm.rejected('not_shaped')


class Followed:
    """The reference as a follower has it, at each message's arrival."""

    def __init__(self, arm: ShaperBench) -> None:
        self.arm, self.follower, self.taken = arm, ReferenceFollower(2, 0.2), 0
        self.rows: list[Any] = []

    def look(self) -> None:
        now, now_ns = time.perf_counter(), time.time_ns()
        for message in self.arm.out[self.taken :]:
            raw = bytes(serialize_message(message))
            self.follower.offer(read_trajectory(raw, JOINTS), now, now_ns)
        self.taken = len(self.arm.out)
        q, qd, qdd = np.zeros((3, 2))
        if self.follower.sample(now, q, qd, qdd):
            self.rows.append((now, *q, *qd))

    def until(self, condition: Any) -> None:
        def followed() -> object:
            self.look()
            return condition()

        self.arm.graph.until(followed)


@pytest.mark.parametrize('how', ['service', 'cancel'])
@pytest.mark.parametrize('method', [pytest.param('zvd', marks=pytest.mark.long), 'tip'])
def test_a_stop_on_the_way_brakes_along_the_path(bench: Any, method: str, how: str) -> None:
    """The reference never jumps, and a new motion begins where this one came to rest."""
    arm = bench(method=method, stop_time=0.5, start_margin=0.5)
    duration = 4.0
    # stretched there is no bounded tip-exact motion
    arm.send_motion(start=(0.3, 0.9) if method == 'tip' else (0.0, 0.0), duration=duration)
    followed = Followed(arm)
    followed.until(lambda: arm.out)
    planned = rows(arm.out[0])
    begin = time.perf_counter() + 1e-9 * (start_ns(arm.out[0]) - time.time_ns())
    followed.until(lambda: time.perf_counter() > begin + 0.4 * duration)
    if how == 'cancel':
        arm.send([], [])
    else:
        assert answer(arm, 'stop').message.startswith('stopped: at rest in ')
    followed.until(lambda: len(arm.out) == 2)
    stop = rows(arm.out[1])
    assert arm.node._doing(arm.node.clock.now()) == 'moving'
    arm.send_motion(start=stop[1][-1])
    followed.until(lambda: arm.rejected('in_motion') == 1)
    followed.until(lambda: arm.node._doing(arm.node.clock.now()) == 'waiting')
    assert stop[0][-1] < 2.0
    # by its stamps, whenever a busy machine delivers it: the stop goes on from the plan's state
    on_the_way = np.zeros((3, 2))
    SplineTrajectory(*planned).sample(
        1e-9 * (start_ns(arm.out[1]) - start_ns(arm.out[0])), *on_the_way
    )
    # stamps and moments are of two clocks, read within microseconds of each other
    np.testing.assert_allclose([column[0] for column in stop[1:]], on_the_way, atol=1e-4)
    fastest = np.abs(planned[2]).max(axis=0)
    assert (np.abs(SplineTrajectory(*stop).table(1e-3)[2]) < 1.05 * fastest + 1e-6).all()
    assert not stop[2][-1].any()
    np.testing.assert_allclose(followed.rows[-1][1:3], stop[1][-1], atol=1e-4)
    # along the path: each of its postures is one of the plan's
    spline = SplineTrajectory(*planned)
    path = spline.table(1e-3)[1]
    away = [np.abs(path - row).max(axis=1).min() for row in stop[1]]
    assert max(away) < 2e-3
    assert not np.allclose(stop[1][-1], planned[1][-1], atol=0.02)

    arm.send_motion(start=(0.0, 0.0))  # where the first one began
    arm.graph.until(lambda: arm.rejected('not_at_start') == 1)
    if method == 'tip':
        return
    arm.send_motion(start=stop[1][-1])
    arm.graph.until(lambda: len(arm.out) == 3)
    np.testing.assert_allclose(rows(arm.out[2])[1][0], stop[1][-1], atol=5e-3)


def test_a_stop_before_a_motion_begins_keeps_it_from_beginning(bench: Any) -> None:
    arm = bench(method='zv', start_margin=5.0)
    arm.send_motion()
    followed = Followed(arm)
    followed.until(lambda: arm.out)
    assert answer(arm, 'stop').success
    followed.until(lambda: len(arm.out) == 2)
    assert answer(arm, 'stop').success  # once is enough
    followed.until(lambda: arm.node._doing(arm.node.clock.now()) == 'waiting')
    followed.until(lambda: time.time_ns() > start_ns(arm.out[0]) + 0.5e9)
    assert len(arm.out) == 2
    assert not np.array(followed.rows)[:, 1:].any()


def test_endless_motions_are_refused_at_once(bench: Any) -> None:
    arm = bench(method='zv')
    arm.send([0.0, 1e6], [[0.0, 0.0], END])
    arm.graph.until(lambda: arm.rejected('not_shaped') == 1)
    assert 'a motion must take at most 10000 s, got 1e+06 s' in arm.node.input.last_message
    arm.send([0.0, 9e3], [[0.0, 0.0], END])
    arm.graph.until(lambda: arm.node.planning.busy)
    assert answer(arm, 'stop').success


def test_live_payload_counts_for_the_next_motion(bench: Any) -> None:
    arm = bench(method='zv')
    arm.send_motion()
    arm.graph.until(lambda: len(arm.out) == 1)
    arm.graph.until(lambda: arm.node._doing(time.perf_counter()) == 'waiting')
    result = arm.node.set_parameters([_parameter('payload.two.mass', 5.0)])[0]
    assert result.successful, result.reason
    t = np.linspace(0.0, DURATION, 61)
    arm.send(t, np.array(END) - cycloid(t, DURATION)[:, None] * END)
    arm.graph.until(lambda: len(arm.out) == 2)
    last = [rows(message)[0][-1] for message in arm.out]
    assert last[1] - DURATION > 1.15 * (last[0] - DURATION)  # slower modes, longer delay


def test_a_rigid_robot_is_shaped_by_a_table_of_measured_modes(
    graph: Any, urdf: str, tmp_path: Path
) -> None:
    text = Path(urdf).read_text()
    rigid = tmp_path / 'rigid.urdf'
    rigid.write_text(text[: text.index('<flexibility>')] + '</robot>')
    table = tmp_path / 'modes.yaml'
    table.write_text(
        f'joints: [{JOINTS[1]}]\npostures:\n'
        f'- {{position: [{END[1]}], frequency: [2.0], damping_ratio: [0.0]}}\n'
        '- {position: [0.0], frequency: [4.0], damping_ratio: [0.0]}\n'
    )
    arm = ShaperBench(graph, str(rigid), method='zv', mode_table=str(table))
    first = np.array([END[0], 0.0])
    ways = (np.zeros(2), first, 0.125), (first, np.subtract(END, first), 0.25)
    for count, (start, way, half) in enumerate(ways, 1):
        t = np.linspace(0.0, DURATION, 61)
        arm.send(t, start + cycloid(t, DURATION)[:, None] * way)
        graph.until(lambda count=count: len(arm.out) == count, LONG)
        times, positions = rows(arm.out[-1])[:2]
        # half a period of the slowest mode on the way
        assert times[-1] - DURATION == pytest.approx(half, abs=0.02)
        np.testing.assert_allclose(positions[-1], start + way, atol=1e-9)
        graph.until(lambda: arm.node._doing(time.perf_counter()) == 'waiting', LONG)
    refused = arm.node.set_parameters([_parameter('method', 'tip')])[0]
    assert not refused.successful
    assert "'mode_table' must stand beside method zv, zvd, ei, got tip" in refused.reason


def test_bad_limits_and_robots_are_refused(graph: Any, urdf: str) -> None:
    node = graph.add(ShaperNode, start=False, urdf_path=urdf, limits__velocity=[1.0, 2.0, 3.0])
    node.trigger_configure()
    assert 'velocity must have one element, or one for each of 2 joints' in node.failure
    rigid = urdf.replace('arm', 'rigid')
    text = Path(urdf).read_text()
    Path(rigid).write_text(text[: text.index('<flexibility>')] + '</robot>')
    graph.remove(node)
    node = graph.add(ShaperNode, start=False, urdf_path=rigid)
    node.trigger_configure()
    assert 'a shaper needs a flexible link or a mode table, got none' in node.failure
