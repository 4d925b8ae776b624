"""Recorded runs of an arm with elastic joints, measured on either side of its springs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from geared_arm import arm_text
from simulated_bags import PERIOD, swing

import denoc_ros as dn
from denoc_ros.bags.reader import read_raw
from denoc_ros.bags.series import JointStateColumns, read_joint_states
from denoc_ros.dynamics.driven.measured_side import MeasuredStates
from denoc_ros.simulation.simulate import Run
from denoc_ros.simulation.simulated_bag import write_run


def moved(robot: dn.Robot) -> Run:
    """The arm with its motors swinging from rest."""
    start = robot.static_deflection(np.zeros(2))
    motion = {'shoulder': swing(0.4, 2.0), 'elbow': swing(0.3, 3.1)}
    t = PERIOD * np.arange(400, dtype=np.float64)
    return dn.simulate(robot, start, 0.0 * start, t, prescribed=motion, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize('side', ['motor', 'link'])
def test_torque_is_computed_on_the_side_that_is_measured(tmp_path: Path, side: str) -> None:
    robot = dn.load_robot(arm_text(side))
    run = moved(robot)
    path = tmp_path / 'run.mcap'
    write_run(run, robot, path, robot.tree.source)

    columns = JointStateColumns('/joint_states')
    for _, _, log_ns, raw in read_raw(path, ['/joint_states']):
        columns.append(raw, log_ns)
    recorded = np.asarray(columns.series().position)
    states, wanted = MeasuredStates(robot), np.zeros((len(run.t), 2))
    for row, q in zip(wanted, run.q, strict=True):
        states.positions(q, row)
    np.testing.assert_allclose(recorded, wanted, atol=1e-12)
    apart = np.abs(run.q[:, robot.flexible_indices]).max()
    assert apart > 1e-3  # rad

    replay = dn.replay_bag(path, robot)
    model = 'flexible' if side == 'motor' else 'rigid'
    found = replay.torque[model]
    # of the start, an acceleration of 2 rad/s^2 from rest, the filter leaves a per cent
    assert (found.rms < 0.02 * found.measured_rms).all()
    other = dn.load_robot(arm_text('link' if side == 'motor' else 'motor'))
    wrong = dn.replay_bag(path, other).torque['rigid' if side == 'motor' else 'flexible']
    assert (wrong.rms > 3.0 * found.rms).all()


@pytest.mark.parametrize('side', ['motor', 'link'])
def test_springs_are_computed_from_either_side(tmp_path: Path, side: str) -> None:
    robot = dn.load_robot(arm_text(side))
    run, path = moved(robot), tmp_path / 'run.mcap'
    write_run(run, robot, path, robot.tree.source)
    output = tmp_path / 'replay.mcap'
    dn.replay_bag(path, robot, output)
    modal = read_joint_states(output, '/replay/modal_state')
    assert modal.names == robot.coordinate_names
    springs, motors = robot.flexible_indices, robot.joint_indices
    assert np.ptp(run.q[:, springs], axis=0).min() > 3e-4  # rad
    # rms of the range: from the link's side the cutoff of the motion, and the filter on torque
    off = [
        found[50:-50] - true[50:-50]
        for found, true in ((modal.position, run.q), (modal.velocity, run.qd))
    ]
    for part, true, reach in zip(off, (run.q, run.qd), (0.03, 0.3), strict=True):
        rms = np.sqrt(np.mean(part[:, springs] ** 2, axis=0))
        assert (rms < reach * np.ptp(true[:, springs], axis=0)).all()
    assert np.abs(off[0][:, motors]).max() < 1e-4
