"""`denoc up --time auto`: what is rehearsed leaves nothing in the session."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench.loops.rates_blocks import domain

from denoc_ros.bags.reader import header_stamp_ns, read_bag
from denoc_ros.types import Array

pytestmark = pytest.mark.ros
START = (0.3, 0.6)  # rad
SESSION = """
robot: robots/two_link_ff.urdf
gravity: [0, 0, 0]  # an arm that only torque holds would fall beside other tests
reference: {kind: points, times: [0, 0.8], positions: [[0.3, 0.6], [0.7, 0.9]]}
duration: 1
nodes:
  plant: {update_rate: 250}
  feedforward: {update_rate: 250}
  predictor: false
"""
# with the parameters of the second phase, the first one's would be refused
FED = """
robot: robots/canadarm_gauges.urdf
gravity: [0, 0, 0]
reference: {kind: points, times: [0, 0.8], positions: [[0.17, 0.7, 0.52], [0.2, 0.72, 0.54]]}
duration: 1
nodes:
  plant: {update_rate: 250}
  feedforward: {update_rate: 250}
  predictor: false
phases:
  - {name: plain, feedforward: {model: rigid}}
  - {name: fed, feedforward: {model: flexible, feedback: {state: lqr}}}
"""
# whatever the machine holds beside other tests
COMMAND = """
import sys
from denoc_ros.cli.session import session
from denoc_ros.cli.main import main
from denoc_ros.cli.session.session_time import Choice
session.choose = lambda rehearsal, refusal: Choice('real', rehearsal.rates, 'for a test')
sys.exit(main(sys.argv[1:]))
"""
STILL = 1e-3  # rad, m; the motion is 0.4 rad
BEGINNING, BEFORE = 20, 50  # rows: of the bag, and of what comes before the reference


def recorded(folder: Path, mode: str, session: str = SESSION) -> dict[str, list[Any]]:
    """Run the session; return its messages by topic."""
    file, run = folder / f'{mode}.yaml', folder / mode
    file.write_text(session)
    with domain() as environment:
        done = subprocess.run(
            [sys.executable, '-c', COMMAND, 'up', str(file), '--time', mode, '--output', str(run)],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            timeout=240.0,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert not (run / 'rehearsal').exists()
    assert json.loads((run / 'summary.json').read_text())['recorder']['path'] == str(run / 'bag')
    found: dict[str, list[Any]] = {}
    for message in read_bag(run / 'bag'):
        found.setdefault(message.topic, []).append(message)
    return found


def test_bags_begin_alike_with_and_without_a_rehearsal(tmp_path: Path) -> None:
    real, auto = (recorded(tmp_path, mode) for mode in ('real', 'auto'))
    own = {name for name in real if name.startswith(('/plant', '/feedforward', '/up'))}
    assert {*own, '/joint_states', '/reference', '/robot_description'} <= set(auto)
    for found in (real, auto):
        (reference,) = found['/reference']
        begin_ns = header_stamp_ns(reference.message)
        joints = column(found, '/joint_states', begin_ns)
        modes = column(found, '/plant/true_modal_state', begin_ns)
        for motion, rest in ((joints, np.array([START])), (modes, modes[-1:, 0])):
            for part in (motion[-BEFORE:], motion[: BEGINNING if found is auto else 0]):
                assert np.abs(part[:, 0] - rest).max(initial=0.0) < STILL
                assert np.abs(part[:, 1]).max(initial=0.0) < 10.0 * STILL
        assert [each.message.data for each in found['/up/phase']] == ['run', '']


@pytest.mark.long
def test_another_phase_than_the_first_may_be_rehearsed(tmp_path: Path) -> None:
    found = recorded(tmp_path, 'auto', FED)
    assert [each.message.data for each in found['/up/phase']] == ['plain', '', 'fed', '']


def column(found: dict[str, list[Any]], topic: str, end_ns: int) -> Array:
    """Return positions and velocities (k, 2, n) before a stamp [ns]."""
    messages = [each.message for each in found[topic]]
    before = [each for each in messages if header_stamp_ns(each) < end_ns]
    return np.array([(each.position, each.velocity) for each in before])
