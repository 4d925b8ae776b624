"""Feedback of a session is shown stable at a rate before its loop runs there."""

from __future__ import annotations

from pathlib import Path

import pytest
from data_files import CLAMPED_FREE_CANADARM

from denoc_ros.cli.session.session_config import load_config
from denoc_ros.cli.session.session_time import feedback_refusal
from denoc_ros.dynamics.robot import load_robot

SESSION = """
robot: ROBOT
gravity: [0, 0, 0]
reference: {kind: sine, amplitude: 0.1, frequency: 0.2, duration: 5}
phases:
  - {name: open, feedforward: {model: flexible}}
  - {name: closed, feedforward: {model: flexible, feedback: FEEDBACK}}
"""
LONG = 300.0  # s for a design, on a machine that is busy with others


@pytest.mark.long_cases('{state: lqr}-1000.0-')
@pytest.mark.parametrize(
    ('feedback', 'rate', 'says'),
    [
        ('{state: lqr}', 1000.0, ''),
        ('{state: "off"}', 20.0, ''),
        (
            '{state: lqr}',
            250.0,
            'feedback of phase “closed” does not hold at 250 Hz: state feedback',
        ),
        (
            '{strain_gain: [500, 500, 500], cutoff: 100}',
            20.0,
            'feedback of phase “closed” does not hold at 20 Hz: ',
        ),
    ],
)
def test_the_designs_own_check_decides(
    feedback: str, rate: float, says: str, tmp_path: Path
) -> None:
    file = tmp_path / 'session.yaml'
    text = SESSION.replace('FEEDBACK', feedback)
    file.write_text(text.replace('ROBOT', str(CLAMPED_FREE_CANADARM)))
    config = load_config(file, [])
    robot = load_robot(config.robot, gravity=config.gravity)
    said = feedback_refusal(config, robot, rate, LONG)
    assert said.startswith(says)
    assert bool(said) == bool(says)
