"""Rigidity from recordings of links that are no beams of few modes: hinged chains in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.sources import Recording

pytest.importorskip('mujoco', reason='MuJoCo is the plant (extra: mujoco)')
from mujoco_runs import chain_recording

ROBOT = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'canadarm_gauges.urdf'
TRUTH = {'beam.link_1.y.ei': 1e5, 'beam.link_2.y.ei': 2e5}
ARMATURE = 0.05  # of what hangs on the joint
SIZE = 0.2  # of the motion: larger ones bend links beyond small deflections


@pytest.fixture(scope='module')
def arm() -> Robot:
    robot = dn.load_robot(ROBOT, gravity=(0, 0, 0)).with_overrides({'payload.tool.mass': 100.0})
    hung = np.diag(robot.inertia_matrix(np.zeros(robot.n)))[robot.joint_indices]
    inertia = zip(robot.joint_names, ARMATURE * hung, strict=True)
    return robot.with_overrides({f'joint.{name}.armature': float(own) for name, own in inertia})


@pytest.fixture(scope='module')
def run(arm: Robot) -> Recording:
    return chain_recording(arm, 5.0, SIZE)


def off(arm: Robot, shape: str) -> Robot:
    """Return the arm as its model says it: with such shapes, rigidities a fifth too high."""
    changes: dict[str, float | str] = {path: 1.2 * value for path, value in TRUTH.items()}
    return arm.with_overrides({f'beam.link_{k}.shape': shape for k in (1, 2)} | changes)


def test_rigidity_of_links_with_right_shapes_is_theirs(arm: Robot, run: Recording) -> None:
    found = dn.identify_model(off(arm, 'craig-bampton'), run, list(TRUTH))
    assert not found.reasons
    for path, truth in TRUTH.items():  # 0.2 and 1.2 % below
        assert found.verdict[path] == 'found'
        assert found.values[path] == pytest.approx(truth, rel=0.02)


@pytest.mark.long
def test_rigidity_that_mends_wrong_shapes_is_doubtful(arm: Robot, run: Recording) -> None:
    """Clamped-free shapes turn too little at the tip: a softer link mends some of that."""
    found = dn.identify_model(off(arm, 'clamped-free'), run, list(TRUTH))
    wrong = [path for path, value in TRUTH.items() if abs(found.values[path] / value - 1) > 0.05]
    assert wrong  # 16 and 36 % below
    assert found.reasons
    assert 'found' not in found.verdict.values()


def test_a_tracker_with_right_shapes_finds_the_rigidity(arm: Robot, run: Recording) -> None:
    model = off(arm, 'craig-bampton')
    bounds = {path: (0.6 * value, 1.8 * value) for path, value in TRUTH.items()}
    tracker = dn.ParameterTracker(model, list(TRUTH), bounds=bounds)
    readings = [raw for _, raw in run.sensors.values()]
    gains = [sensor.gain for sensor in arm.tree.sensors]
    for k, now in enumerate(run.t):
        for place, (raw, gain) in enumerate(zip(readings, gains, strict=True)):
            tracker.sense(place, now, gain * raw[k] + arm.tree.sensors[place].offset)
        assert run.velocity is not None
        tracker.measure(now, run.position[k], run.velocity[k], effort=run.effort[k])
        if now > 1.5:  # 1 % at most
            off_by = np.array(tracker.values) / list(TRUTH.values()) - 1.0
            assert np.abs(off_by).max() < 0.02
    assert tracker.supported.all()
