"""A plant whose damping nobody told the model: recording, identify, apply, replay."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from denoc_ros.cli.main import main
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.model.numbers import values_of

PATH = 'beam.link_1.y.damping_ratio'
TRUE = [0.012, 0.008]
STOP = 0.76  # s; the joint stands from 0.75 s on
SCENARIO = f"""
gravity: [0, -9.81, 0]
model: {{{PATH}: {TRUE}}}
prescribed:
  joint_1:
    kind: points
    times: [0, 0.5, 0.75, 4]
    positions: [[0], [0], [0.6], [0.6]]
    velocities: [[0], [0], [0], [0]]
    accelerations: [[0], [0], [0], [0]]
start: {{amplitudes: static}}
duration: 4
output_rate: 500
"""
GRAVITY = ['--gravity', '0', '-9.81', '0']


def test_identified_damping_is_the_plants_and_predicts_its_deflection(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = str(repository / 'config/robots/one_flexible_link.urdf')
    scenario, bag = tmp_path / 'swing.yaml', str(tmp_path / 'run.mcap')
    scenario.write_text(SCENARIO)
    assert main(['simulate', robot, str(scenario), '-o', bag]) == 0
    result, changed = str(tmp_path / 'modes'), str(tmp_path / 'identified.urdf')
    signal = ['--topic', '/plant/true_deflection', '--field', 'link_1/uy', '--begin', str(STOP)]
    main(['identify', 'modal', bag, *signal, *GRAVITY, '--robot', robot, '-o', result])
    apply = ['identify', 'apply', result, '--robot', robot, *GRAVITY, '--doubtful']
    assert main([*apply, '-o', changed]) == 0
    found = values_of(load_robot(changed).tree)[PATH]
    # the second mode is not to be seen once the joint stands, and so stays as it was
    np.testing.assert_allclose(np.ravel(found)[0], TRUE[0], rtol=0.02)
    capsys.readouterr()
    errors = []
    for one in (robot, changed):
        page = str(tmp_path / 'page.html')
        replay = ['replay', bag, '--robot', one, *GRAVITY, '--no-output', '--report', page]
        assert main([*replay, '--json']) == 0
        deflection = json.loads(capsys.readouterr().out)['deflection']
        (topic,) = (name for name in deflection if 'true_deflection' in name)
        errors.append(deflection[topic]['link_1/uy']['rms'])
    assert errors[1] < 0.1 * errors[0]
