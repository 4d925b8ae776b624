"""Sessions in simulated time: nothing is late or lost, and a run can be had again."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from bench.loops.rates_blocks import domain
from node_robots import two_links

from denoc_ros.bags.reader import read_raw

pytestmark = pytest.mark.ros

# what tells of the machine, not of the robot; the time is repeated while it stands
OF_THE_MACHINE = ('/diagnostics', '/rosout', '/parameter_events', '/clock', '/predictor/markers')
PADDED = ('/predictor/tip_pose',)  # a byte between its fields is not set
# the shaper plans while time stands, and is a partner of the plant, as the predictor is
SESSION = """
robot: arm.urdf
time: simulated
reference: {kind: points, times: [0, 0.6], positions: [[0, 0], [0.2, 0.1]]}
duration: 1
nodes:
  plant: {update_rate: 100}
  predictor: {update_rate: 100}
  feedforward: {update_rate: 100}
  shaper: {method: zvd, update_rate: 100}
plant: {noise: {position: 1.0e-5}}
phases: [{name: first}, {name: second, feedforward: {model: rigid}, plant: {start: [0.05, 0]}}]
"""
TOPICS = {
    *('/joint_states', '/feedforward/effort', '/predictor/modal_state', '/shaper/input'),
    *('/reference', '/plant/true_modal_state'),
}
FIRST_PHASE = 1_000_000_000  # ns


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    with domain() as environment:
        yield environment


def contents(bag: Path) -> dict[str, str]:
    """Return a digest of the messages of each topic from the first phase on."""
    found: dict[str, hashlib._Hash] = {}
    for topic, _, log_ns, raw in read_raw(bag):
        if (
            topic not in (*OF_THE_MACHINE, *PADDED)
            and not topic.endswith(('/time', '/transition_event'))
            and log_ns > FIRST_PHASE
        ):
            digest = found.setdefault(topic, hashlib.sha256())
            digest.update(bytes(raw))
    return {topic: digest.hexdigest() for topic, digest in found.items()}


@pytest.mark.long
def test_two_simulated_sessions_give_the_same_messages(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    (tmp_path / 'arm.urdf').write_text(two_links())
    (tmp_path / 'session.yaml').write_text(SESSION)
    bags = []
    for name in ('one', 'two'):
        command = [
            sys.executable,
            '-m',
            'denoc_ros.cli.main',
            'up',
            str(tmp_path / 'session.yaml'),
        ]
        done = subprocess.run(
            [*command, '--output', str(tmp_path / name)],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            timeout=400.0,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert 'simulated time, as asked for' in done.stdout
        summary = json.loads((tmp_path / name / 'summary.json').read_text())
        assert int(summary['recorder']['lost']) == 0, summary['recorder']
        assert all(loop['late'] == 0 for loop in summary['loops'].values())
        assert list(summary['phases']) == ['first', 'second']
        bags.append(contents(tmp_path / name / 'bag'))
    one, two = bags
    assert set(one) >= TOPICS
    assert [topic for topic in one if one[topic] != two.get(topic)] == []


LEARNING = """
robot: arm.urdf
gravity: [0, -9.81, 0]
time: simulated
reference:
  kind: points
  times: [0, 0.8, 1.6, 2.4]
  positions: [[0, 0], [0.3, -0.2], [0.1, 0.3], [0.4, 0.1]]
duration: 3
nodes:
  plant: {update_rate: 200, feedback: {kp: 200, kd: 20}}
  predictor: {update_rate: 200}
  feedforward: {update_rate: 200}
plant: {beam: {one.y.ei: 330, two.y.ei: 270}}
phases: [{name: guessed}, {name: identified, identify: guessed}]
"""


@pytest.mark.parts('identification', 'reports')
def test_a_phase_works_with_the_numbers_that_an_earlier_one_told(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    (tmp_path / 'arm.urdf').write_text(two_links())
    (tmp_path / 'session.yaml').write_text(LEARNING)
    words = ['-m', 'denoc_ros.cli.main', 'up', str(tmp_path / 'session.yaml')]
    done = subprocess.run(
        [sys.executable, *words, '--output', str(tmp_path / 'run')],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=400.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    phases = json.loads((tmp_path / 'run' / 'session.json').read_text())['phases']
    assert phases[1]['identified']['from'] == 'guessed'
    for path, true in (('beam.one.y.ei', 330.0), ('beam.two.y.ei', 270.0)):
        assert phases[1]['model'][path] == pytest.approx(true, rel=0.03)
        assert phases[1]['plant'][path] == true
    summary = json.loads((tmp_path / 'run' / 'summary.json').read_text())['phases']
    before, after = (
        max(each['percent_of_peak'] for each in summary[name]['deflection_error'].values())
        for name in ('guessed', 'identified')
    )
    assert after < 0.5 * before
