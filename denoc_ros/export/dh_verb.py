"""`denoc dh`: a Denavit-Hartenberg table to URDF + `<flexibility>`."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from lxml import etree

from denoc_ros.cli.arguments import add_option, add_output
from denoc_ros.cli.session.session_config import find_file
from denoc_ros.export.dh_system import DHLink, DHPoint, DHSystem, load_system
from denoc_ros.model.reading.findings import Element
from denoc_ros.model.reading.poses import number_text, rpy_of
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.output_files import write_new
from denoc_ros.terminal_text import say
from denoc_ros.types import Array

DESCRIPTION = 'Write the robot of a Denavit-Hartenberg table as a URDF with flexible links.'


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(
        parser,
        'table',
        'YAML file with one system, or with several by name; one that is not here is '
        'looked for where the package is installed',
    )
    add_output(parser, '', 'the URDF to write, a new file', required=True)
    add_option(parser, '--system SYSTEM', 'name of the system, for a file with several')
    add_option(
        parser,
        '--kinds KINDS',
        'R (rigid) or F (flexible) for each link, such as FFR; default: as in the table',
    )


def run(args: argparse.Namespace) -> int:
    """Write the URDF of a table."""
    system = load_system(
        find_file(Path(args.table), Path()) or args.table, args.system, args.kinds
    )
    text = urdf_text(system)
    tree = load_tree(text)
    write_new(args.output, text)
    flexible = sum(body.beam is not None and body.segment == 1 for body in tree.bodies)
    say(f'{args.output}: {len(system.links)} links, {flexible} flexible')
    return 0


VISUAL_WIDTH = 0.04  # of the longest link


def urdf_text(system: DHSystem) -> str:
    """Return a system's URDF.

    Returns
    -------
    str
        Links `base`, `link_1` ... and `tool`, joints `joint_1` ... about or along Z, unless the
        table gives names. A link's frame is the frame of its joint, turned with it: X along the
        rod or beam. `tool` stands fixed at the end of a serial robot, or where the table says.
        Planar systems bend along y, others along y and z.
    """
    root = etree.Element('robot', name=system.name)
    root.append(etree.Comment(_head(system)))
    width = VISUAL_WIDTH * max(link.rod_length for link in system.links)
    etree.SubElement(root, 'link', name='base')
    for link in system.links:
        element = etree.SubElement(root, 'link', name=link.name)
        _add_inertial(element, link)
        _add_visuals(element, link, width)
    if system.tool is not None:
        etree.SubElement(root, 'link', name='tool')
    for chain in system.chains:
        parent, shift, turn = 'base', np.array(chain.base), np.eye(3)
        for link in chain.links:
            _add_joint(root, system, link, parent, shift, turn @ _rotation_z(link.theta))
            parent, (shift, turn) = link.name, _end(link)
    if system.tool is not None:
        joint = etree.SubElement(root, 'joint', name='tool_joint', type='fixed')
        _add_ends(joint, system.tool.link, 'tool', *_placement(system, system.tool))
    bends = any(_bends(system, link) for link in system.links)
    if system.loops or bends or any(system.armature):
        _add_flexibility(root, system)
    etree.indent(root, '  ')
    return f'<?xml version="1.0"?>\n{etree.tostring(root, encoding="unicode")}\n'


def rod_inertia(link: DHLink) -> tuple[Array, Array]:
    """Return centre of mass and inertia of a link's rods and hub.

    Parameters
    ----------
    link : DHLink
        A rod from the origin to (0, 0, b), then to (a, 0, b), of one mass per length; a point
        mass at the origin if it has no length. The hub has inertia about Z, and no mass. Or a
        thin plate in X-Y.

    Returns
    -------
    com : ndarray (3,)
        Centre of mass in the link frame [m].
    inertia : ndarray (3, 3)
        About the centre of mass [kg m^2].
    """
    if link.plate is not None:
        return np.array(link.plate), link.hub_inertia * np.diag([0.5, 0.5, 1.0])
    inertia = np.diag([0.0, 0.0, link.hub_inertia])
    if link.rod_length == 0.0 or link.mass == 0.0:
        return np.zeros(3), inertia
    rods = (
        (np.array([0.0, 0.0, link.b]), np.array([0.0, 0.0, 0.5 * link.b])),
        (np.array([link.a, 0.0, 0.0]), np.array([0.5 * link.a, 0.0, link.b])),
    )
    masses = [link.mass * float(np.abs(rod).sum()) / link.rod_length for rod, _ in rods]
    com = sum((m * centre for m, (_, centre) in zip(masses, rods, strict=True)), np.zeros(3))
    com = com / link.mass
    for mass, (rod, centre) in zip(masses, rods, strict=True):
        arm = centre - com
        second = np.outer(rod, rod) / 12.0 + np.outer(arm, arm)
        inertia = inertia + mass * (np.trace(second) * np.eye(3) - second)
    return com, inertia


def _head(system: DHSystem) -> str:
    kinds = ''.join('F' if _bends(system, link) else 'R' for link in system.links)
    plane = ' Planar: it moves in X-Y, Y is up.' if system.planar else ''
    return f' Made by "denoc dh" from the table {system.name!r}, links {kinds}.{plane} '


def _bends(system: DHSystem, link: DHLink) -> bool:
    return link.ei is not None and system.modes > 0


def _add_inertial(element: Element, link: DHLink) -> None:
    com, inertia = rod_inertia(link)
    inertial = etree.SubElement(element, 'inertial')
    etree.SubElement(inertial, 'origin', xyz=number_text(*com))
    etree.SubElement(inertial, 'mass', value=number_text(link.mass))
    names = {
        f'i{"xyz"[i]}{"xyz"[j]}': number_text(inertia[i, j]) for i in range(3) for j in range(i, 3)
    }
    etree.SubElement(inertial, 'inertia', names)


def _add_visuals(element: Element, link: DHLink, width: float) -> None:
    rods = (
        (link.b, (0.0, 0.0, 0.5 * link.b), (width, width, abs(link.b))),
        (link.a, (0.5 * link.a, 0.0, link.b), (abs(link.a), width, width)),
    )
    for length, centre, size in rods:
        if length:
            visual = etree.SubElement(element, 'visual')
            etree.SubElement(visual, 'origin', xyz=number_text(*centre))
            geometry = etree.SubElement(visual, 'geometry')
            etree.SubElement(geometry, 'box', size=number_text(*size))


def _end(link: DHLink) -> tuple[Array, Array]:
    return np.array([link.a, 0.0, link.b]), _rotation_x(link.alpha)


def _placement(system: DHSystem, point: DHPoint) -> tuple[Array, Array]:
    if point.at is not None:
        return np.array(point.at), np.eye(3)
    return _end(next(link for link in system.links if link.name == point.link))


def joint_name(link: DHLink) -> str:
    """Return the name of the joint before a link: joint_1 before link_1, else x_joint before x."""
    head, _, rest = link.name.partition('_')
    return f'joint_{rest}' if head == 'link' and rest else f'{link.name}_joint'


def _add_joint(
    root: Element, system: DHSystem, link: DHLink, parent: str, shift: Array, turn: Array
) -> None:
    kind = 'prismatic' if link.prismatic else 'revolute'
    joint = etree.SubElement(root, 'joint', name=joint_name(link), type=kind)
    _add_ends(joint, parent, link.name, shift, turn)
    etree.SubElement(joint, 'axis', xyz='0 0 1')
    limits = {key: number_text(value) for key, value in system.limits.items()}
    etree.SubElement(joint, 'limit', limits)


def _add_ends(joint: Element, parent: str, child: str, shift: Array, turn: Array) -> None:
    etree.SubElement(joint, 'parent', link=parent)
    etree.SubElement(joint, 'child', link=child)
    etree.SubElement(joint, 'origin', xyz=number_text(*shift), rpy=number_text(*rpy_of(turn)))


def _add_flexibility(root: Element, system: DHSystem) -> None:
    block = etree.SubElement(root, 'flexibility')
    for link in system.links:
        if not _bends(system, link):
            continue
        beam = etree.SubElement(block, 'beam', link=link.name, length=number_text(link.a))
        if link.b:  # else the beam is the whole link, which is the default
            beam.set('mass_per_length', number_text(link.mass / link.rod_length))
        beam.set('shape', system.shape)
        etree.SubElement(beam, 'origin', xyz=number_text(0.0, 0.0, link.b))
        for direction in ('y',) if system.planar else ('y', 'z'):
            assert link.ei is not None
            bending = etree.SubElement(
                beam, 'bending', direction=direction, ei=number_text(link.ei)
            )
            bending.set('modes', str(system.modes))
            bending.set('damping_ratio', number_text(*system.damping_ratio))
    for link, inertia in zip(
        system.links, system.armature or [0.0] * len(system.links), strict=True
    ):
        if inertia:
            rotor = {'joint': joint_name(link), 'armature': number_text(inertia)}
            etree.SubElement(block, 'actuator', rotor)
    for loop in system.loops:
        element = etree.SubElement(block, 'loop', name=loop.name, type=loop.type)
        for tag, point in (('parent', loop.parent), ('child', loop.child)):
            shift, turn = _placement(system, point)
            pose = {'xyz': number_text(*shift), 'rpy': number_text(*rpy_of(turn))}
            etree.SubElement(element, tag, link=point.link, **pose)
        if loop.type == 'revolute':
            etree.SubElement(element, 'axis', xyz='0 0 1')


def _rotation_x(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rotation_z(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
