"""A robot as an SDF model (Gazebo): the chain of rods and sprung hinges of the MJCF model.

The chain is described once, by :mod:`denoc_ros.export.mjcf`; its elements are written as SDF here:
every body a link, every hinge a joint with a spring. Where a body has several hinges, those before
the last carry links of `SHARE` of its inertia, because a link of SDF must have some.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from denoc_ros.errors import ModelError
from denoc_ros.export.mjcf import SEGMENTS, mjcf
from denoc_ros.model.reading.findings import Element, Findings
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.tree import Tree
from denoc_ros.types import Array

VERSION = '1.11'  # has mimic joints
SHARE = 0.01  # of a body's mass and inertia: of the link between two of its hinges
LEFT_OUT = {
    'armature': 'rotor inertia of joints: SDF has none',
    'tendon': 'damping of single modes: only that in proportion to stiffness is written',
    'sensor': 'gauges and inertial sensors',
}


@dataclass(frozen=True)
class Sdf:
    """A model for Gazebo."""

    text: str  # the file. Links and joints have the names of the MJCF model's bodies and joints.
    notes: tuple[str, ...]  # what is left out, or means something else than the description


def sdf(tree: Tree, gravity: Array, segments: int = SEGMENTS, folder: Path | None = None) -> Sdf:
    """Return a robot as an SDF model.

    Parameters
    ----------
    gravity : ndarray (3,)
        Of the MJCF model that it is made from; in SDF the world has it.

    Raises
    ------
    ModelError
        With everything that SDF cannot hold, by its name.
    """
    findings = Findings()
    for loop in tree.loops:
        findings.add(
            f'loop {loop.name!r}', f'must not be in SDF, whose joints make a tree, got {loop.type}'
        )
    for body in tree.bodies:
        if body.joint is None:
            continue
        spring = body.joint.spring
        if spring is not None and spring.stiffness3:
            rule = 'stiffness3 must be 0 in SDF, whose springs are linear'
            findings.add(
                f'spring of joint {body.joint.name!r}', f'{rule}, got {spring.stiffness3:g}'
            )
    ModelError.raise_any(tree.name, findings.items)
    made = mjcf(tree, gravity, segments, folder)
    chain = etree.fromstring(made.text.encode())
    writer = _SdfWriter(chain)
    root = etree.Element('sdf', version=VERSION)
    model = etree.SubElement(root, 'model', name=tree.name)
    for body in chain.findall('worldbody/body'):
        writer.body(model, body, 'world')
    notes = [note for name, note in LEFT_OUT.items() if writer.has(name)]
    kept = [note for note in made.notes if not note.startswith(('modal damping', 'gain and'))]
    text: str = etree.tostring(root, encoding='unicode', pretty_print=True)
    return Sdf(text, (*notes, *kept, 'gravity: that of the world'))


class _SdfWriter:
    def __init__(self, chain: Element) -> None:
        self._chain = chain
        self._meshes = {mesh.get('name'): mesh for mesh in chain.iterfind('asset/mesh')}
        self._mimics = {each.get('joint1'): each for each in chain.iterfind('equality/joint')}
        self._efforts = {
            motor.get('joint'): motor.get('ctrlrange', '').split()[-1:]
            for motor in chain.iterfind('actuator/motor')
        }

    def has(self, name: str) -> bool:
        """Say whether the chain has an element that SDF lacks."""
        if name == 'armature':
            return self._chain.find('.//joint[@armature]') is not None
        return self._chain.find(f'{name}/*') is not None

    def body(self, model: Element, body: Element, parent: str) -> None:
        """Add a body's links and joints, and those of all bodies on it."""
        name, pose = body.get('name'), _pose(body)
        joints = body.findall('joint')
        before, at = parent, pose
        for k, joint in enumerate(joints[:-1], 1):
            between = f'{name}/{k}'
            self._link(model, body, between, before, at, SHARE)
            self._joint(model, joint, before, between)
            before, at = between, np.eye(4)
        share = 1.0 - SHARE * max(0, len(joints) - 1)
        link = self._link(model, body, name, before, at, share)
        if joints:
            self._joint(model, joints[-1], before, name)
        elif body.find('freejoint') is None:
            _fixed(model, f'{name}/fixed', before, name)
        for geom in body.findall('geom'):
            self._geometry(link, geom, len(link))
        for child in body.findall('body'):
            self.body(model, child, name)

    def _link(
        self, model: Element, body: Element, name: str, parent: str, pose: Array, share: float
    ) -> Element:
        link = etree.SubElement(model, 'link', name=name)
        there = {} if parent == 'world' else {'relative_to': parent}
        etree.SubElement(link, 'pose', there).text = _six(pose)
        given, inertial = body.find('inertial'), etree.SubElement(link, 'inertial')
        etree.SubElement(inertial, 'pose').text = _six(pose_of(_numbers(given.get('pos'))))
        etree.SubElement(inertial, 'mass').text = _text(share * float(given.get('mass')))
        inertia = etree.SubElement(inertial, 'inertia')
        moments = _numbers(given.get('fullinertia'))
        for tag, moment in zip(('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz'), moments, strict=True):
            etree.SubElement(inertia, tag).text = _text(share * moment)
        return link

    def _joint(self, model: Element, given: Element, parent: str, child: str) -> None:
        name = given.get('name')
        kind = 'prismatic' if given.get('type') == 'slide' else 'revolute'
        joint = etree.SubElement(model, 'joint', name=name, type=kind)
        etree.SubElement(joint, 'parent').text = parent
        etree.SubElement(joint, 'child').text = child
        place = _numbers(given.get('pos', '0 0 0'))
        etree.SubElement(joint, 'pose').text = _six(pose_of(place))
        axis = etree.SubElement(joint, 'axis')
        etree.SubElement(axis, 'xyz').text = given.get('axis')
        if (mimic := self._mimics.get(name)) is not None:
            offset, multiplier = _numbers(mimic.get('polycoef'))[:2]
            follows = etree.SubElement(axis, 'mimic', joint=mimic.get('joint2'))
            for tag, value in (('multiplier', multiplier), ('offset', offset), ('reference', 0.0)):
                etree.SubElement(follows, tag).text = _text(value)
        limit = etree.SubElement(axis, 'limit')
        ends = given.get('range', '-inf inf').split()
        for tag, value in zip(('lower', 'upper'), ends, strict=True):
            etree.SubElement(limit, tag).text = value
        for effort in self._efforts.get(name, ()):
            etree.SubElement(limit, 'effort').text = effort
        dynamics = etree.SubElement(axis, 'dynamics')
        for tag, attribute in (
            ('damping', 'damping'), ('friction', 'frictionloss'),
            ('spring_stiffness', 'stiffness'),
        ):  # fmt: skip
            etree.SubElement(dynamics, tag).text = given.get(attribute, '0').split()[0]
        etree.SubElement(dynamics, 'spring_reference').text = '0'

    def _geometry(self, link: Element, geom: Element, number: int) -> None:
        """Add a drawing, or a collision shape."""
        tag = 'collision' if geom.get('contype') == '1' else 'visual'
        added = etree.SubElement(link, tag, name=f'{tag}{number}')
        kind, size = geom.get('type'), _numbers(geom.get('size', ''))
        pose = _pose(geom)
        if kind == 'capsule':
            ends = _numbers(geom.get('fromto')).reshape(2, 3)  # along x
            pose[:3, :3] = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
            pose[:3, 3] = ends.mean(axis=0)
            size = np.array([size[0], float(np.linalg.norm(ends[1] - ends[0]))])
        etree.SubElement(added, 'pose').text = _six(pose)
        shape = etree.SubElement(etree.SubElement(added, 'geometry'), kind)
        numbers: dict[str, Array | float] = {}
        if kind == 'box':
            numbers = {'size': 2.0 * size}
        elif kind == 'sphere':
            numbers = {'radius': size[0]}
        elif kind == 'cylinder':
            numbers = {'radius': size[0], 'length': 2.0 * size[1]}
        elif kind == 'capsule':
            numbers = {'radius': size[0], 'length': size[1]}
        else:
            mesh = self._meshes[geom.get('mesh')]
            etree.SubElement(shape, 'uri').text = Path(mesh.get('file')).as_uri()
            etree.SubElement(shape, 'scale').text = mesh.get('scale')
        for name, value in numbers.items():
            etree.SubElement(shape, name).text = _text(value)


def _fixed(model: Element, name: str, parent: str, child: str) -> None:
    joint = etree.SubElement(model, 'joint', name=name, type='fixed')
    etree.SubElement(joint, 'parent').text = parent
    etree.SubElement(joint, 'child').text = child


def _pose(element: Element) -> Array:
    w, x, y, z = _numbers(element.get('quat', '1 0 0 0'))
    rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
    return pose_of(_numbers(element.get('pos', '0 0 0')), rotation)


def _six(pose: Array) -> str:
    angles = Rotation.from_matrix(pose[:3, :3]).as_euler('xyz')
    return _text(np.append(pose[:3, 3], angles))


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


def _text(numbers: Array | float) -> str:
    return ' '.join(f'{number:.17g}' for number in np.ravel(numbers))
