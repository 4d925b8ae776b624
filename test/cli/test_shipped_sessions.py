"""The sessions that are shipped: each is whole, and its nodes' parameters are theirs."""

from __future__ import annotations

from pathlib import Path

import pytest

from denoc_ros.cli.config import load_config

CONFIG = Path(__file__).resolve().parents[2] / 'config'
SESSIONS = (
    'canadarm',
    'canadarm_fusion',
    'five_bar',
    'ssrms',
    'ssrms_10t',
    'ssrms_fusion',
    'ur10',
)


@pytest.mark.parametrize('name', SESSIONS)
def test_shipped_session_is_whole(name: str) -> None:
    session = load_config(CONFIG / f'{name}.yaml')
    assert Path(session.robot).is_file()


def test_the_session_of_a_floating_arm_measures_its_base() -> None:
    session = load_config(CONFIG / 'ssrms_10t.yaml')
    assert session.nodes['predictor']['base_motion'] == 'odometry'
    assert session.nodes['feedforward']['base'] == 'free_floating'
