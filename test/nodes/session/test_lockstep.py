"""Lockstep: processes whose outputs depend on nothing but configuration and seed."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lockstep_stage import LockstepStage, differences, messages
from node_robots import GRAVITY, two_links

from denoc_ros.bags.reader import read_bag
from denoc_ros.nodes.recorder import Recorder
from denoc_ros.trajectories import SplineTrajectory

pytestmark = pytest.mark.ros
RATES = {'plant': 200.0, 'feedforward': 200.0, 'predictor': 100.0}
JOINTS = ('j1', 'j2')
END = 1.5  # s
STEPS = 300  # of the plant up to there
MOTION = SplineTrajectory(
    np.array([0.0, 0.8]), np.array([[0.0, 0.0], [0.4, -0.3]]), np.zeros((2, 2)), np.zeros((2, 2))
)


@pytest.fixture(scope='module')
def robot(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the file of the arm of two flexible links."""
    file = tmp_path_factory.mktemp('robot') / 'arm.urdf'
    file.write_text(two_links())
    return str(file)


def given(**plant: Any) -> dict[str, dict[str, Any]]:
    """Return parameters of the nodes."""
    found: dict[str, dict[str, Any]] = {name: {'gravity': list(GRAVITY)} for name in RATES}
    found['plant'].update({'noise.position': 1e-5, 'noise.velocity': 1e-4, 'seed': 7, **plant})
    return found


def carried_out(folder: Path, robot: str) -> Path:
    """Carry out a motion in lockstep; return the bag."""
    with LockstepStage(folder, robot, RATES, given()) as stage:
        stage.go_to(0.5)
        stage.follow(JOINTS, MOTION, 0.6)
        stage.go_to(END)
        stage.finish()
        assert stage.client.diagnostics('recorder: recording')
        assert stage.client.diagnostics('plant: clock')['lost_commands'] == '0'
        return stage.bag


@pytest.fixture(scope='module')
def recording(tmp_path_factory: pytest.TempPathFactory, robot: str) -> Path:
    """Return the bag of a run in lockstep."""
    return carried_out(tmp_path_factory.mktemp('lockstep') / 'run', robot)


def test_two_runs_give_the_same_bag(recording: Path, robot: str, tmp_path: Path) -> None:
    first, second = messages(recording), messages(carried_out(tmp_path / 'run', robot))
    assert differences(first, second) == {}
    # nothing is lost: a message for every tick
    ticks = {'/joint_states': STEPS, '/feedforward/commands': STEPS, '/feedforward/effort': STEPS}
    assert {topic: len(first[topic]) for topic in ticks} == ticks
    assert len(first['/clock']) == STEPS + 1


def test_each_step_has_the_command_that_answers_the_state_before(recording: Path) -> None:
    efforts: dict[int, list[float]] = {}
    states: dict[int, list[float]] = {}
    for message in read_bag(recording, ['/joint_states', '/feedforward/effort']):
        found = states if message.topic == '/joint_states' else efforts
        found[message.stamp_ns] = list(message.message.effort)
    stamps = sorted(states)
    for before, stamp in itertools.pairwise(stamps):
        if before in efforts and stamp > 10**9:
            assert states[stamp] == efforts[before]


def test_played_recording_gives_what_the_run_gave(
    graph: Any, recording: Path, robot: str, tmp_path: Path
) -> None:
    from denoc_ros.nodes.feedforward import FeedforwardNode
    from denoc_ros.nodes.predictor import PredictorNode

    for make, name in ((FeedforwardNode, 'feedforward'), (PredictorNode, 'predictor')):
        parameters = {**given()[name], 'update_rate': RATES[name], 'urdf_path': robot}
        graph.add(make, parameters={**parameters, 'use_sim_time': True})
    played = tmp_path / 'played'
    recorder = graph.add(Recorder, parameters={'output': str(played), 'use_sim_time': True})
    graph.spin(0.5)
    words = ['--clock', '--speed', '100', '--listeners', 'feedforward', 'predictor', 'recorder']
    player = subprocess.Popen(
        [sys.executable, '-m', 'denoc_ros.cli.player', str(recording), *words],
        stderr=subprocess.PIPE,
    )
    try:
        graph.until(lambda: player.poll() is not None)
        assert player.returncode == 0, player.communicate()[1]
    finally:
        player.kill()
    recorder.stop()
    run, again = messages(recording), messages(played)
    for topic in ('/feedforward/effort', '/predictor/modal_state'):
        wanted = [raw for _, raw in run[topic]]
        assert [raw for _, raw in again[topic]] == wanted


def test_partner_that_stops_is_named_and_ends_the_run(robot: str, tmp_path: Path) -> None:
    rates = {name: RATES[name] for name in ('plant', 'feedforward')}
    more = given(**{'lockstep.timeout': 2.0})
    with LockstepStage(tmp_path / 'run', robot, rates, more) as stage:
        stage.go_to(0.2)
        stage.signal('feedforward', signal.SIGSTOP)
        stage.client.set_parameters('plant', {'pause_at': 100.0})
        plant = stage.processes._running['plant']
        assert stage.client.until(lambda: plant.poll() is not None, 60.0)
        stage.signal('feedforward', signal.SIGCONT)
        assert plant.returncode == 1
        assert 'feedforward must answer within 2 s' in stage.processes._words('plant')
