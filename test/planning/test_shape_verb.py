"""`denoc shape`: plans that sessions and scenarios read, and the page of one."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from page_look import require_one_look

from denoc_ros.cli.main import main
from denoc_ros.cli.motion_file import read_motion
from denoc_ros.errors import ConfigError

ROBOT = 'config/robots/two_link_ff.urdf'
MOTION = {
    'gravity': [0, 0, 0],
    'reference': {'kind': 'book', 'start': [0.2, 0.6], 'rate': [0.4, 0.3], 'period': 2.0},
}


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    file = tmp_path / 'motion.yaml'
    file.write_text(yaml.safe_dump(MOTION))
    return file


def shaped(
    capsys: pytest.CaptureFixture[str], motion: Path, output: Path, *more: str
) -> dict[str, Any]:
    arguments = ['shape', ROBOT, str(motion), '-o', str(output), '--json', *more]
    assert main(arguments) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.long
def test_a_scenario_simulates_the_plan(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    plan = tmp_path / 'plan.yaml'
    told = shaped(capsys, motion, plan)
    assert told['tip_error_m'] < 1e-6
    assert told['begins_s'] < 0.0 < told['equation_error_m'] < 1e-5
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text('gravity: [0, 0, 0]\nreference: plan.yaml\nduration: 3\n')
    run = tmp_path / 'run.mcap'
    assert main(['simulate', ROBOT, str(scenario), '-o', str(run), '--json']) == 0
    simulated = json.loads(capsys.readouterr().out)
    points = yaml.safe_load(plan.read_text())
    assert points['joints'] == ['joint_1', 'joint_2']
    assert points['positions'][-1] == pytest.approx([1.0, 1.2], abs=1e-9)
    for name, largest in told['largest_torque'].items():
        assert simulated['largest_torque'][name] == pytest.approx(largest, rel=1e-3)


def test_the_table_has_what_every_coordinate_does(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    told = shaped(capsys, motion, tmp_path / 'plan.csv', '--interval', '0.05')
    with (tmp_path / 'plan.csv').open(newline='') as file:
        head, *rows = list(csv.reader(file))
    values = np.array(rows, dtype=float)
    assert head[:2] == ['time', 'joint_1/position']
    assert 'link_2/y2/acceleration' in head
    assert values[0, 0] == pytest.approx(told['begins_s'])
    assert np.diff(values[:, 0]).max() <= 0.05 + 1e-9
    torque = values[:, head.index('joint_1/effort')]
    assert np.abs(torque).max() == pytest.approx(told['largest_torque']['joint_1'], rel=0.02)


@pytest.mark.long
def test_the_page_sets_the_plan_beside_the_motion(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    page = tmp_path / 'plan.html'
    told = shaped(capsys, motion, tmp_path / 'plan.yaml', '--page', str(page))
    plain, better = told['simulated']['plain'], told['simulated']['shaped']
    assert plain['swing_m'] > 1e-3
    assert better['swing_m'] < 1e-3 * plain['swing_m']
    assert better['moving_rms_m'] < 1e-3 * plain['moving_rms_m']
    off = told['variations']['beam.link_1.y.ei -20 %']['shaped']
    assert better['swing_m'] < off['swing_m'] < plain['swing_m']
    text = page.read_text()
    require_one_look(text, str(tmp_path))
    assert 'beam.link_2.y.ei +20 %' in re.sub('<[^>]*>', '', text)
    assert 'The tip goes where it should' in text


def test_a_payload_and_limits_of_the_command_line_count(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    free = shaped(capsys, motion, tmp_path / 'free.yaml', '--payload', 'tool=2')
    bound = 0.7 * free['largest_torque']['joint_1']
    slower = shaped(
        capsys, motion, tmp_path / 'slow.yaml', '--payload', 'tool=2',
        '--effort', f'joint_1={bound}',
    )  # fmt: skip
    assert slower['stretch'] > 1.1
    assert slower['largest_torque']['joint_1'] <= bound * (1 + 1e-6)


def test_shapers_come_by_the_same_command(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    told = shaped(capsys, motion, tmp_path / 'plan.yaml', '--method', 'zv')
    assert told['delay_s'] > 0.0


@pytest.mark.parametrize(
    ('more', 'message'),
    [
        (['-o', 'plan.txt'], '--output must end in .yaml or .csv'),
        (['-o', 'p.yaml', '--interval', '0'], '--interval must be > 0 s'),
        (['-o', 'p.yaml', '--method', 'ei', '--turn', '1'], '--turn is for --method tip, got ei'),
        (['-o', 'p.yaml', '--velocity', 'fast'], "--velocity must be JOINT=VALUE, got 'fast'"),
    ],
)
def test_bad_options_are_refused(
    capsys: pytest.CaptureFixture[str], motion: Path, more: list[str], message: str
) -> None:
    assert main(['shape', ROBOT, str(motion), *more]) == 1
    assert message in capsys.readouterr().err


def test_nothing_is_overwritten(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    kept = tmp_path / 'plan.yaml'
    kept.write_text('mine')
    assert main(['shape', ROBOT, str(motion), '-o', str(kept)]) == 1
    assert 'output must not exist yet' in capsys.readouterr().err
    assert kept.read_text() == 'mine'


def test_a_joint_trajectory_message_is_a_motion() -> None:
    points: list[dict[str, Any]] = [
        {'positions': [0.1 * k, 0.2 * k], 'time_from_start': {'sec': k, 'nanosec': 500_000_000}}
        for k in range(3)
    ]
    joints = ['a', 'b', 'c']
    values: dict[str, Any] = {'joint_names': ['b', 'a'], 'points': points}
    times, rows = read_motion(values, Path('moveit.yaml'), joints)
    assert times.tolist() == [0.5, 1.5, 2.5]
    assert rows[2].tolist() == pytest.approx([0.4, 0.2, 0.0])
    points[1] = {'positions': [1.0]}
    with pytest.raises(ConfigError, match=r'moveit\.yaml: points 1 must have time_from_start'):
        read_motion(values, Path('moveit.yaml'), joints)
    with pytest.raises(ConfigError, match='points must be two or more, got 1'):
        read_motion({**values, 'points': points[:1]}, Path('moveit.yaml'), joints)
    with pytest.raises(ConfigError, match=r"joint_names must be of .*, got \['d'\]"):
        read_motion({**values, 'joint_names': ['d']}, Path('moveit.yaml'), joints)
    with pytest.raises(ConfigError, match='must have a kind, a reference or joint_names'):
        read_motion({'duration': 3}, Path('moveit.yaml'), joints)


def test_a_motion_file_that_ends_in_motion_is_refused() -> None:
    ends = [
        {'positions': [k], 'velocities': [0.5 * k], 'time_from_start': {'sec': k}} for k in (0, 1)
    ]
    points = {
        'kind': 'points', 'times': [0, 1], 'positions': [[0], [1]], 'velocities': [[0], [0.5]],
    }  # fmt: skip
    for values in ({'joint_names': ['a'], 'points': ends}, points):
        with pytest.raises(ConfigError, match=r'm\.yaml: a motion must begin .* rest, got 0\.5 '):
            read_motion(values, Path('m.yaml'), ['a'])
    still = {**points, 'velocities': [[0], [0]]}
    assert read_motion(still, Path('m.yaml'), ['a'])[0].tolist() == [0.0, 1.0]


@pytest.mark.long
def test_the_configuration_of_a_mechanism_is_a_motion(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Its joints are driven, its posture picks the assembly, its tip and model count."""
    robot, config = 'robots/five_bar_ffff.urdf', 'config/five_bar.yaml'
    output = tmp_path / 'plan.yaml'
    assert main(['shape', robot, config, '-o', str(output), '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    assert list(told['largest_torque']) == ['joint_1', 'joint_3']
    assert told['tip_error_m'] < 1e-5
    values = yaml.safe_load(Path(config).read_text())
    with pytest.raises(ConfigError, match='posture must be 4 numbers'):
        read_motion(
            {**values, 'posture': [1.0]}, Path(config), [f'joint_{k}' for k in range(1, 5)]
        )


def test_options_of_the_other_methods_count(
    motion: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = shaped(capsys, motion, tmp_path / 'one.yaml', '--method', 'zv', '--modes', '1')
    all_ = shaped(capsys, motion, tmp_path / 'all.yaml', '--method', 'zv', '--modes', '4')
    assert one['delay_s'] < all_['delay_s']
    more = ['--method', 'rest_to_rest', '--duration', '1.2', '--robustness', '0']
    rest = shaped(capsys, motion, tmp_path / 'rest.yaml', *more)
    assert rest['ends_s'] == pytest.approx(1.2)
    arguments = ['shape', ROBOT, str(motion), '-o', str(tmp_path / 'no.yaml')]
    assert main([*arguments, '--method', 'zv', '--duration', '1']) == 1
    assert '--duration is for --method rest_to_rest, got zv' in capsys.readouterr().err
