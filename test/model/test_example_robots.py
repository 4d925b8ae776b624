"""Robots in use: every URDF of example-robot-data loads, with no meshes at hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
from lxml import etree
from yourdfpy import URDF, Inertial

from denoc_ros.errors import ModelError
from denoc_ros.model.findings import Findings
from denoc_ros.model.rigid_urdf import RigidUrdfJoint, read_rigid_urdf
from denoc_ros.model.tree import Mimic, RigidInertia
from denoc_ros.model.urdf import load_tree

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


def test_links_and_joints_are_those_of_another_reader() -> None:
    """Numbers against yourdfpy's, which reads the same files with code of its own."""
    compared = 0
    for path in sorted(ROBOTS.rglob('*.urdf')):
        if path.name in BAD:
            continue
        other = URDF.load(str(path), build_scene_graph=False, load_meshes=False).robot
        findings = Findings()
        found = read_rigid_urdf(etree.parse(str(path)).getroot(), findings, [])
        assert not findings.items
        for link in other.links:
            assert_same_inertia(found.links[link.name], link.inertial)
        joints = {joint.name: joint for joint in found.joints}
        assert len(joints) == len(other.joints)
        for joint in other.joints:
            assert_same_joint(joints[joint.name], joint)
            compared += 1
    assert compared > 1000


def assert_same_inertia(found: RigidInertia | None, expected: Inertial | None) -> None:
    """The other's is about the centre of mass, along axes of its own."""
    if found is None or expected is None:
        assert found is expected
        return
    pose = np.eye(4) if expected.origin is None else expected.origin
    rotation, centre = pose[:3, :3], pose[:3, 3]
    shift = np.cross(np.eye(3), centre)
    about_centre = rotation @ expected.inertia @ rotation.T
    np.testing.assert_allclose(found.mass, expected.mass)
    np.testing.assert_allclose(found.first_moment, expected.mass * centre, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(
        found.inertia, about_centre + expected.mass * shift @ shift.T, rtol=1e-12, atol=1e-14
    )


def assert_same_joint(found: RigidUrdfJoint, expected: Any) -> None:
    assert (found.parent, found.child) == (expected.parent, expected.child)
    assert found.continuous == (expected.type == 'continuous')
    pose = np.eye(4) if expected.origin is None else expected.origin
    np.testing.assert_allclose(found.origin, pose, rtol=0.0, atol=1e-14)
    if expected.type in ('fixed', 'floating'):
        return
    np.testing.assert_allclose(found.axis, expected.axis / np.linalg.norm(expected.axis))
    ranged = expected.type != 'continuous'
    for name in ('velocity', 'effort', *(('lower', 'upper') if ranged else ())):
        given = getattr(expected.limit, name, None)
        assert given is None or getattr(found.limits, name) == given
    for name in ('damping', 'friction'):
        assert getattr(found, name) == float(getattr(expected.dynamics, name, None) or 0.0)
    if expected.mimic is None:
        assert found.mimic is None
    else:
        follows = expected.mimic.joint, expected.mimic.multiplier, expected.mimic.offset
        assert found.mimic == Mimic(*follows)
