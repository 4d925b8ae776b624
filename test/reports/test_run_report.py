"""`dn.report`: the page of a run from Python, without a command line."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from page_look import require_one_look
from planar_chains import FLEXIBLE, RIGID, planar_chain

import denoc_ros as dn
from denoc_ros.bags.reader import DESCRIPTION_ATTACHMENT
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.session.session_file import SessionFile
from denoc_ros.reports.headline import summary_lines
from denoc_ros.simulation.simulate import Run
from denoc_ros.simulation.simulated_bag import write_run

DOWN = (0.0, -9.81, 0.0)


@pytest.fixture(scope='module')
def fall() -> tuple[dn.Robot, Run]:
    robot = dn.load_robot(planar_chain([FLEXIBLE, RIGID]), gravity=DOWN)
    still = np.zeros(robot.n)
    return robot, dn.simulate(robot, still, still, np.linspace(0.0, 0.2, 41))


def test_report_of_a_simulation_is_that_of_its_bag(
    fall: tuple[dn.Robot, Run], tmp_path: Path
) -> None:
    robot, run = fall
    bag = tmp_path / 'fall.mcap'
    session = {'kind': 'simulate', 'gravity': list(DOWN)}
    write_run(run, robot, bag, robot.tree.source, session=session)
    ours, theirs = dn.report(run, robot), dn.report(bag)
    assert ours.summary['simulated'] == pytest.approx(theirs.summary['simulated'])
    assert ours.summary['messages'] == theirs.summary['messages']
    # it falls from rest: what it gains in kinetic energy is more than the tolerance's drift
    assert ours.summary['simulated']['largest_kinetic_energy'] > 1.0
    page = tmp_path / 'page.html'
    ours.write(page)
    require_one_look(page.read_text(encoding='utf-8'), str(tmp_path))
    assert not ours.notes


def test_robot_goes_with_a_run_and_with_no_path(
    fall: tuple[dn.Robot, Run], tmp_path: Path
) -> None:
    robot, run = fall
    with pytest.raises(dn.ConfigError, match='robot must be given for a Run, got run of Run'):
        dn.report(run)
    with pytest.raises(dn.ConfigError, match='robot must be left out for a path, got run of '):
        dn.report(tmp_path, robot)


def test_a_robot_that_does_not_load_is_noted(tmp_path: Path) -> None:
    path = tmp_path / 'odd.mcap'
    with BagWriter(path) as bag:
        bag.attach(DESCRIPTION_ATTACHMENT, '<robot name="none"/>')
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        for k in range(3):
            bag.write_message('/joint_states', k * 10**7, name=['a'], position=[0.1 * k])
    made = dn.report(path)
    assert made.summary['robot'] == ''
    assert [note[:22] for note in made.notes] == ['the robot is left out:']


@pytest.mark.parametrize('messages', [0, 3])
def test_a_phase_that_was_cut_is_named_whatever_was_recorded(
    tmp_path: Path, messages: int
) -> None:
    begin_ns = 10**18
    phases = [
        {'name': 'rigid', 'begin_ns': begin_ns, 'end_ns': begin_ns + 10**9},
        {'name': 'flexible', 'begin_ns': begin_ns + 2 * 10**9, 'end_ns': None},
    ]
    session = {'name': 'arm', 'failure': 'interrupted', 'phases': phases}
    (tmp_path / 'session.json').write_text(json.dumps(session))
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        for k in range(messages):
            bag.write_message('/joint_states', begin_ns + k * 10**7, name=['a'], position=[0.1])
    page = dn.report(tmp_path).html()
    assert 'ended in phase “flexible” before its end: interrupted' in page


@pytest.mark.parametrize('mode', ['simulated', 'real'])
def test_the_pace_of_simulated_phases_is_said(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_ns, wall = 10**18, iter([0.0, 0.5, 7.0, 8.5])  # the second between phases does not count
    file = SessionFile(tmp_path, {'name': 'arm', 'time': {'mode': mode, 'why': 'as asked for'}})
    with monkeypatch.context() as clock:
        clock.setattr(time, 'perf_counter', lambda: next(wall))
        for begin in (0, 9):
            file.begin_phase(f'at {begin}', begin_ns + begin * 10**9)
            file.end_phase(begin_ns + (begin + 2) * 10**9)
    assert [phase['wall'] for phase in file.phases] == [0.5, 1.5]
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        bag.write_message('/joint_states', begin_ns, name=['a'], position=[0.1])
    made = dn.report(tmp_path)
    said = 'as asked for; the phases ran at 2 times real time'
    assert (said in made.html()) == (mode == 'simulated')
    assert (f'time    {said}' in list(summary_lines(made.summary))) == (mode == 'simulated')


@pytest.mark.long
def test_reports_need_no_command_line(tmp_path: Path) -> None:
    script = (
        'import sys; import denoc_ros.reports.run_page; '
        'found = [name for name in sys.modules if name.startswith("denoc_ros.cli")]; '
        'assert not found, found'
    )
    subprocess.run([sys.executable, '-c', script], check=True, timeout=120, cwd=tmp_path)


def test_a_report_of_some_phases_measures_these(tmp_path: Path) -> None:
    begin_ns = 10**18
    file = SessionFile(tmp_path, {'name': 'arm'})
    for k, name in enumerate(('rigid', 'flexible')):
        file.begin_phase(name, begin_ns + k * 10**9)
        file.end_phase(begin_ns + (k + 1) * 10**9)
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        for k in range(20):
            bag.write_message('/joint_states', begin_ns + k * 10**8, name=['a'], position=[0.1])
    assert list(dn.report(tmp_path).summary['phases']) == ['rigid', 'flexible']
    assert list(dn.report(tmp_path, phases=['flexible']).summary['phases']) == ['flexible']
    with pytest.raises(dn.BagError, match=r"--phase must be .*'rigid', 'flexible'.*got 'soft'"):
        dn.report(tmp_path, phases=['soft'])


def test_a_reference_and_joints_a_turn_apart_are_followed(tmp_path: Path) -> None:
    source = planar_chain([RIGID]).replace('type="revolute"', 'type="continuous"')
    (joint,) = dn.load_robot(source).joint_names
    errors = []
    for wraps in (False, True):
        path = tmp_path / f'{wraps}.mcap'
        with BagWriter(path) as bag:
            bag.attach(DESCRIPTION_ATTACHMENT, source)
            bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
            bag.add_topic('/reference', 'trajectory_msgs/msg/JointTrajectory')
            ends = [{'sec': 0, 'nanosec': 0}, {'sec': 2, 'nanosec': 0}]
            points = [
                {'positions': [q], 'velocities': [0.0], 'time_from_start': end}
                for q, end in zip((2.5, 4.0), ends, strict=True)
            ]
            header = {'stamp': {'sec': 1, 'nanosec': 0}}
            bag.write_message(
                '/reference', 10**9, header=header, joint_names=[joint], points=points
            )
            for k in range(201):
                share = k / 200
                angle = 2.51 + 1.5 * share**2 * (3.0 - 2.0 * share)
                if wraps:
                    angle = (angle + np.pi) % (2.0 * np.pi) - np.pi
                bag.write_message(
                    '/joint_states', 10**9 + k * 10**7, name=[joint], position=[angle]
                )
        (phase,) = dn.report(path).summary['phases'].values()
        errors.append(phase['joint_error'][joint]['max'])
    assert errors[1] == pytest.approx(errors[0], abs=1e-9)
    assert errors[0] == pytest.approx(0.01, abs=1e-3)
