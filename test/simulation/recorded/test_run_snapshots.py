"""A recorded run gives moments that are the bag's own numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from geared_arm import arm_text
from simulated_bags import PERIOD, SimulatedBag, make_mechanism_bag

from denoc_ros.bags import run as run_reading
from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import BagError
from denoc_ros.simulation.recorded.run_snapshots import RecordedRun

JOINT_STATE = 'sensor_msgs/msg/JointState'
STAMP = 1e-9  # s: stamps are whole nanoseconds


def written(path: Path, topics: dict[str, list[tuple[float, dict[str, object]]]]) -> Path:
    """Write messages (time, fields) of JointState topics."""
    with BagWriter(path) as bag:
        for topic in topics:
            bag.add_topic(topic, JOINT_STATE)
        rows = [(t, topic, fields) for topic, rows in topics.items() for t, fields in rows]
        for t, topic, fields in sorted(rows, key=lambda row: row[0]):
            bag.write_message(topic, 10**18 + round(t * 1e9), **fields)
    return path


def test_every_moment_is_the_bags_own(simulated_bag: SimulatedBag) -> None:
    run, truth = (
        RecordedRun(simulated_bag.path, simulated_bag.robot, rate=1000.0),
        simulated_bag.run,
    )
    assert run.source == 'plant'
    assert len(run) == len(truth.t)
    np.testing.assert_allclose(run.t, truth.t, rtol=0.0, atol=STAMP)
    robot = simulated_bag.robot
    for k in (0, 123, len(run) - 1):
        moment = run[k]
        np.testing.assert_array_equal(moment.q, truth.q[k])
        assert moment.qd is not None
        np.testing.assert_array_equal(moment.qd, truth.qd[k])
        assert moment.torque == dict(
            zip(robot.joint_names, truth.torque[k, robot.joint_indices], strict=True)
        )
        # the bag has the products of another order of summation
        shown = moment.channels['deflection [m]/true link_2 uy']
        assert shown == pytest.approx(robot.tip_deflection('link_2', truth.q[k])[1], abs=1e-14)
        assert moment.channels['torque [N m]/joint_1'] == moment.torque['joint_1']


def test_thinning_leaves_out_moments_and_changes_none(simulated_bag: SimulatedBag) -> None:
    run = RecordedRun(simulated_bag.path, simulated_bag.robot, rate=40.0)
    duration = len(simulated_bag.run.t) * PERIOD
    assert len(run) == pytest.approx(40.0 * duration, abs=2)
    rows = np.round(run.t / PERIOD).astype(int)
    np.testing.assert_array_equal(run.q, simulated_bag.run.q[rows])


def test_a_run_of_any_length_has_a_bounded_number_of_moments(
    simulated_bag: SimulatedBag, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_reading, 'MOST_ROWS', 30)
    assert 25 <= len(RecordedRun(simulated_bag.path, simulated_bag.robot)) <= 31


def test_a_window_has_the_moments_within_it(simulated_bag: SimulatedBag) -> None:
    run = RecordedRun(simulated_bag.path, simulated_bag.robot, start=0.5, end=1.1, rate=1000.0)
    truth = simulated_bag.run
    within = (truth.t > 0.5 - PERIOD / 2) & (truth.t < 1.1 + PERIOD / 2)
    np.testing.assert_array_equal(run.q, truth.q[within])
    with pytest.raises(BagError, match='run must have moments from 7 to 8 s, got one of 2 s'):
        RecordedRun(simulated_bag.path, simulated_bag.robot, start=7.0, end=8.0)


def test_between_moments_motion_is_linear(simulated_bag: SimulatedBag) -> None:
    run = RecordedRun(simulated_bag.path, simulated_bag.robot)
    middle = 0.25 * run.t[10] + 0.75 * run.t[11]
    expected = 0.25 * run.q[10] + 0.75 * run.q[11]
    np.testing.assert_allclose(run.at(np.array([middle]))[0], expected, rtol=1e-12)


def test_joints_alone_leave_the_links_straight(simulated_bag: SimulatedBag) -> None:
    robot = simulated_bag.robot
    run = RecordedRun(simulated_bag.path, robot, source='joints', rate=1000.0)
    joints = robot.joint_indices
    np.testing.assert_array_equal(run.q[:, joints], simulated_bag.run.q[:, joints])
    assert not run.q[:, robot.flexible_indices].any()


def test_loops_give_the_joints_that_were_not_recorded(repository: Path, tmp_path: Path) -> None:
    whole = make_mechanism_bag(repository, tmp_path, 'rrrr')
    robot, truth = whole.robot, whole.run
    names = ['joint_1', 'joint_3']
    places = robot.joint_indices[[0, 2]]
    rows: list[tuple[float, dict[str, object]]] = [
        (t, {'name': names, 'position': q[places]}) for t, q in zip(truth.t, truth.q, strict=True)
    ]
    run = RecordedRun(written(tmp_path / 'two.mcap', {'/joint_states': rows}), robot)
    # the driven motion closes loops to its own bound, 1e-8
    assert max(np.abs(robot.closure(q)).max() for q in run.q) < 1e-7
    np.testing.assert_allclose(run.at(truth.t[:1])[0][places], truth.q[0, places], atol=1e-12)


def test_what_predictor_and_plant_said_stands_side_by_side(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    robot = simulated_bag.robot
    names, at = list(robot.coordinate_names), np.arange(0.0, 1.0, 0.01)
    state: dict[str, object] = {'name': names, 'position': np.zeros(robot.n)}

    def tips(factor: float) -> list[tuple[float, dict[str, object]]]:
        fields = ['link_1/uy', 'link_2/uy', 'link_2/rx']
        return [(t, {'name': fields, 'position': [factor * t, 1e-9, 0.0]}) for t in at]

    path = written(
        tmp_path / 'both.mcap',
        {
            '/predictor/modal_state': [(t, state) for t in at],
            '/predictor/tip_deflection': tips(0.9),
            '/plant/true_deflection': tips(1.0),
            '/predictor/sensor_residual': [(t, {'name': ['gauge'], 'position': [t]}) for t in at],
        },
    )
    run = RecordedRun(path, robot, rate=1000.0)
    assert run.source == 'predictor'
    # what does not bend beside what does is left out
    assert run.names == (
        'deflection [m]/predicted link_1 uy',
        'deflection [m]/true link_1 uy',
        'residual/gauge',
    )
    channels = run[50].channels
    assert channels['deflection [m]/predicted link_1 uy'] == pytest.approx(0.45, abs=1e-9)
    assert channels['deflection [m]/true link_1 uy'] == pytest.approx(0.5, abs=1e-9)
    assert channels['residual/gauge'] == pytest.approx(0.5, abs=1e-9)
    assert run[50].torque is None


def test_a_channel_is_nan_where_its_topic_was_not_recorded(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    robot = simulated_bag.robot
    state: dict[str, object] = {'name': list(robot.coordinate_names), 'position': np.ones(robot.n)}
    late: dict[str, object] = {'name': ['gauge'], 'position': [3.0]}
    path = written(
        tmp_path / 'late.mcap',
        {
            '/predictor/modal_state': [(t, state) for t in np.arange(0.0, 1.0, 0.1)],
            '/predictor/sensor_residual': [(t, late) for t in np.arange(0.5, 1.0, 0.1)],
        },
    )
    run = RecordedRun(path, robot)
    assert run.names == ('residual/gauge',)
    assert np.isnan(run[0].channels['residual/gauge'])
    assert run[-1].channels['residual/gauge'] == 3.0


def test_messages_without_a_number_are_left_out(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    robot = simulated_bag.robot
    rows: list[tuple[float, dict[str, object]]] = []
    for k in range(10):
        q = np.full(robot.n, 0.1 * k)
        q[1] = np.nan if k % 3 == 0 else q[1]
        rows.append((0.1 * k, {'name': list(robot.coordinate_names), 'position': q}))
    run = RecordedRun(written(tmp_path / 'holes.mcap', {'/plant/true_modal_state': rows}), robot)
    np.testing.assert_allclose(run.t, [0.1, 0.2, 0.4, 0.5, 0.7, 0.8], atol=STAMP)
    np.testing.assert_array_equal(run.q[:, 1], run.q[:, 0])


def test_phases_are_what_pictures_show(simulated_bag: SimulatedBag, tmp_path: Path) -> None:
    robot, path = simulated_bag.robot, tmp_path / 'phases.mcap'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        bag.add_topic('/up/phase', 'std_msgs/msg/String')
        names = list(robot.joint_names)
        marks = {20: 'one', 50: '', 60: 'two', 90: ''}
        for k in range(100):
            stamp = 10**18 + k * 10**8
            bag.write_message('/joint_states', stamp, name=names, position=[0.0, 0.1 * k])
            if k in marks:
                bag.write_message('/up/phase', stamp, data=marks[k])
    run = RecordedRun(path, robot)
    assert run.span == pytest.approx((2.0, 9.0), abs=1e-9)
    assert [run.phase(t) for t in (1.0, 3.0, 5.5, 7.0, 9.5)] == ['', 'one', '', 'two', '']
    # the pause between the phases has no label, and nothing of the reference to show
    shown = [run.phase(t) for t in run.moments(12)]
    assert set(shown) == {'one', 'two'}
    assert shown == sorted(shown)
    part = RecordedRun(path, robot, start=3.0, end=8.0)
    assert part.span == pytest.approx((3.0, 8.0), abs=1e-9)


def test_a_phase_is_shown_from_where_its_reference_begins(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    robot, path = simulated_bag.robot, tmp_path / 'led.mcap'
    # the first phase begins anew; until 2.5 s the robot goes back to its start; the second phase
    # ends before its reference
    marks, references = {10: 'one', 20: 'one', 50: '', 60: 'two', 90: ''}, {12: 13, 22: 25, 65: 95}
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        bag.add_topic('/up/phase', 'std_msgs/msg/String')
        bag.add_topic('/reference', 'trajectory_msgs/msg/JointTrajectory')
        names = list(robot.joint_names)
        for k in range(100):
            stamp = 10**18 + k * 10**8
            bag.write_message('/joint_states', stamp, name=names, position=[0.0, 0.1 * k])
            if k in marks:
                bag.write_message('/up/phase', stamp, data=marks[k])
            if k in references:
                seconds, tenths = divmod(references[k], 10)
                header = {'stamp': {'sec': 10**9 + seconds, 'nanosec': tenths * 10**8}}
                bag.write_message('/reference', stamp, header=header, joint_names=names)
    run = RecordedRun(path, robot)
    phases = run_reading.read_run(path).phases
    assert [each.name for each in phases] == ['one', 'two']
    assert phases[0].end - phases[0].start == pytest.approx(3.0, abs=1e-9)
    assert run.phases == ((2.5, 'one'), (5.0, ''), (9.0, 'two'), (9.0, ''))
    assert run.span == pytest.approx((2.5, 9.0), abs=1e-9)
    assert run.moments(6)[0] == pytest.approx(2.5, abs=1e-9)


def test_what_does_not_show_the_robot_is_refused(
    repository: Path, simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    other = load_robot(repository / 'config/robots/ur10.urdf')
    with pytest.raises(BagError, match=re.escape("state or joint_states of robot 'ur10")):
        RecordedRun(simulated_bag.path, other)
    with pytest.raises(BagError, match='source must be one of plant, predictor, replay, joints'):
        RecordedRun(simulated_bag.path, simulated_bag.robot, source='tea')
    with pytest.raises(BagError, match='must have predictor/modal_state of robot'):
        RecordedRun(simulated_bag.path, simulated_bag.robot, source='predictor')
    empty = written(tmp_path / 'empty.mcap', {'/joint_states': []})
    with pytest.raises(BagError, match=r'bag must have .*, got topics /joint_states'):
        RecordedRun(empty, simulated_bag.robot)


BENDING = """<beam link="fore" length="0.4" mass_per_length="1" shape="clamped-free">
<bending direction="z" ei="50" modes="1"/></beam>"""


def test_a_predicted_state_without_springs_behind_measured_links_bends(tmp_path: Path) -> None:
    text = arm_text('link').replace('<flexibility>', f'<flexibility>{BENDING}')
    robot = load_robot(text)
    names = ['shoulder', 'elbow', 'fore/z1']
    fields: list[tuple[float, dict[str, object]]] = [
        (t, {'name': names, 'position': [0.3, -0.2, 0.01 * t], 'velocity': [0.0, 0.0, 0.01]})
        for t in (0.0, 0.5, 1.0)
    ]
    run = RecordedRun(written(tmp_path / 'run', {'predictor/modal_state': fields}), robot)
    assert run.source == 'predictor'
    bend, spring = (robot.coordinate_names.index(name) for name in ('fore/z1', 'elbow/spring'))
    np.testing.assert_allclose(run.q[-1][[*robot.joint_indices, bend]], [0.3, -0.2, 0.01])
    assert not run.q[:, spring].any()


TURNING = """<robot name="boom"><link name="base"/>
<link name="boom"><inertial><origin xyz="0.5 0 0"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="swing" type="continuous"><parent link="base"/><child link="boom"/>
<axis xyz="0 0 1"/><limit effort="50" velocity="10"/></joint></robot>"""


def test_a_continuous_joint_goes_on_where_its_position_wraps(tmp_path: Path) -> None:
    robot = load_robot(TURNING)
    t = 0.02 * np.arange(100)
    rows: list[tuple[float, dict[str, object]]] = [
        (at, {'name': ['swing'], 'position': [(2.0 * at + 3.0 * np.pi) % (2 * np.pi) - np.pi]})
        for at in t
    ]
    run = RecordedRun(written(tmp_path / 'run', {'joint_states': rows}), robot)
    np.testing.assert_allclose(run.q[:, 0] - run.q[0, 0], 2.0 * run.t, atol=1e-9)
    between = run.at(0.5 * (run.t[1:] + run.t[:-1]))
    np.testing.assert_allclose(np.diff(between[:, 0]), 2.0 * np.diff(run.t)[1:], atol=1e-9)
