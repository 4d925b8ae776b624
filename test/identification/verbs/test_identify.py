"""`denoc identify`: verdicts as exit statuses, results that are read again, damping applied."""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml
from book.selftest import Defects, Truth, synthetic_decay
from data_files import SERVO_SWING
from page_look import require_one_look

from denoc_ros.cli.main import main
from denoc_ros.identification.decay.channel import Channel, read_record
from denoc_ros.identification.decay.records import Record
from denoc_ros.identification.identification_result import source_of
from denoc_ros.identification.pages.identify_result import interval_text
from denoc_ros.identification.verbs.actions import ACTIONS, ActionRow
from denoc_ros.identification.verbs.identify_options import SHARED, action_of
from denoc_ros.output_files import Document
from denoc_ros.settings import positive

MODES = (Truth(1.1, 0.01, 1.0, 0.3), Truth(20.5, 0.004, 0.3, 1.0))
BAG = Defects(40.0, offset=0.1, drift=0.05, jitter=0.1, lost=0.05)


def table(path: Path, record: Record) -> str:
    np.savetxt(
        path, np.column_stack((record.t, record.y)), delimiter=',', header='time,y', comments=''
    )
    return str(path)


@pytest.fixture(scope='module')
def decay(tmp_path_factory: pytest.TempPathFactory) -> str:
    record = synthetic_decay(MODES, 200.0, 8.0, BAG, 3).record
    return table(tmp_path_factory.mktemp('decay') / 'two.csv', record)


def test_modes_are_found_and_kept(
    decay: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / 'result'
    # without a name of an action the modes are meant
    assert main(['identify', decay, '-o', str(folder), '--unit', 'm', '--json']) == 0
    printed = json.loads(capsys.readouterr().out)
    document = yaml.safe_load((folder / 'result.yaml').read_text())
    assert document == printed
    assert document['source']['calibration'] == {'gain': 1.0, 'offset': 0.0, 'unit': 'm'}
    assert len(document['source']['sha256']) == 64
    assert document['verdict'] == 'good'
    for mode, truth in zip(document['modes'], MODES, strict=True):
        # five standard deviations of what is possible
        assert mode['damping_ratio'] == pytest.approx(truth.damping_ratio, rel=5 * mode['bound'])
        assert mode['frequency_hz'] == pytest.approx(truth.frequency, rel=1e-3)
        assert {check['method'] for check in mode['checks']} == {
            'evolving spectra',
            'log decrement (exact)',
            'log decrement (book)',
        }
    rows = (folder / 'modes.csv').read_text().splitlines()
    assert len(rows) == 1 + len(MODES)
    page = (folder / 'report.html').read_text()
    for heading in (
        'Measured and fitted',
        'held out',
        'Decay of each mode',
        'Damping ratio against amplitude',
        'Evolving spectra',
        'Spectrum of the residual',
        'Methods',
    ):
        assert heading in page
    require_one_look(page, str(tmp_path))


def test_exit_status_is_the_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    noisy = synthetic_decay([Truth(2.0, 0.02)], 50.0, 8.0, Defects(15.0), 1).record
    assert main(['identify', table(tmp_path / 'noisy.csv', noisy)]) == 2
    noise = np.random.default_rng(2).standard_normal(400)
    nothing = table(tmp_path / 'nothing.csv', Record(np.linspace(0.0, 4.0, 400), noise))
    assert main(['identify', nothing]) == 3
    assert 'verdict: not identifiable' in capsys.readouterr().out
    assert main(['identify', 'modal', str(tmp_path / 'nowhere.mcap')]) == 1
    assert main(['identify', nothing, '--field', 'z']) == 1
    assert main(['identify', nothing, '--gain', '0', '--begin', '3', '--end', '2']) == 1
    errors = capsys.readouterr().err.splitlines()
    assert 'bag must exist' in errors[0]
    assert "field must be a column of numbers (time, y), got 'z'" in errors[1]
    assert 'gain must not be 0' in errors[2]
    assert 'begin must be before' in errors[3]


def test_exit_status_is_that_of_the_modes_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    strong, weak = Truth(3.0, 0.01, 1.0, 0.3), Truth(17.0, 0.02, 0.04, 1.0)
    record = synthetic_decay([strong, weak], 100.0, 10.0, Defects(40.0), 4).record
    modal = ['identify', 'modal', table(tmp_path / 'companion.csv', record)]
    assert main(modal) == 0
    assert 'verdict: good (of 3 Hz)' in capsys.readouterr().out
    assert main([*modal, '--modes', '2']) in (2, 3)
    assert main([*modal, '--band', '10:30']) in (2, 3)
    assert main([*modal, '--band', ':10']) == 0
    capsys.readouterr()
    assert main([*modal, '--band', '30:40']) == 3
    assert 'no mode asked for was found' in capsys.readouterr().out
    for wrong in (['--band', '3'], ['--band', '5:2'], ['--modes', '0']):
        assert main([*modal, *wrong]) == 1
    errors = capsys.readouterr().err
    assert "--band must be LO:HI in Hz, got '3'" in errors
    assert '--band must have 0 <= LO < HI, got 5:2' in errors
    assert '--modes must be >= 1, got 0' in errors


def test_apply_says_how_doubtful_modes_are_taken(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mode = {'verdict': 'doubtful', 'frequency_hz': 3.0}
    (tmp_path / 'result.yaml').write_text(yaml.safe_dump({'kind': 'modal', 'modes': [mode]}))
    robot = str(repository / 'config/robots/canadarm.urdf')
    apply = ['identify', 'apply', str(tmp_path), '--robot', robot, '-o', str(tmp_path / 'a.urdf')]
    assert main(apply) == 1
    assert 'got 1 doubtful: --doubtful takes them' in capsys.readouterr().err


@pytest.mark.long
def test_page_of_a_swing_that_says_little_is_written(tmp_path: Path) -> None:
    joint = [
        'identify',
        'joint',
        str(SERVO_SWING),
        '--field',
        'position',
        '--begin',
        '3',
        '--json',
    ]
    # the last swings before it stops
    assert main([*joint, '-o', str(tmp_path)]) == 2
    assert 'explains the swing about as well' in (tmp_path / 'report.html').read_text()
    document = yaml.safe_load((tmp_path / 'result.yaml').read_text())
    assert all(None not in one['interval'] for one in document['terms'].values())


def test_interval_that_is_not_finite_is_said_in_words() -> None:
    assert interval_text([0.1, 0.2]) == '95 %: 0.1 … 0.2'
    assert interval_text([None, None]) == '95 %: not determined'


def test_info_tells_what_a_record_is_worth(decay: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['identify', 'info', decay, '--json']) == 0
    (row,) = json.loads(capsys.readouterr().out)['signals']
    assert row['signal'] == 'y'
    assert row['rate_hz'] == pytest.approx(200.0, rel=0.05)
    # 5 % of 1600 samples were dropped: a binomial's standard deviation is 0.5 %
    assert row['lost'] == pytest.approx(0.05, abs=0.025)
    assert row['gaps'] > 50
    assert main(['identify', 'info', decay]) == 0
    assert main(['identify', 'info', decay, '--field', 'x']) == 1


def test_what_all_signals_lack_is_said_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'untimed.csv'
    file.write_text('u,y\n' + '0.1,0.2\n' * 20)
    assert main(['identify', 'info', str(file)]) == 1
    assert capsys.readouterr().err.count('column of times') == 1


@pytest.fixture(scope='module')
def rung(
    tmp_path_factory: pytest.TempPathFactory, repository: Path
) -> tuple[Path, dict[str, list[float]]]:
    """Bag of an arm that rings with its joints locked, and the damping it has."""
    folder = tmp_path_factory.mktemp('rung')
    truth = {
        'beam.link_1.y.damping_ratio': [0.02, 0.01],
        'beam.link_2.y.damping_ratio': [0.03, 0.01],
    }
    scenario = {
        'gravity': [0, 0, 0],
        'model': truth,
        'start': {
            'joints': [0.0, 0.6, 0.2],
            'amplitudes': {'link_1/y1': 0.02, 'link_2/y2': 0.004},
        },
        'prescribed': {
            f'joint_{k + 1}': {'kind': 'points', 'times': [0, 20], 'positions': [[value], [value]]}
            for k, value in enumerate((0.0, 0.6, 0.2))
        },
        'duration': 20,
        'output_rate': 50,
    }
    (folder / 'ring.yaml').write_text(yaml.safe_dump(scenario))
    robot = str(repository / 'config/robots/canadarm.urdf')
    bag = folder / 'ring.mcap'
    assert main(['simulate', robot, str(folder / 'ring.yaml'), '-o', str(bag)]) == 0
    return bag, truth


@pytest.mark.long
def test_applied_damping_is_what_rang(
    rung: tuple[Path, dict[str, list[float]]],
    repository: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from denoc_ros.dynamics.robot import load_robot
    from denoc_ros.model.numbers import values_of

    bag, truth = rung
    signal = ['--topic', '/plant/true_deflection', '--gravity', '0', '0', '0', '--end', '20']
    results = [str(tmp_path / 'result')]
    main(['identify', str(bag), *signal, '--field', 'link_2/uy', '-o', results[0]])
    assert 'N s/m of link_2/y1' in capsys.readouterr().out
    robot, changed = str(repository / 'config/robots/canadarm.urdf'), tmp_path / 'changed.urdf'
    apply = ['identify', 'apply', *results, '--robot', robot, '--gravity', '0', '0', '0']
    assert main([*apply, '--doubtful', '-o', str(changed)]) == 0
    values = values_of(load_robot(changed).tree)
    for path, value in truth.items():
        # the beams foreshorten: what rings is not quite linear, and has no noise besides
        np.testing.assert_allclose(np.ravel(values[path]), value, rtol=0.03)
    before, after = Path(robot).read_text().splitlines(), changed.read_text().splitlines()
    edited = [new for old, new in zip(before, after, strict=True) if old != new]
    assert len(edited) == 2
    assert all('damping_ratio' in line for line in edited)
    assert main([*apply, '--doubtful', '-o', str(changed)]) == 1
    assert 'must not exist yet' in capsys.readouterr().err
    assert main(['identify', 'compare', results[0], results[0]]) == 0
    assert main([*apply[:2], str(bag), *apply[3:], '-o', str(tmp_path / 'x.urdf')]) == 1
    assert 'result must be readable' in capsys.readouterr().err


MODE = 'frequency_hz: 2, damping_ratio: 0.1, amplitude: 1, interval: [0, 1], verdict: good'


@pytest.mark.parametrize(
    ('text', 'finding'),
    [
        ('{kind: modal, modes: 3}', 'modes must be a list, got 3'),
        ('{kind: modal, modes: [3]}', r'modes\[0\] must be a mapping, got 3'),
        (
            '{kind: modal, modes: [{}]}',
            r'modes\[0\].frequency_hz must be a number > 0 Hz, got None',
        ),
        (f'{{kind: modal, modes: [{{{MODE}, interval: 3}}]}}', 'interval must be two finite'),
        (f'{{kind: modal, modes: [{{{MODE}, verdict: 3}}]}}', 'verdict must be a text, got 3'),
        ('{kind: modal, model: {joints: {a: b}}}', 'model.joints.a must be a finite number'),
        ('{kind: joint, terms: {viscous: {}}}', 'terms.viscous.value must be a finite number'),
        ('{kind: joint, terms: [1]}', 'terms must be a mapping'),
    ],
)
@pytest.mark.parametrize('verb', ['compare', 'apply', 'postures'])
def test_a_damaged_result_is_refused(
    tmp_path: Path,
    repository: Path,
    capsys: pytest.CaptureFixture[str],
    verb: str,
    text: str,
    finding: str,
) -> None:
    file = tmp_path / 'result.yaml'
    file.write_text(text)
    robot = ['--robot', str(repository / 'config/robots/canadarm.urdf')]
    options = {
        'compare': [str(file)],
        'apply': [*robot, '-o', str(tmp_path / 'new.urdf')],
        'postures': ['-o', str(tmp_path / 'new.yaml')],
    }
    assert main(['identify', verb, str(file), *options[verb]]) == 1
    assert re.search(f'result.yaml: .*{finding}', capsys.readouterr().err)


def test_a_result_whose_numbers_are_not_finite_can_be_compared(tmp_path: Path) -> None:
    file = tmp_path / 'result.yaml'
    file.write_text(f'{{kind: modal, modes: [{{{MODE}, interval: [null, null]}}]}}')
    assert main(['identify', 'compare', str(file), str(file)]) == 0


def test_options_of_actions_are_the_arguments_of_their_computations() -> None:
    for name, row in ACTIONS.items():
        action = action_of(name)
        assert action.name == name
        declared = getattr(
            importlib.import_module(f'denoc_ros.identification.{row.module}'), 'DECLARED', ()
        )
        assert {one.name for one in declared} <= ACTIONS.keys()
        parser = argparse.ArgumentParser()
        action.add_options(parser)
        options = {each.dest for each in parser._actions} | {'command'}
        assert set(inspect.signature(action.fit).parameters) <= options | {
            *SHARED,
            *action.settings,
        }


@dataclass(frozen=True)
class LevelOptions:
    above: float = positive(1.0, 'level that is counted above', 'm/s^2')


def identify_level(path: Path, channel: Channel, options: LevelOptions) -> tuple[Document]:
    """Count how many samples are above a level.

    Returns
    -------
    tuple
        The count.
    """
    reading = read_record(path, channel)
    document = {
        'kind': 'level',
        'source': source_of(reading),
        'samples_above': int(np.count_nonzero(reading.record.y > options.above)),
        'method': 'counted',
        'verdict': 'doubtful',
        'reasons': ['a count is no mode'],
    }
    return (document,)


def test_an_action_is_its_computation_and_a_row(
    decay: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    module = ModuleType('denoc_ros.identification.level')
    module.identify_level = identify_level  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(ACTIONS, 'level', ActionRow('count samples', 'level'))
    asked = ['identify', 'level', decay, '--above', '0.5']
    assert main([*asked, '-o', str(tmp_path)]) == 2
    above = yaml.safe_load((tmp_path / 'result.yaml').read_text())['samples_above']
    assert above == np.count_nonzero(np.loadtxt(decay, delimiter=',', skiprows=1)[:, 1] > 0.5)
    said = capsys.readouterr().out
    assert f'samples above  {above}' in said
    assert 'verdict: doubtful' in said
    assert 'a count is no mode' in said
    page = (tmp_path / 'report.html').read_text()
    assert 'samples above' in page
    assert 'a count is no mode' in page
    assert main(['identify', 'level', decay, '--above', '0']) == 1
    assert '--above must be > 0 m/s^2, got 0' in capsys.readouterr().err
    assert main(['identify', 'level', '--help']) == 0
    said = capsys.readouterr().out
    assert 'Count how many samples are above a level.' in said
    assert '--above M/S2' in said
