"""Replay phase by phase: each as if it were recorded alone; nothing crosses a split."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_bags import PERIOD, SimulatedBag

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.run import RecordedPhase
from denoc_ros.bags.series import JointSeries, read_joint_states
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.model.numbers import values_of
from denoc_ros.simulation.recorded.compared import Compared
from denoc_ros.simulation.recorded.replay_bag import replay_bag
from denoc_ros.simulation.recorded.replay_summary import summarize
from denoc_ros.simulation.recorded.residual_friction import FrictionFitter
from denoc_ros.simulation.recorded.run_files import plant_differences, recorded_phases

SECOND = 10**9
DEFLECTION = 'plant/true_deflection'
ROWS = 500  # of the simulated run
PAUSE = 200  # rows between phases, in which the robot goes elsewhere and back
TOPICS = ('joint_states', DEFLECTION)


def _write(bag: BagWriter, topic: str, series: JointSeries, rows: Sequence[int], at: int) -> None:
    """Write rows of a topic so that the first one has a stamp [ns]."""
    for k, row in enumerate(rows):
        stamp_ns = at + round(k * PERIOD * SECOND)
        fields = {f: getattr(series, f)[row] for f in ('position', 'velocity', 'effort')}
        fields = {f: v for f, v in fields.items() if np.isfinite(v).all()}
        bag.write_message(f'/{topic}', stamp_ns, name=list(series.names), **fields)


def two_phases(simulated: SimulatedBag, path: Path, events: bool = False) -> Path:
    """Write a bag with the simulated run in two phases, wild motion before each of them."""
    series = {topic: read_joint_states(simulated.path, f'/{topic}') for topic in TOPICS}
    with BagWriter(path) as bag:
        for topic in TOPICS:
            bag.add_topic(f'/{topic}', JOINT_STATE)
        bag.add_topic('/up/phase', 'std_msgs/msg/String')
        bag.add_topic('/reference', 'trajectory_msgs/msg/JointTrajectory')
        bag.add_topic('/parameter_events', 'rcl_interfaces/msg/ParameterEvent')
        begin_ns = SECOND
        for name in ('first', 'second'):
            if events and name == 'second':
                _write_event(bag, begin_ns, 'plant', 'payload.tool.mass', 2.0)
            bag.write_message('/up/phase', begin_ns, data=name)
            starts_ns = begin_ns + round(PAUSE * PERIOD * SECOND)
            stamp = dict(zip(('sec', 'nanosec'), divmod(starts_ns, SECOND), strict=True))
            joints = ['joint_1', 'joint_2']
            bag.write_message(
                '/reference', begin_ns + 1, header={'stamp': stamp}, joint_names=joints
            )
            for topic, each in series.items():
                # on the way to the start: the run from its middle on, backwards
                _write(bag, topic, each, range(300, 300 - PAUSE, -1), begin_ns + 2)
                _write(bag, topic, each, range(ROWS), starts_ns)
            end_ns = starts_ns + round(ROWS * PERIOD * SECOND)
            bag.write_message('/up/phase', end_ns, data='')
            begin_ns = end_ns + SECOND // 10
    return path


def _write_event(bag: BagWriter, at: int, node: str, path: str, number: float) -> None:
    stamp = dict(zip(('sec', 'nanosec'), divmod(at, SECOND), strict=True))
    changed = [{'name': path, 'value': {'type': 3, 'double_value': number}}]
    bag.write_message(
        '/parameter_events', at, stamp=stamp, node=f'/{node}', changed_parameters=changed
    )


def same_numbers(found: Compared, alone: Compared) -> None:
    """Require that a phase has the numbers that a bag of it alone has."""
    assert (found.samples, found.motions) == (alone.samples, 1)
    for model, torque in alone.torque.items():
        np.testing.assert_allclose(found.torque[model].rms, torque.rms, rtol=1e-3)
        # lags are not looked for across blocks, which end elsewhere
        np.testing.assert_allclose(found.torque[model].lag, torque.lag, atol=5e-5)
    for term, share in alone.shares.items():
        np.testing.assert_allclose(found.shares[term], share, atol=1e-5)
    deflection = alone.deflection[f'/{DEFLECTION}']
    np.testing.assert_allclose(
        found.deflection[f'/{DEFLECTION}'].rms, deflection.rms, rtol=1e-3, atol=1e-9
    )


def test_a_phase_has_the_numbers_of_a_bag_of_it_alone(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    robot = simulated_bag.robot
    alone = replay_bag(simulated_bag.path, robot)
    found = replay_bag(two_phases(simulated_bag, tmp_path / 'run.mcap'), robot)
    assert alone.phases == ()
    assert [one.name for one in found.phases] == ['first', 'second']
    for one in found.phases:
        same_numbers(one, alone)
    assert (found.samples, found.motions) == (2 * ROWS, 2)
    time, _ = found.torque_traces['flexible'].curve('joint_1')
    assert (np.diff(time) >= 0.0).all()


def test_numbers_of_all_phases_are_the_means_of_theirs(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    found = replay_bag(two_phases(simulated_bag, tmp_path / 'run.mcap'), simulated_bag.robot)
    parts = [(one.torque['flexible'], one.deflection[f'/{DEFLECTION}']) for one in found.phases]
    wholes = found.torque['flexible'], found.deflection[f'/{DEFLECTION}']
    for whole, of_phases in zip(wholes, zip(*parts, strict=True), strict=True):
        squares = np.sum([one.samples * one.rms**2 for one in of_phases], axis=0)
        np.testing.assert_allclose(whole.samples * whole.rms**2, squares)
        peaks = [one.measured_peak for one in of_phases]
        np.testing.assert_array_equal(whole.measured_peak, np.max(peaks, axis=0))


def test_messages_are_written_for_the_chosen_phases_alone(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    path, output = two_phases(simulated_bag, tmp_path / 'run.mcap'), tmp_path / 'out.mcap'
    (chosen,) = (phase for phase in recorded_phases(path) if phase.name == 'second')
    replay_bag(path, simulated_bag.robot, output, phases=[chosen])
    stamps = read_joint_states(output, '/replay/flexible/effort').stamp_ns
    assert chosen.begin_ns <= stamps.min() <= stamps.max() < chosen.end_ns


def test_a_clock_that_is_set_back_splits_the_motion(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    path = tmp_path / 'run.mcap'
    series = {topic: read_joint_states(simulated_bag.path, f'/{topic}') for topic in TOPICS}
    with BagWriter(path) as bag:
        for topic in TOPICS:
            bag.add_topic(f'/{topic}', JOINT_STATE)
        for log_ns in (SECOND, 5 * SECOND):
            for topic, each in series.items():
                for k in range(ROWS):
                    after = round(k * PERIOD * SECOND)
                    stamp = dict(
                        zip(('sec', 'nanosec'), divmod(SECOND + after, SECOND), strict=True)
                    )
                    fields = {f: getattr(each, f)[k] for f in ('position', 'velocity', 'effort')}
                    fields = {f: v for f, v in fields.items() if np.isfinite(v).all()}
                    bag.write_message(
                        f'/{topic}', log_ns + after, header={'stamp': stamp},
                        name=list(each.names), **fields,
                    )  # fmt: skip
    found = replay_bag(path, simulated_bag.robot, tmp_path / 'out.mcap')
    alone = replay_bag(simulated_bag.path, simulated_bag.robot)
    assert (found.samples, found.motions, found.repeated) == (2 * ROWS, 2, 0)
    for model, torque in alone.torque.items():
        np.testing.assert_allclose(found.torque[model].rms, torque.rms, rtol=1e-6)
    assert summarize(found)['notes'] == ['the clock of the stamps was set back 1 times']
    written = read_joint_states(tmp_path / 'out.mcap', '/replay/flexible/effort')
    recorded = read_joint_states(path)
    np.testing.assert_array_equal(written.stamp_ns, recorded.stamp_ns)


def test_no_window_of_a_fit_reaches_from_one_motion_into_the_next() -> None:
    t = np.linspace(0.0, 0.9, 91)
    qd = np.sin(3.0 * t)[:, None]
    rest = 2.0 * qd + 0.1 * np.random.default_rng(1).standard_normal((91, 1))
    starts = np.isin(np.arange(91), [0, 30, 60])
    split, alone = FrictionFitter(1), FrictionFitter(1)
    split.add(t, qd, rest, starts)
    for k, rows in enumerate(np.split(np.arange(91), [30, 60])):
        alone.add(t[rows] + 10.0 * k, qd[rows], rest[rows], starts[rows])
    np.testing.assert_allclose(split.fit().by_window, alone.fit().by_window)
    np.testing.assert_allclose(split.fit().friction.viscous, 2.0, atol=0.1)


# ---- the plant of a phase


def test_plant_s_numbers_come_from_the_session_or_from_parameter_events(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    path = two_phases(simulated_bag, tmp_path / 'bag', events=True)
    assert [phase.plant for phase in recorded_phases(path)] == [
        None,
        {'payload.tool.mass': 2.0},
    ]
    found = replay_bag(path, simulated_bag.robot)
    first, second = found.phases
    assert first.plant == {}
    assert second.plant == {'payload.tool.mass': (2.0, 0.0)}
    noted: list[dict[str, Any]] = [
        {
            'name': 'first',
            'begin_ns': SECOND,
            'end_ns': 2 * SECOND,
            'plant': {'joint.a.damping': 1},
        }
    ]
    (tmp_path / 'session.json').write_text(json.dumps({'phases': noted}))
    assert recorded_phases(tmp_path) == (
        RecordedPhase('first', SECOND, 2 * SECOND, {'joint.a.damping': 1}),
    )


def test_a_plant_with_the_model_s_numbers_is_no_other(simulated_bag: SimulatedBag) -> None:
    robot = simulated_bag.robot
    same = {'beam.link_1.y.ei': values_of(robot.tree)['beam.link_1.y.ei']}
    assert plant_differences(robot, same) == {}
    assert plant_differences(robot, {'damping.joint_1': 0.5}) == {}
    assert plant_differences(robot, {'payload.tool.com': [1.0, 0.0, 0.0]}) == {}
    heavier = {'payload.tool.mass': 1.0, 'payload.tool.com': [1.0, 0.0, 0.0]}
    assert set(plant_differences(robot, heavier)) == set(heavier)
    loaded = robot.with_overrides(heavier)
    assert plant_differences(loaded, heavier) == {}
    assert plant_differences(robot, {'joint.none.damping': 2.0}) == {
        'joint.none.damping': (2.0, None)
    }


# ---- the verb


@pytest.mark.parts('reports')
def test_the_verb_has_a_row_for_each_phase_and_joint(
    simulated_bag: SimulatedBag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = two_phases(simulated_bag, tmp_path / 'run.mcap', events=True)
    robot = tmp_path / 'robot.urdf'
    robot.write_text(simulated_bag.robot.tree.source)
    command = ['replay', str(path), '--robot', str(robot), '--gravity', '0', '-9.81', '0']
    command += ['--no-output', '--report', str(tmp_path / 'page.html')]
    assert main(command) == 0
    shown = capsys.readouterr().out
    for phase in ('first', 'second'):
        rows = [line for line in shown.splitlines() if line.startswith(f'  {phase}')]
        # two joints in each of two tables, and deflections
        assert sum('joint_' in row for row in rows) == 4
        assert any(f'/{DEFLECTION}' in row for row in rows)
    assert 'second: the plant was another than the model, with payload.tool.mass 2' in shown
    assert main([*command, '--json', '--phase', 'second']) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document['phases']) == ['second']
    second = document['phases']['second']
    assert second['torque'] == document['torque']
    assert second['plant'] == {'payload.tool.mass': {'plant': 2.0, 'model': 0.0}}
    assert main([*command, '--phase', 'third']) == 1
    assert "--phase must be a phase of the run ('first', 'second'), got 'third'" in (
        capsys.readouterr().err
    )
