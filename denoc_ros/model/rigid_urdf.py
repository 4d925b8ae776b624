"""The plain part of a URDF: links' inertia and joints, read and validated."""

from __future__ import annotations

import math
from collections.abc import Container
from dataclasses import dataclass

import numpy as np
from lxml import etree

from denoc_ros.model.findings import Element, Findings, Reader
from denoc_ros.model.inertia import from_centre, moved
from denoc_ros.model.tree import Joint, JointKind, Limits, Mimic, RigidInertia
from denoc_ros.types import Array

KINDS = {
    'fixed': JointKind.FIXED,
    'revolute': JointKind.REVOLUTE,
    'continuous': JointKind.REVOLUTE,
    'prismatic': JointKind.PRISMATIC,
    'floating': JointKind.FLOATING,
}
# of the largest principal moment, and of moments that are zero [kg m^2]: what rounding leaves
ROUNDED, ROUNDED_ZERO = 1e-3, 1e-12
WITHOUT_AXIS = ('fixed', 'floating')


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
    _check_names(root, 'joint', findings)
    if not links:
        findings.add('robot', 'links must be at least one, got none')
    inertias = _read_links(root, findings, warnings)
    movable = {
        joint.get('name', ''): joint
        for joint in root.findall('joint')
        if joint.get('type') not in WITHOUT_AXIS
    }
    read = [_read_joint(joint, links, movable, findings) for joint in root.findall('joint')]
    mimics = {name: joint.find('mimic') for name, joint in movable.items()}
    leaders = {name: mimic.get('joint', '') for name, mimic in mimics.items() if mimic is not None}
    for circle in _circles(leaders):
        rule = 'mimic joints must not follow themselves, got a circle of'
        findings.add(f'joint {circle[0]!r}', f'{rule} {", ".join(map(repr, circle))}')
    _check_structure(root, links, findings)
    _check_floating(root, findings)
    clean = len(findings.items) == before
    sound = tuple(joint for joint in read if joint) if clean else ()
    return RigidUrdf(root.get('name', ''), inertias, sound)


def _check_expanded(root: Element, findings: Findings) -> None:
    """Note, once, elements that xacro should have replaced."""
    for element in root.iterchildren('{*}*'):
        name = etree.QName(element)
        if 'xacro' in (name.namespace or ''):
            rule = 'must be expanded first: xacro FILE.xacro > FILE.urdf'
            findings.add('robot', f'xacro {rule}, got <xacro:{name.localname}>')
            return


def _check_names(root: Element, tag: str, findings: Findings) -> set[str]:
    names: set[str] = set()
    for element in root.findall(tag):
        name = Reader(element, tag, findings).text('name')
        if name in names:
            findings.add(f'{tag} {name!r}', 'name must be unique, got it twice')
        names.add(name)
    return names


def _read_links(
    root: Element, findings: Findings, warnings: list[str]
) -> dict[str, RigidInertia | None]:
    """Return the inertias of links that have a name and sound numbers."""
    sound = {}
    for element in root.findall('link'):
        before = len(findings.items)
        whose = f'link {element.get("name", "")!r}'
        inertials = element.findall('inertial')
        if len(inertials) > 1:
            findings.add(whose, f'<inertial> must occur once, got {len(inertials)}')
        read = [_read_inertial(inertial, whose, findings, warnings) for inertial in inertials]
        if len(findings.items) == before and element.get('name'):
            sound[element.get('name')] = read[0] if read else None
    return sound


def _read_inertial(
    inertial: Element, whose: str, findings: Findings, warnings: list[str]
) -> RigidInertia:
    """Return an inertia about the link frame's origin."""
    for tag in ('mass', 'inertia'):
        if inertial.find(tag) is None:
            findings.add(whose, f'<inertial> must have <{tag}>, got none')
    mass, matrix = math.nan, np.full((3, 3), math.nan)
    if inertial.find('mass') is not None:
        reader = Reader(inertial.find('mass'), whose, findings, ' of <mass>')
        mass = reader.number('value', 'kg', least=0.0)
    pose = _read_origin(inertial, whose, findings, ' of <inertial>')
    if inertial.find('inertia') is not None:
        reader = Reader(inertial.find('inertia'), whose, findings, ' of <inertia>')
        moments = [reader.number(name, 'kg m^2') for name in ('ixx', 'iyy', 'izz')]
        products = [reader.number(name, 'kg m^2', default=0.0) for name in ('ixy', 'ixz', 'iyz')]
        matrix = np.diag(moments)
        matrix[[0, 0, 1], [1, 2, 2]] = matrix[[1, 2, 2], [0, 0, 1]] = products
        warnings += [f'{whose}: {warning}' for warning in _doubts(matrix)]
    return moved(from_centre(mass, np.zeros(3), matrix), pose)


def _read_origin(element: Element, whose: str, findings: Findings, label: str) -> Array:
    origin = element.find('origin')
    return np.eye(4) if origin is None else Reader(origin, whose, findings, label).pose()


def _doubts(matrix: Array) -> list[str]:
    """Return a warning for an inertia that no body has."""
    if not np.isfinite(matrix).all():
        return []  # a finding already
    principal = np.linalg.eigvalsh(matrix)
    if principal[0] >= -max(ROUNDED * principal[2], ROUNDED_ZERO):
        return []
    shown = ', '.join(f'{value:.4g}' for value in principal)
    return [f'principal moments of <inertia> should be >= 0 kg m^2, got {shown}']


def _read_joint(
    element: Element, links: set[str], movable: Container[str], findings: Findings
) -> RigidUrdfJoint | None:
    """Return a joint, None when it has findings."""
    before = len(findings.items)
    name, kind = element.get('name', ''), element.get('type')
    whose = f'joint {name!r}'
    reader = Reader(element, whose, findings)
    if kind == 'planar':
        rule = f'be one of {", ".join(KINDS)} (planar joints are not supported yet)'
        reader.fail('type', rule, kind)
    else:
        reader.choice('type', list(KINDS))
    ends = {}
    for end in ('parent', 'child'):
        found = element.find(end)
        link = None if found is None else found.get('link')
        if link is None or link not in links:
            findings.add(whose, f'{end} must be a link of the robot, got {link!r}')
        ends[end] = str(link)
    origin = _read_origin(element, whose, findings, ' of <origin>')
    axis = np.array([1.0, 0.0, 0.0])
    if element.find('axis') is not None and kind not in WITHOUT_AXIS:
        axis = Reader(element.find('axis'), whose, findings, ' of <axis>').axis('xyz', '1 0 0')
    limits = _read_limits(element, whose, findings)
    damping, friction = _read_dynamics(element, whose, findings)
    mimic = _read_mimic(element, movable, whose, findings)
    if len(findings.items) > before:
        return None
    return RigidUrdfJoint(
        name,
        KINDS[kind],
        axis,
        limits,
        damping,
        friction,
        mimic=mimic,
        continuous=kind == 'continuous',
        parent=ends['parent'],
        child=ends['child'],
        origin=origin,
    )


def _read_limits(element: Element, whose: str, findings: Findings) -> Limits:
    limit, kind = element.find('limit'), element.get('type')
    if limit is None or kind == 'fixed':
        return Limits()
    reader = Reader(limit, whose, findings, ' of <limit>')
    least = {'effort': 0.0, 'velocity': 0.0, 'lower': None, 'upper': None}
    given = {
        name: reader.number(name, least=bound)
        for name, bound in least.items()
        if limit.get(name) is not None
    }
    lower, upper = given.get('lower', -math.inf), given.get('upper', math.inf)
    if lower > upper:
        reader.fail('lower', f'be at most upper ({upper:g})', lower)
    unused = ('lower', 'upper') if kind == 'continuous' else given if kind == 'floating' else ()
    return Limits(**{name: value for name, value in given.items() if name not in unused})


def _read_dynamics(element: Element, whose: str, findings: Findings) -> tuple[float, float]:
    """Return damping and friction."""
    dynamics = element.find('dynamics')
    if dynamics is None or element.get('type') == 'fixed':
        return 0.0, 0.0
    reader = Reader(dynamics, whose, findings, ' of <dynamics>')
    damping = reader.number('damping', least=0.0, default=0.0)
    return damping, reader.number('friction', least=0.0, default=0.0)


def _read_mimic(
    element: Element, movable: Container[str], whose: str, findings: Findings
) -> Mimic | None:
    mimic = element.find('mimic')
    if mimic is None or element.get('type') in WITHOUT_AXIS:
        return None
    reader = Reader(mimic, whose, findings, ' of <mimic>')
    leader = reader.text('joint')
    if leader and leader not in movable:
        reader.fail('joint', 'be a movable joint of the robot', leader)
    multiplier = reader.number('multiplier', default=1.0)
    return Mimic(leader, multiplier, reader.number('offset', default=0.0))


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
