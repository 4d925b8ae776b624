"""The sessions that are shipped: each is whole, and its nodes' parameters are theirs."""

from __future__ import annotations

from pathlib import Path

import pytest

from denoc_ros.cli.session.node_parameters import check_parameters
from denoc_ros.cli.session.session import session_nodes
from denoc_ros.cli.session.session_config import load_config
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.reports.measures import SETTLED
from denoc_ros.simulation.reference_motion import trajectory_from_config

CONFIG = Path(__file__).resolve().parents[3] / 'config'
SESSIONS = (
    'canadarm',
    'canadarm_fusion',
    'five_bar',
    'ssrms',
    'ssrms_10t',
    'ssrms_fusion',
    pytest.param('tip', marks=pytest.mark.parts('planning', 'feedback')),
    'ur10',
)


@pytest.mark.parametrize('name', SESSIONS)
def test_shipped_session_is_whole(name: str) -> None:
    session = load_config(CONFIG / f'{name}.yaml')
    assert Path(session.robot).is_file()
    check_parameters(session, session_nodes(session, None))


def test_the_session_of_a_floating_arm_measures_its_base() -> None:
    session = load_config(CONFIG / 'ssrms_10t.yaml')
    assert session.nodes['predictor']['base_motion'] == 'odometry'
    assert session.nodes['feedforward']['base'] == 'free_floating'


def test_the_demo_moves_the_tip_with_and_without_a_wrong_model() -> None:
    session = load_config(CONFIG / 'tip.yaml')
    robot = load_robot(session.robot, session.gravity)
    joints = list(robot.tree.non_mimic_joints)
    motion = trajectory_from_config(session.reference, joints, 'reference')
    # it stops well before the end of the phase, so that the report shows what is left of swing
    assert session.duration >= motion.duration + SETTLED + 0.5
    wrong = [phase for phase in session.phases if 'plant' in phase.nodes]
    right = [phase for phase in session.phases if phase not in wrong]
    assert [bool(phase.shape) for phase in right] == [False, False, True]
    assert [phase.nodes['feedforward'].get('feedback.state', 'off') for phase in wrong] == [
        'off',
        'lqr',
        'lqr',
    ]
    assert [phase.identify for phase in wrong] == ['', '', 'wrong model']
    last = next(body for body in robot.tree.bodies if body.name == 'link_3')
    for phase in wrong:
        changed = dict(phase.nodes['plant'])
        assert changed.pop('payload.tool.mass') == pytest.approx(0.2 * last.inertia.mass)
        for path, value in changed.items():
            assert value == pytest.approx(0.9 * session.plant_model[path])
