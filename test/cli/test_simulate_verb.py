"""`denoc simulate`: a bag that everybody reads, or one clear message."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from denoc_ros.cli.main import main

SCENARIOS = {
    'single_link': ['single_link'],
    'spinning_beam': ['spinning_beam'],
    'spinning_beam_without_geometric_stiffness': ['spinning_beam'],
    'two_link': ['two_link_rr', 'two_link_rf', 'two_link_fr', 'two_link_ff'],
    'canadarm': ['canadarm', 'canadarm_rrr'],
    'ssrms': ['ssrms'],
    'puma': ['puma'],
    'puma_free_fall': ['puma'],
    'stanford': ['stanford', 'stanford_flexible'],
    'stanford_forced': ['stanford', 'stanford_flexible'],
    'stanford_free_fall': ['stanford', 'stanford_flexible'],
    'single_link_free_fall': ['single_link'],
    'clamped_beam': ['clamped_beam'],
    'pendulum_free_fall': ['rigid_pendulum', 'one_flexible_link'],
    'four_bar': ['four_bar_rrr', 'four_bar_rrf', 'four_bar_rff', 'four_bar_fff'],
    'five_bar': ['five_bar_rrrr', 'five_bar_rffr', 'five_bar_frrf', 'five_bar_ffff'],
    'planar_3dof': ['planar_3dof_3rr', 'planar_3dof_3rf', 'planar_3dof_3ff'],
    'planar_3dof_circle': ['planar_3dof_3rr', 'planar_3dof_3ff'],
    'rssr': ['rssr_rrr', 'rssr_rrf', 'rssr_frr', 'rssr_fff'],
    'ship_boom': ['ship_boom'],
    'ssrms_10t': ['ssrms_10t', 'ssrms_100t'],
    'stability_puma': ['puma'],
    'stability_canadarm': ['canadarm'],
    'stability_ssrms': ['ssrms'],
}


def test_every_shipped_scenario_fits_its_robots(repository: Path) -> None:
    from denoc_ros.cli.simulate_verb import load

    config = repository / 'config'
    assert {path.stem for path in (config / 'scenarios').glob('*.yaml')} == set(SCENARIOS)
    for scenario, robots in SCENARIOS.items():
        for robot in robots:
            model, made, _ = load(
                str(config / 'robots' / f'{robot}.urdf'),
                str(config / 'scenarios' / f'{scenario}.yaml'),
            )
            assert made.q0.shape == (model.n,)


def test_run_is_written_as_a_bag_and_summed_up(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = repository / 'config' / 'robots' / 'canadarm.urdf'
    scenario = tmp_path / 'short.yaml'
    scenario.write_text(
        'gravity: [0, 0, 0]\ntorque:\n  kind: rigid_inverse_dynamics\n'
        '  reference: {kind: book, form: half, rate: 0.05, period: 5, duration: 0.5}\n'
    )
    bag = tmp_path / 'run'
    assert main(['simulate', str(robot), str(scenario), '-o', str(bag), '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['samples'] == 51
    assert summary['largest_deflection']['link_1/uy'] > 1e-3
    with AnyReader([bag]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts == {
            '/joint_states': 51,
            '/plant/true_modal_state': 51,
            '/plant/true_deflection': 51,
            '/reference': 1,
        }
        largest = 0.0
        for connection, stamp, raw in reader.messages():
            if connection.topic == '/plant/true_deflection':
                message = reader.deserialize(raw, connection.msgtype)
                place = message.name.index('link_1/uy')
                largest = max(largest, abs(float(message.position[place])))
                assert stamp == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    assert largest == pytest.approx(summary['largest_deflection']['link_1/uy'])


def test_existing_output_is_never_overwritten(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = repository / 'config'
    robot, scenario = config / 'robots/two_link_ff.urdf', config / 'scenarios/two_link.yaml'
    taken = tmp_path / 'taken.mcap'
    taken.write_bytes(b'precious')
    assert main(['simulate', str(robot), str(scenario), '-o', str(taken)]) == 1
    assert 'must not exist yet' in capsys.readouterr().err
    assert taken.read_bytes() == b'precious'


def test_bad_scenario_is_one_message_per_finding(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / 'bad.yaml'
    scenario.write_text('duration: 1\nmethod: Euler\ntorque: {kind: step, values: {elbow: 1}}\n')
    robot = repository / 'config/robots/two_link_ff.urdf'
    assert main(['simulate', str(robot), str(scenario), '-o', str(tmp_path / 'x.mcap')]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "must name some of joint_1, joint_2, got 'elbow'" in lines[0]
    assert "got 'Euler'" in lines[1]
    assert main(['simulate', str(robot), 'nowhere.yaml', '-o', str(tmp_path / 'x.mcap')]) == 1
    assert 'the scenario must be a file' in capsys.readouterr().err


def test_diverging_run_says_how_far_it_came(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / 'long.yaml'
    scenario.write_text(
        'gravity: [0, 0, 0]\ngeometric_stiffness: false\nduration: 40\noutput_rate: 1\n'
        'prescribed: {joint_1: {kind: spin_up, rate: 6000.0, time: 10.0}}\n'
    )
    robot = repository / 'config/robots/spinning_beam.urdf'
    assert main(['simulate', str(robot), str(scenario), '-o', str(tmp_path / 'x.mcap')]) == 1
    error = capsys.readouterr().err
    assert 'simulate: DOP853 must reach t = 40 s, got to' in error
    assert not np.any([path.suffix == '.mcap' for path in tmp_path.iterdir()])
