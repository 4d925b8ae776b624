"""The exported SDF, read back: masses, springs, axes, and the sag and frequencies they give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from lxml import etree
from mujoco_arm import urdf as elastic_arm
from scipy.spatial.transform import Rotation

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ModelError
from denoc_ros.export.mjcf import mjcf
from denoc_ros.export.sdf import sdf
from denoc_ros.model.overrides import with_overrides
from denoc_ros.types import Array

ROBOTS = Path(__file__).resolve().parents[2] / 'config' / 'robots'


def numbers(element: etree._Element, path: str, default: str = '') -> Array:
    return np.array([float(word) for word in (element.findtext(path) or default).split()])


def pose(element: etree._Element) -> Array:
    six, found = numbers(element, 'pose', '0 0 0 0 0 0'), np.eye(4)
    found[:3, 3], found[:3, :3] = six[:3], Rotation.from_euler('xyz', six[3:]).as_matrix()
    return found


class Linearized:
    """Small motions of an SDF model at zero: inertia matrix, stiffness, weight. No other code."""

    def __init__(self, text: str) -> None:
        model = etree.fromstring(text.encode()).find('model')
        self._links = {link.get('name'): link for link in model.findall('link')}
        self._before = {joint.findtext('child'): joint for joint in model.findall('joint')}
        self.names = [j.get('name') for j in model.findall('joint') if j.get('type') != 'fixed']
        count = len(self.names)
        self.inertia, self.weight, self.mass = np.zeros((count, count)), np.zeros((count, 3)), 0.0
        self.stiffness = np.zeros(count)
        self.where: dict[str, Array] = {'world': np.eye(4)}
        for name, link in self._links.items():
            centre = self.place(name) @ pose(link.find('inertial'))
            jacobian = self.jacobian(name, centre[:3, 3])
            mass = float(link.findtext('inertial/mass'))
            own = {tag: float(link.findtext(f'inertial/inertia/{tag}')) for tag in
                   ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')}  # fmt: skip
            matrix = np.array([
                [own['ixx'], own['ixy'], own['ixz']], [own['ixy'], own['iyy'], own['iyz']],
                [own['ixz'], own['iyz'], own['izz']],
            ])  # fmt: skip
            turn = centre[:3, :3]
            self.mass += mass
            self.inertia += mass * jacobian[:3].T @ jacobian[:3]
            self.inertia += jacobian[3:].T @ turn @ matrix @ turn.T @ jacobian[3:]
            self.weight += mass * jacobian[:3].T
        for joint in model.findall('joint'):
            if joint.get('type') != 'fixed':
                spring = float(joint.findtext('axis/dynamics/spring_stiffness'))
                self.stiffness[self.names.index(joint.get('name'))] = spring

    def place(self, name: str) -> Array:
        """Pose of a link in the world."""
        if name not in self.where:
            parent = self._links[name].find('pose').get('relative_to', 'world')
            self.where[name] = self.place(parent) @ pose(self._links[name])
        return self.where[name]

    def jacobian(self, name: str, point: Array) -> Array:
        """Velocity of a point of a link and its angular velocity, per joint rate."""
        found = np.zeros((6, len(self.names)))
        while name != 'world' and name in self._before:
            joint = self._before[name]
            if joint.get('type') != 'fixed':
                at = self.place(name) @ pose(joint)
                axis = at[:3, :3] @ numbers(joint, 'axis/xyz')
                column = self.names.index(joint.get('name'))
                found[:3, column] = np.cross(axis, point - at[:3, 3])
                found[3:, column] = axis
            name = joint.findtext('parent')
        return found

    def held(self, joints: tuple[str, ...]) -> tuple[Array, Array]:
        """Frequencies [Hz] and hinge angles under unit acceleration along y, joints held."""
        free = [k for k, name in enumerate(self.names) if name not in joints]
        inertia, stiffness = self.inertia[np.ix_(free, free)], np.diag(self.stiffness[free])
        squares = scipy.linalg.eigh(stiffness, inertia, eigvals_only=True)
        angles = np.zeros(len(self.names))
        angles[free] = self.weight[free, 1] / self.stiffness[free]
        return np.sqrt(squares) / (2.0 * np.pi), angles

    def moved(self, link: str, point: Array, angles: Array) -> Array:
        """Displacement [m] of a point of a link."""
        at = self.where[link] @ np.append(point, 1.0)
        return np.asarray(self.jacobian(link, at[:3])[:3] @ angles)


@pytest.mark.parametrize('name', ['canadarm', 'ssrms', 'ship_boom'])
def test_frequencies_and_sag_computed_from_the_text_are_the_model_s(name: str) -> None:
    tree = load_robot(ROBOTS / f'{name}.urdf').tree
    beams = [body for body in tree.bodies if body.beam is not None]
    divided = with_overrides(tree, {f'beam.{body.name}.segments': 8 for body in beams})
    robot = Robot(divided, gravity=(0.0, 0.0, 0.0))
    read = Linearized(sdf(tree, np.zeros(3), 16).text)
    found, angles = read.held(robot.joint_names)
    wanted = robot.natural_frequencies(np.zeros(robot.n))
    # 1 % of each rod's inertia is on the link between its two hinges
    np.testing.assert_allclose(found[:4], wanted[:4], rtol=3e-3)
    light = Robot(divided, gravity=(0.0, 1e-6, 0.0))
    q = light.static_deflection(np.zeros(len(robot.joint_names)))
    beam = beams[-1]
    assert beam.beam is not None
    frame = (
        light.frame_pose(beam.name, q)[:3, 3]
        - light.frame_pose(beam.name, np.zeros(light.n))[:3, 3]
    )
    moved = 1e-6 * read.moved(beam.name, np.zeros(3), angles)
    if np.abs(frame).max() > 1e-12:
        np.testing.assert_allclose(moved, frame, atol=2e-3 * np.abs(frame).max())
    assert read.mass == pytest.approx(
        sum(body.inertia.mass for body in tree.bodies)
        + sum(body.beam.mass_per_length * body.beam.length for body in beams if body.beam),
        rel=1e-9,
    )


def test_it_has_the_chain_of_the_mjcf_model() -> None:
    tree = load_robot(ROBOTS / 'ssrms.urdf').tree
    chain = etree.fromstring(mjcf(tree, np.zeros(3), 8).text.encode())
    model = etree.fromstring(sdf(tree, np.zeros(3), 8).text.encode()).find('model')
    theirs = {joint.get('name'): joint for joint in chain.iterfind('.//joint[@axis]')}
    joints = {j.get('name'): j for j in model.findall('joint') if j.get('type') != 'fixed'}
    assert joints.keys() == theirs.keys()
    for name, joint in joints.items():
        for tag, attribute in (('spring_stiffness', 'stiffness'), ('damping', 'damping')):
            wanted = float(theirs[name].get(attribute, '0'))
            assert float(joint.findtext(f'axis/dynamics/{tag}')) == wanted
        assert joint.findtext('axis/xyz') == theirs[name].get('axis')
    masses = {b.get('name'): float(b.find('inertial').get('mass')) for b in chain.iter('body')}
    for name, mass in masses.items():
        parts = [model.find(f"link[@name='{each}']") for each in (name, f'{name}/1', f'{name}/2')]
        whole = sum(float(part.findtext('inertial/mass')) for part in parts if part is not None)
        assert whole == pytest.approx(mass)


def test_springs_of_joints_are_joints_and_rotors_are_told() -> None:
    made = sdf(load_robot(elastic_arm()).tree, np.zeros(3))
    model = etree.fromstring(made.text.encode()).find('model')
    spring = model.find("joint[@name='joint1/spring']")
    assert float(spring.findtext('axis/dynamics/spring_stiffness')) == 2e4
    assert 'rotor inertia of joints: SDF has none' in made.notes


def test_what_sdf_cannot_hold_is_refused_by_name() -> None:
    with pytest.raises(ModelError, match=r'loop .* must not be in SDF, whose joints make a tree'):
        sdf(load_robot(ROBOTS / 'four_bar_rrr.urdf').tree, np.zeros(3))
    hard = elastic_arm().replace('stiffness="20000.0"', 'stiffness="20000.0" stiffness3="5"')
    with pytest.raises(ModelError, match="'joint1': stiffness3 must be 0 in SDF"):
        sdf(load_robot(hard).tree, np.zeros(3))
