"""Replay of mechanisms: the driven joints determine the motion, or it says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated_bags import SimulatedBag, make_mechanism_bag

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import BagError, ModelError, StateError
from denoc_ros.simulation.recorded.replay_bag import replay_bag
from denoc_ros.simulation.recorded.replay_settings import ReplaySettings


def test_a_mechanism_follows_its_driven_joints(repository: Path, tmp_path: Path) -> None:
    simulated = make_mechanism_bag(repository, tmp_path, 'rrrr')
    settings = ReplaySettings(joints=('joint_1', 'joint_3'))
    found = replay_bag(simulated.path, simulated.robot, None, settings)
    rigid = found.torque['rigid']
    # a passive joint has no effort; joints 2 and 4 are not held but given by the loop
    assert found.held == ()
    assert found.plan.ignored == ('joint_2', 'joint_4')
    np.testing.assert_array_less(rigid.rms, 1e-4 * rigid.measured_rms)
    np.testing.assert_allclose(found.shares['unexplained'], 0.0, atol=1e-4)
    assert (np.abs(found.shares['inertia']) > 1e-3).all()


def test_driven_joints_that_do_not_determine_a_mechanism_are_refused(
    repository: Path, tmp_path: Path
) -> None:
    simulated = make_mechanism_bag(repository, tmp_path, 'rrrr')
    for joints, match in (
        ((), 'must move independently of each other'),
        (('joint_1',), 'must leave nothing else free'),
        (('joint_9',), r'must be among those on /joint_states \(joint_1.*got joint_9'),
    ):
        with pytest.raises((StateError, BagError), match=match):
            replay_bag(simulated.path, simulated.robot, None, ReplaySettings(joints=joints))


def test_flexible_links_in_loops_are_refused(
    simulated_bag: SimulatedBag, repository: Path
) -> None:
    robot = load_robot(repository / 'config/robots/four_bar_rff.urdf')
    with pytest.raises(ModelError, match=r"must be rigid for a replay, got loops \['joint_4'\]"):
        replay_bag(simulated_bag.path, robot, None, ReplaySettings(joints=('joint_1',)))
