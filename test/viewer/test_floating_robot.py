"""The page of a robot whose base floats: its modes and its reactions."""

from __future__ import annotations

import numpy as np
from base_robots import description, floating, spacecraft

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.viewer.folders import ModeShapes
from denoc_ros.viewer.overlays import reactions_of


def test_modes_and_reactions_of_a_floating_robot() -> None:
    robot = load_robot(floating(description('two_link_ff'), spacecraft(50.0)), (0, 0, 0))
    shapes = ModeShapes(robot, np.zeros(robot.n))
    assert sum(': 0 Hz' in label for label in shapes.labels) == 6
    assert np.isfinite(shapes.at(7, 0.1)).all()
    q = np.zeros(robot.n)
    q[robot.flexible_indices] = 0.01
    found = reactions_of(robot, Snapshot(0.0, q))
    assert found is not None
    assert found.joints.shape == (len(robot.tree.bodies), 6)
    # nothing holds the base: what carries it gives nothing
    np.testing.assert_allclose(found.joints[0], 0.0, atol=1e-6 * np.abs(found.joints).max())
