"""`denoc identify servo` on bags of synthetic arms."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from page_look import require_one_look

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.identification.decay.channel import Channel
from denoc_ros.identification.servo.servo_runs import ServoOptions, servo_runs
from denoc_ros.planning.shapers.joint_servo import joint_servo
from denoc_ros.types import Array

STEP = 0.004
SECOND = 10**9
NAMES = ['j1', 'j2']
SERVO = ([5.0, 9.0], [0.5, 0.9], [0.004, 0.02])


def motion(t: Array) -> Array:
    """Return two joints (k, 2) at times (k,): a step of minimum jerk each, from 0.5 s on."""
    s = np.clip((t - 0.5) / 0.4, 0.0, 1.0)
    step = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return np.asarray(np.outer(step, [0.5, -0.3]))


def stamp(t: float) -> dict[str, int]:
    seconds, rest = divmod(round(t * SECOND), SECOND)
    return {'sec': seconds, 'nanosec': rest}


def point(t: float, q: Array) -> dict[str, object]:
    return {'positions': q.tolist(), 'time_from_start': stamp(t)}


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / 'arm.mcap'
    fine = np.arange(0.0, 3.0, STEP / 8)
    reached = joint_servo(2, *SERVO).response(fine, motion(fine))
    with BagWriter(path) as writer:
        writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        writer.add_topic('/reference', 'trajectory_msgs/msg/JointTrajectory')
        writer.add_topic('/told', 'sensor_msgs/msg/JointState')
        times = np.arange(0.0, 2.5, 0.02)
        rows = [point(t, q) for t, q in zip(times, motion(times), strict=True)]
        writer.write_message('/reference', 10 * SECOND, joint_names=NAMES, points=rows)
        for k, t in enumerate(np.arange(0.0, 2.5, STEP).tolist()):
            now = 10 * SECOND + round(t * SECOND)
            told = motion(np.array([t]))[0].tolist()
            measured = reached[8 * k].tolist()
            writer.write_message('/told', now, name=NAMES, position=told)
            writer.write_message('/joint_states', now, name=NAMES, position=measured)
    return path


@pytest.mark.long_cases('/told')
@pytest.mark.parametrize('topic', ['/reference', '/told'])
def test_servos_are_found_from_trajectories_and_from_streams(
    bag: Path, topic: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['identify', 'servo', str(bag), '--command', topic, '--json']) == 0
    found = json.loads(capsys.readouterr().out)['joints']
    for name, *truth in zip(NAMES, *SERVO, strict=True):
        assert found[name]['bandwidth_hz'] == pytest.approx(truth[0], rel=0.01)
        assert found[name]['damping'] == pytest.approx(truth[1], rel=0.02)
        assert found[name]['delay_s'] == pytest.approx(truth[2], abs=5e-4)


def test_result_is_kept_and_shown(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / 'result'
    assert main(['identify', 'servo', str(bag), '--joint', 'j2', '-o', str(folder)]) == 0
    text = capsys.readouterr().out
    assert 'servo.bandwidth: [9' in text
    assert 'verdict: good' in text
    document = yaml.safe_load((folder / 'result.yaml').read_text())
    assert list(document['joints']) == ['j2']
    require_one_look((folder / 'report.html').read_text())


def test_what_is_not_there_is_said(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['identify', 'servo', str(bag), '--joint', 'elbow']) == 1
    assert (
        "--joint must be of ['j1', 'j2'] on /reference, got ['elbow']" in capsys.readouterr().err
    )
    assert main(['identify', 'servo', str(bag), '--begin', '3', '--end', '2']) == 1
    assert '--begin must be before --end' in capsys.readouterr().err
    assert main(['identify', 'servo', str(bag), '--begin', '50']) == 1
    assert 'must have positions after the first command' in capsys.readouterr().err
    # after the motion nothing moves any more
    assert main(['identify', 'servo', str(bag), '--begin', '2']) == 3
    assert 'samples of a command that moves by' in capsys.readouterr().out


def written_table(path: Path, names: str, t: Array) -> None:
    fine = np.arange(0.0, 3.0, STEP / 8)
    reached = joint_servo(2, *SERVO).response(fine, motion(fine))
    told, was = motion(t)[:, 0], np.interp(t, fine, reached[:, 0])
    rows = [f'{1e3 * a:.1f},{b:.9f},{c:.9f}' for a, b, c in zip(t, told, was, strict=True)]
    path.write_text('\n'.join([names, *rows]))


@pytest.mark.long_cases('Time (ms),j1/command,j1/position-options0')
@pytest.mark.parametrize(
    ('names', 'options'),
    [
        ('Time (ms),j1/command,j1/position', []),
        (
            'tick,goal,encoder',
            ['--column', 'j1.command=goal', '--column', 'j1.position=encoder', '--rate', '250'],
        ),
        (
            'tick,j1.command,j1.position',
            ['--time', 'tick', '--time-unit', 'ms', '--joint', 'j1'],
        ),
    ],
)
def test_tables_are_taken_and_runs_are_fitted_together(
    tmp_path: Path, names: str, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [tmp_path / 'one.csv', tmp_path / 'two.csv']
    for path, last in zip(paths, (2.0, 2.5), strict=True):
        written_table(path, names, np.arange(0.0, last, STEP))
    folder = tmp_path / 'servo'
    command = ['identify', 'servo', *map(str, paths), *options, '--json', '-o', str(folder)]
    assert main(command) == 0
    found = json.loads(capsys.readouterr().out)['joints']['j1']
    assert found['bandwidth_hz'] == pytest.approx(SERVO[0][0], rel=0.01)
    assert found['damping'] == pytest.approx(SERVO[1][0], rel=0.02)
    assert found['gain'] == pytest.approx(1.0, abs=1e-3)
    assert found['runs'] == 2
    require_one_look((folder / 'report.html').read_text())


def test_tables_without_commands_say_which_columns_they_have(
    tmp_path: Path, bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'one.csv'
    written_table(path, 'time_ms,goal,encoder', np.arange(0.0, 2.0, STEP))
    assert main(['identify', 'servo', str(path)]) == 1
    said = capsys.readouterr().err
    assert 'got time_ms, goal, encoder' in said
    assert '--column elbow.command=COLUMN' in said
    assert main(['identify', 'servo', str(path), '--column', 'j1.command=goal']) == 1
    assert 'j1 must have a column of its position' in capsys.readouterr().err
    assert main(['identify', 'servo', str(bag), '--column', 'j1.command=goal']) == 1
    assert '--column must come with a table, got a bag' in capsys.readouterr().err


@pytest.mark.parametrize('topic', ['/reference', '/told'])
def test_positions_that_wrap_give_what_the_others_give(tmp_path: Path, topic: str) -> None:
    """Both joints pass half a turn; the measured ones begin a turn away from the commands."""
    runs = []
    for wraps in (False, True):
        path = tmp_path / f'{wraps}.mcap'
        with BagWriter(path) as writer:
            writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
            writer.add_topic('/reference', 'trajectory_msgs/msg/JointTrajectory')
            writer.add_topic('/told', 'sensor_msgs/msg/JointState')
            for t in np.arange(0.0, 2.0, STEP).tolist():
                now = 10 * SECOND + round(t * SECOND)
                told, measured = (3.0 + motion(np.array([at]))[0] for at in (t, t - 0.02))
                if wraps:
                    told = (told + np.pi) % (2.0 * np.pi) - np.pi
                    measured = (measured + np.pi) % (2.0 * np.pi) - np.pi - 2.0 * np.pi
                writer.write_message('/told', now, name=NAMES, position=told.tolist())
                header = {'stamp': stamp(10.0 + t)}
                writer.write_message(
                    '/reference', now, header=header, joint_names=NAMES, points=[point(0.0, told)]
                )
                writer.write_message('/joint_states', now, name=NAMES, position=measured.tolist())
        runs.append(servo_runs(path, ServoOptions(Channel(topic='/joint_states'), topic)))
    for name in NAMES:
        for plain, wrapped in zip(runs[0][name], runs[1][name], strict=True):
            np.testing.assert_allclose(wrapped - plain, wrapped[0] - plain[0], atol=1e-9)
        _, told, measured = runs[1][name]
        assert np.abs(told - measured).max() < 0.5
