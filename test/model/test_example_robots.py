"""Robots in use: every URDF of example-robot-data loads, with no meshes at hand."""

from __future__ import annotations

from pathlib import Path

import pinocchio
import pytest

from denoc_ros.errors import ModelError
from denoc_ros.model.reading.urdf import load_tree

ROBOTS = Path(pinocchio.__file__).parents[4] / 'share' / 'example-robot-data' / 'robots'
# Truly bad files of the package: mimic joints that follow none, and one without a robot.
BAD = {
    'alex_psyonic_hands.urdf': 'must be a movable joint of the robot',
    'ur3.urdf': 'links must be at least one, got none',
}


def test_every_example_robot_loads() -> None:
    paths = sorted(ROBOTS.rglob('*.urdf'))
    assert len(paths) > 40
    for path in paths:
        if path.name in BAD:
            with pytest.raises(ModelError, match=BAD[path.name]):
                load_tree(path)
        else:
            tree = load_tree(path)
            joints = [body.joint for body in tree.bodies if body.joint is not None]
            assert len({joint.name for joint in joints}) == len(joints)
