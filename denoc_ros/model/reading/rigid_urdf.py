"""The plain part of a URDF: links' inertia and joints, validated, then read by yourdfpy."""

from __future__ import annotations

import io
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from lxml import etree

from denoc_ros.model.inertia import ROUNDED, ROUNDED_ZERO, from_centre, moved
from denoc_ros.model.reading.findings import Element, Findings, Reader
from denoc_ros.model.tree import Joint, JointKind, Limits, Mimic, RigidInertia
from denoc_ros.types import Array

KINDS = {
    'fixed': JointKind.FIXED,
    'revolute': JointKind.REVOLUTE,
    'continuous': JointKind.REVOLUTE,
    'prismatic': JointKind.PRISMATIC,
    'floating': JointKind.FLOATING,
}
ENDS = ('parent', 'child', 'origin')
WITHOUT_AXIS = ('fixed', 'floating')
CHECKED = (*ENDS, 'axis', 'limit', 'dynamics', 'mimic')  # of a joint; the rest is not read


@dataclass(frozen=True, kw_only=True)
class RigidUrdfJoint(Joint):
    """A joint as the URDF says it, and its links."""

    parent: str
    child: str
    origin: Array  # (4, 4) joint frame seen from the parent link's frame


@dataclass(frozen=True)
class RigidUrdf:
    """A plain URDF: links with their inertia, None without `<inertial>`, and joints."""

    name: str
    links: dict[str, RigidInertia | None]  # in file order, about the link frame's origin
    joints: tuple[RigidUrdfJoint, ...]  # in file order


def read_rigid_urdf(root: Element, findings: Findings, warnings: list[str]) -> RigidUrdf:
    """Return the plain part of a robot.

    Parameters
    ----------
    root : lxml element
        `<robot>`.
    findings : Findings
        Gathers what is wrong.
    warnings : list of str
        Gathers what should not be, but is in robots that are in use.

    Returns
    -------
    RigidUrdf
        Links and joints in file order. With findings: the sound links, and no joints.
    """
    before = len(findings.items)
    Reader(root, 'robot', findings).text('name')
    _check_expanded(root, findings)
    links = _check_names(root, 'link', findings)
    joints = _check_names(root, 'joint', findings)
    if not links:
        findings.add('robot', 'links must be at least one, got none')
    sound = [
        element for element in root.findall('link') if _check_link(element, findings, warnings)
    ]
    for element in root.findall('joint'):
        _check_joint(element, links, findings)
    _check_mimics(root, joints, findings)
    _check_structure(root, links, findings)
    _check_floating(root, findings)
    clean = len(findings.items) == before
    return _load(root.get('name', ''), sound, root.findall('joint') if clean else [])


def _check_expanded(root: Element, findings: Findings) -> None:
    """Note, once, elements that xacro should have replaced."""
    for element in root.iterchildren('{*}*'):
        namespace, _, name = element.tag.rpartition('}')
        if 'xacro' in namespace or name.startswith('xacro:'):
            rule = 'must be expanded first: xacro FILE.xacro > FILE.urdf'
            findings.add('robot', f'xacro {rule}, got <xacro:{name.removeprefix("xacro:")}>')
            return


def _check_names(root: Element, tag: str, findings: Findings) -> set[str]:
    names: set[str] = set()
    for element in root.findall(tag):
        name = Reader(element, tag, findings).text('name')
        if name in names:
            findings.add(f'{tag} {name!r}', 'name must be unique, got it twice')
        names.add(name)
    return names


def _check_link(element: Element, findings: Findings, warnings: list[str]) -> bool:
    """Return whether a link has a name and sound numbers."""
    before = len(findings.items)
    whose = f'link {element.get("name", "")!r}'
    inertials = element.findall('inertial')
    if len(inertials) > 1:
        findings.add(whose, f'<inertial> must occur once, got {len(inertials)}')
    for inertial in inertials:
        _check_inertial(inertial, whose, findings, warnings)
    return len(findings.items) == before and bool(element.get('name'))


def _check_inertial(
    inertial: Element, whose: str, findings: Findings, warnings: list[str]
) -> None:
    for tag in ('mass', 'inertia'):
        if inertial.find(tag) is None:
            findings.add(whose, f'<inertial> must have <{tag}>, got none')
    if inertial.find('mass') is not None:
        mass = Reader(inertial.find('mass'), whose, findings, ' of <mass>')
        mass.number('value', 'kg', least=0.0)
    if inertial.find('origin') is not None:
        Reader(inertial.find('origin'), whose, findings, ' of <inertial>').pose()
    if inertial.find('inertia') is not None:
        inertia = Reader(inertial.find('inertia'), whose, findings, ' of <inertia>')
        moments = [inertia.number(name, 'kg m^2') for name in ('ixx', 'iyy', 'izz')]
        products = [inertia.number(name, 'kg m^2', default=0.0) for name in ('ixy', 'ixz', 'iyz')]
        warnings += [f'{whose}: {warning}' for warning in _doubts(moments, products)]


def _doubts(moments: Sequence[float], products: Sequence[float]) -> list[str]:
    """Return a warning for an inertia that no body has."""
    matrix = np.diag(moments)
    matrix[[0, 0, 1], [1, 2, 2]] = matrix[[1, 2, 2], [0, 0, 1]] = products
    if not np.isfinite(matrix).all():
        return []  # a finding already
    principal = np.linalg.eigvalsh(matrix)
    if principal[0] >= -max(ROUNDED * principal[2], ROUNDED_ZERO):
        return []
    shown = ', '.join(f'{value:.4g}' for value in principal)
    return [f'principal moments of <inertia> should be >= 0 kg m^2, got {shown}']


def _check_joint(element: Element, links: set[str], findings: Findings) -> None:
    whose = f'joint {element.get("name", "")!r}'
    reader = Reader(element, whose, findings)
    if element.get('type') == 'planar':
        rule = f'be one of {", ".join(KINDS)} (planar joints are not supported yet)'
        reader.fail('type', rule, element.get('type'))
    else:
        reader.choice('type', list(KINDS))
    for end in ('parent', 'child'):
        found = element.find(end)
        link = None if found is None else found.get('link')
        if link is None or link not in links:
            findings.add(whose, f'{end} must be a link of the robot, got {link!r}')
    if element.find('origin') is not None:
        Reader(element.find('origin'), whose, findings, ' of <origin>').pose()
    if element.find('axis') is not None and element.get('type') not in WITHOUT_AXIS:
        Reader(element.find('axis'), whose, findings, ' of <axis>').axis('xyz', '1 0 0')
    _check_limits(element, whose, findings)
    _check_dynamics(element, whose, findings)


def _check_limits(element: Element, whose: str, findings: Findings) -> None:
    limit = element.find('limit')
    if limit is None or element.get('type') == 'fixed':
        return
    reader = Reader(limit, whose, findings, ' of <limit>')
    reader.number('effort', least=0.0, default=0.0)
    reader.number('velocity', least=0.0, default=0.0)
    lower, upper = (reader.number(name, default=0.0) for name in ('lower', 'upper'))
    if limit.get('lower') and limit.get('upper') and lower > upper:
        reader.fail('lower', f'be at most upper ({upper:g})', lower)


def _check_dynamics(element: Element, whose: str, findings: Findings) -> None:
    dynamics = element.find('dynamics')
    if dynamics is None or element.get('type') == 'fixed':
        return
    reader = Reader(dynamics, whose, findings, ' of <dynamics>')
    reader.number('damping', least=0.0, default=0.0)
    reader.number('friction', least=0.0, default=0.0)


def _check_mimics(root: Element, joints: set[str], findings: Findings) -> None:
    leaders: dict[str, str] = {}
    movable = {
        joint.get('name')
        for joint in root.findall('joint')
        if joint.get('type') not in WITHOUT_AXIS
    }
    for element in root.findall('joint'):
        mimic, name = element.find('mimic'), element.get('name', '')
        if mimic is None or name not in movable:
            continue
        reader = Reader(mimic, f'joint {name!r}', findings, ' of <mimic>')
        leader = reader.text('joint')
        if leader and leader not in joints & movable:
            reader.fail('joint', 'be a movable joint of the robot', leader)
        reader.number('multiplier', default=1.0)
        reader.number('offset', default=0.0)
        leaders[name] = leader
    for circle in _circles(leaders):
        rule = 'mimic joints must not follow themselves, got a circle of'
        findings.add(f'joint {circle[0]!r}', f'{rule} {", ".join(map(repr, circle))}')


def _circles(follows: dict[str, str]) -> list[list[str]]:
    """Return the circles among names that each follow at most one other."""
    settled: set[str] = set()
    circles = []
    for start in follows:
        path: dict[str, None] = {}
        name = start
        while name in follows and name not in settled and name not in path:
            path[name] = None
            name = follows[name]
        if name in path:
            names = list(path)
            circles.append(names[names.index(name) :])
        settled.update(path)
    return circles


def _check_structure(root: Element, links: set[str], findings: Findings) -> None:
    """Note links with two parents, several roots and circles."""
    parents: dict[str, str] = {}
    for element in root.findall('joint'):
        parent, child = (
            '' if end is None else end.get('link', '')
            for end in (element.find('parent'), element.find('child'))
        )
        if child in parents:
            findings.add(f'link {child!r}', 'must be the child of one joint, got two')
        elif child in links and parent in links:
            parents[child] = parent
    roots = [link.get('name') for link in root.findall('link') if link.get('name') not in parents]
    if len(roots) > 1 and len(parents) == len(root.findall('joint')):
        named = ', '.join(repr(name) for name in roots)
        findings.add('robot', f'root link must be one, got {named}')
    for circle in _circles(parents):
        findings.add(
            'robot', f'links must form a tree, got a circle of {", ".join(map(repr, circle))}'
        )


def _check_floating(root: Element, findings: Findings) -> None:
    """Note misplaced or repeated floating joints, and elements without meaning in one."""
    joints = root.findall('joint')
    children = {
        None if (end := joint.find('child')) is None else end.get('link') for joint in joints
    }
    afloat = [joint for joint in joints if joint.get('type') == 'floating']
    for joint in afloat:
        whose = f'joint {joint.get("name", "")!r}'
        parent = joint.find('parent')
        if parent is not None and parent.get('link') in children:
            rule = 'of type floating must be at the root: its parent link must have no parent'
            findings.add(whose, f'{rule}, got {parent.get("link")!r}')
        if joint.find('mimic') is not None:
            findings.add(whose, 'of type floating must not be a mimic joint, got <mimic>')
        dynamics = joint.find('dynamics')
        for name in ('damping', 'friction') if dynamics is not None else ():
            if dynamics.get(name, '0').strip('0.') != '':
                rule = f'{name} of <dynamics> must be 0 in a floating joint'
                findings.add(whose, f'{rule}, got {dynamics.get(name)!r}')
    if len(afloat) > 1:
        named = ', '.join(repr(joint.get('name', '')) for joint in afloat)
        findings.add('robot', f'floating joints must be at most one, got {named}')


def _load(name: str, links: list[Element], joints: list[Element]) -> RigidUrdf:
    """Read validated elements by yourdfpy."""
    # Imported here: it takes most of a second, and malformed files never get this far.
    from yourdfpy import URDF

    copy = etree.Element('robot', name=name)
    for link in links:
        bare = etree.SubElement(copy, 'link', name=link.get('name'))
        bare.extend(deepcopy(link.findall('inertial')))
    for joint in joints:
        bare = etree.SubElement(copy, 'joint', name=joint.get('name'), type=joint.get('type'))
        for tag in ENDS if joint.get('type') in WITHOUT_AXIS else CHECKED:
            bare.extend(deepcopy(joint.findall(tag)[:1]))
    # as ASCII, a name of other letters would come out malformed, and yourdfpy would mend it
    text = io.BytesIO(etree.tostring(copy, encoding='utf-8'))
    robot = URDF.load(text, build_scene_graph=False, load_meshes=False).robot
    inertias = {link.name: _inertia(link.inertial) for link in robot.links}
    return RigidUrdf(name, inertias, tuple(_joint(joint) for joint in robot.joints))


def _inertia(inertial: Any) -> RigidInertia | None:
    """Return a link's inertia about the link frame's origin, None without `<inertial>`."""
    if inertial is None:
        return None
    pose = np.eye(4) if inertial.origin is None else inertial.origin
    return moved(from_centre(inertial.mass, np.zeros(3), inertial.inertia), pose)


def _joint(joint: Any) -> RigidUrdfJoint:
    kind = KINDS[joint.type]
    axis = np.array([1.0, 0.0, 0.0]) if joint.type in WITHOUT_AXIS else joint.axis
    dynamics = joint.dynamics
    damping, friction = (
        float(getattr(dynamics, name, None) or 0.0) for name in ('damping', 'friction')
    )
    return RigidUrdfJoint(
        joint.name,
        kind,
        axis / np.linalg.norm(axis),
        _limits(joint),
        damping,
        friction,
        mimic=_mimic(joint),
        continuous=joint.type == 'continuous',
        parent=joint.parent,
        child=joint.child,
        origin=np.eye(4) if joint.origin is None else joint.origin,
    )


def _limits(joint: Any) -> Limits:
    given = {
        name: value
        for name in ('lower', 'upper', 'velocity', 'effort')
        if (value := getattr(joint.limit, name, None)) is not None
    }
    if joint.type == 'continuous':
        given.pop('lower', None)
        given.pop('upper', None)
    return Limits(**given)


def _mimic(joint: Any) -> Mimic | None:
    if joint.mimic is None:
        return None
    return Mimic(joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset)
