"""The verb: table, JSON and page say the same; bad input is one line and exit status 1."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from page_look import require_one_look
from simulated_bags import SimulatedBag

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import bag_contents
from denoc_ros.bags.series import read_joint_states
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main

ROBOT = Path(__file__).resolve().parents[2] / 'config' / 'robots' / 'two_link_ff.urdf'
UPRIGHT = ['--gravity', '0', '-9.81', '0']


@pytest.mark.parts('reports')
def test_bag_page_and_numbers_come_out(
    simulated_bag: SimulatedBag,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    # the robot in the bag is the one before its damping and friction were given
    damped = [f'--set=beam.link_{k}.y.damping_ratio=0.02' for k in (1, 2)]
    command = ['replay', str(simulated_bag.path), *UPRIGHT, *damped]
    assert main([*command, '--fit-friction', '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['samples'] == 500
    assert set(found['torque']) == {'rigid', 'flexible'}
    assert found['torque']['flexible']['joint_1']['rms'] < 0.5
    assert found['friction']['joint_2']['coulomb'] == pytest.approx(0.3, abs=0.05)
    assert found['deflection']['/plant/true_deflection']['link_1/uy']['measured_peak'] > 0.05
    topics = {topic.name for topic in bag_contents(tmp_path / found['output']).topics}
    assert {'/joint_states', '/replay/rigid/effort', '/replay/tip_deflection'} <= topics
    page = (tmp_path / found['report']).read_text()
    for heading in ('Torque', 'What explains it', 'Friction, fitted', 'Deflection of the'):
        assert f'<h2>{heading}' in page
    # two joints of the rigid model, two of the flexible one, two deflections
    assert len(re.findall('<figure>', page)) == 6
    require_one_look(page, str(tmp_path))
    # nothing is written over
    assert main(command) == 1
    assert 'output must not exist yet' in capsys.readouterr().err


@pytest.mark.parts('reports')
def test_table_shows_each_joint_and_what_if_changes_it(
    simulated_bag: SimulatedBag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ['replay', str(simulated_bag.path), *UPRIGHT, '--no-output']
    command += ['--report', str(tmp_path / 'page.html')]
    assert main(command) == 0
    plain = capsys.readouterr().out
    assert main([*command, '--set', 'beam.link_1.y.ei=800', '--payload', 'tool=1,0.1,0,0']) == 0
    changed = capsys.readouterr().out
    for table in (plain, changed):
        assert len(re.findall(r'^  joint_[12] ', table, re.M)) == 4
    assert plain != changed
    # what was changed stands on the page
    assert 'payload.tool.com' in (tmp_path / 'page.html').read_text()
    assert list(tmp_path.iterdir()) == [tmp_path / 'page.html']


def write_joint_table(bag: Path, path: Path, pattern: str, separator: str = ',') -> Path:
    """Write the joint states of a bag as text; `pattern` names a column by joint and field."""
    told = read_joint_states(bag, '/joint_states', ['joint_1', 'joint_2'])
    columns = {'time_ms': 1e-6 * (told.stamp_ns - told.stamp_ns[0])}
    for field in ('position', 'velocity', 'effort'):
        for k, joint in enumerate(('joint_1', 'joint_2')):
            columns[pattern.format(joint=joint, field=field)] = getattr(told, field)[:, k]
    rows = zip(*columns.values(), strict=True)
    lines = [separator.join(columns), *(separator.join(f'{x:.17g}' for x in row) for row in rows)]
    path.write_text('\n'.join(lines))
    return path


@pytest.mark.long_cases('/joint_states/{joint}/{field}-options0', '{joint}_{field}-options1')
@pytest.mark.parametrize(
    ('pattern', 'options'),
    [
        ('/joint_states/{joint}/{field}', []),
        ('{joint}_{field}', []),
        (
            'log {joint} {field}',
            [
                f'--column=joint_{k}.{field}=log joint_{k} {field}'
                for k in (1, 2)
                for field in ('position', 'velocity', 'effort')
            ],
        ),
    ],
)
@pytest.mark.parts('identification')
def test_a_table_gives_what_its_bag_gives(
    simulated_bag: SimulatedBag,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    pattern: str,
    options: list[str],
) -> None:
    page = ['--report', str(tmp_path / 'page.html')]
    command = [*UPRIGHT, '--no-output', '--json', *page, '--robot', str(ROBOT)]
    assert main(['replay', str(simulated_bag.path), *command]) in (0, 2)
    bag = json.loads(capsys.readouterr().out)
    table = write_joint_table(simulated_bag.path, tmp_path / 'run.csv', pattern)
    assert main(['replay', str(table), *command, *options]) in (0, 2)
    told = json.loads(capsys.readouterr().out)
    assert told['bag'] == str(table)
    assert told['samples'] == bag['samples']
    for joint in ('joint_1', 'joint_2'):
        for model in ('rigid', 'flexible'):
            there, here = (each['torque'][model][joint]['rms'] for each in (bag, told))
            assert here == pytest.approx(there, rel=1e-4)


@pytest.mark.parametrize(
    ('text', 'options', 'message'),
    [
        (
            'time,a\n0,1\n1,2',
            [],
            "must have the position of a joint .*'joint_1/position'.*got time, a",
        ),
        ('joint_1\n0\n1', [], 'table must have a column of times'),
        (
            't,joint_1\n0,1\n1,2',
            ['--time', 'u'],
            "time must be a column of numbers \\(t, joint_1\\), got 'u'",
        ),
        ('t,joint_1\n0,1\n1,2', ['--column', 'elbow.position=t'], 'must name JOINT.position'),
        ('t,joint_1\n0,1\n1,2', ['--column', 'joint_1.position=x'], "must be one of .*got 'x'"),
        (
            't,joint_1,joint_2\n'
            + ''.join(f'{k / 100},{(-20) ** (k % 3)},0\n' for k in range(99)),
            [],
            r'joint states from 0.000 to 0.980 s must be a motion .* positions up to \d+ ',
        ),
        ('t,joint_1\n0,1\n1,2', ['--rate', '-1'], '--rate must be > 0 Hz, got -1'),
        (
            't,joint_1/position,a.joint_1.position\n0,1,1\n1,2,2',
            [],
            'position of joint_1 must be in one column',
        ),
    ],
)
@pytest.mark.parts('identification')
def test_a_table_that_cannot_be_replayed_is_refused(
    simulated_bag: SimulatedBag,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: str,
    options: list[str],
    message: str,
) -> None:
    table = tmp_path / 'run.csv'
    table.write_text(text)
    command = ['replay', str(table), '--robot', str(ROBOT), '--no-output', *options]
    assert main(command) == 1
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parts('reports')
def test_run_s_directory_says_its_gravity(
    simulated_bag: SimulatedBag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / 'run'
    (run / 'bag').mkdir(parents=True)
    (run / 'bag' / 'bag_0.mcap').write_bytes(simulated_bag.path.read_bytes())
    (run / 'session.json').write_text(json.dumps({'gravity': [0.0, -9.81, 0.0]}))
    assert main(['recover', str(run / 'bag'), '-o', str(tmp_path / 'whole')]) == 0
    (tmp_path / 'whole').rename(run / 'whole')
    (run / 'bag' / 'bag_0.mcap').unlink()
    (run / 'bag').rmdir()
    (run / 'whole').rename(run / 'bag')
    capsys.readouterr()
    assert main(['replay', str(run), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['output'] == str(run / 'replay')
    assert (run / 'replay.html').is_file()
    assert found['shares']['gravity']['joint_1'] > 0.5


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--set', 'beam.link_1.y'], r'--set must be path=value'),
        (['--set', 'beam.link_9.y.ei=1'], r"path 'beam\.link_9\.y\.ei'"),
        (['--payload', 'tool=heavy'], r"--payload must be LINK=MASS or .* got 'tool=heavy'"),
        (['--payload', 'hook=1'], r'payload\.hook\.mass'),
        (['--rename', 'old'], r"--rename must be OLD=NEW, got 'old'"),
        (['--cutoff', '-3'], r'cutoff must be > 0 Hz, got -3'),
        (['--robot', 'nowhere.urdf'], r'nowhere\.urdf'),
        (['--joint', 'elbow'], r'joints must be among those on /joint_states .*got elbow'),
    ],
)
def test_bad_options_say_what_must_hold(
    simulated_bag: SimulatedBag,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['replay', str(simulated_bag.path), *options]) == 1
    assert re.search(f'denoc replay: .*{message}', capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('kind', ['absent', 'foreign', 'empty', 'without robot'])
def test_what_cannot_be_replayed_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    path = tmp_path / 'bag.mcap'
    if kind == 'foreign':
        path.write_bytes(b'not a bag')
    elif kind != 'absent':
        with BagWriter(path) as bag:
            bag.add_topic('/joint_states', JOINT_STATE)
            if kind == 'empty':
                bag.attach('robot_description.urdf', '<robot name="a"><link name="b"/></robot>')
    assert main(['replay', str(path), '-o', str(tmp_path / 'out')]) == 1
    assert re.search(r'denoc replay: .*bag\.mcap: (run|bag) must', capsys.readouterr().err)
    assert not (tmp_path / 'out').exists()


def test_doubtful_numbers_end_with_status_2(
    tmp_path: Path, repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'bag.mcap'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(40):
            stamp = 10**9 + (k - 5 * (k % 4 == 3)) * 10**7
            bag.write_message('/joint_states', stamp, name=['joint_1'], position=[0.01 * k])
    robot = str(repository / 'config/robots/two_link_rr.urdf')
    assert main(['replay', str(path), '--robot', robot, '-o', str(tmp_path / 'out')]) == 2
    assert '9 of 40 joint states were left out' in capsys.readouterr().out


def test_the_model_of_a_session_is_replayed(
    simulated_bag: SimulatedBag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / 'run'
    with BagWriter(run / 'bag') as bag:
        bag.attach('robot_description.urdf', simulated_bag.robot.tree.source)
        bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(40):
            bag.write_message(
                '/joint_states', 10**9 + k * 10**7, name=['joint_1', 'joint_2'],
                position=[0.01 * k, 0.0], effort=[1.0, 1.0],
            )  # fmt: skip
    command = ['replay', str(run), '--no-output', '--json', '--report', str(tmp_path / 'a.html')]
    found = []
    for model, options in (({}, ['--set', 'payload.tool.mass=1']), ({'payload.tool.mass': 1}, [])):
        (run / 'session.json').write_text(json.dumps({'gravity': [0, -9.81, 0], 'model': model}))
        assert main([*command, *options]) in (0, 2)
        found.append(json.loads(capsys.readouterr().out)['torque'])
    assert found[0] == found[1]
