"""Load a robot: URDF + `<flexibility>` to the immutable tree."""

from __future__ import annotations

import os

import numpy as np

from denoc_ros.errors import ModelError
from denoc_ros.model.assembly import Assembly, assemble
from denoc_ros.model.beams import FlexibleLink, flexible_link
from denoc_ros.model.findings import Element, Findings
from denoc_ros.model.flexibility import Flexibility, read_flexibility
from denoc_ros.model.inertia import inverse_transform
from denoc_ros.model.inertial_sensors import InertialElement, make_inertial_sensor
from denoc_ros.model.loops import LoopElement
from denoc_ros.model.rigid_urdf import RigidUrdf, read_rigid_urdf
from denoc_ros.model.sensors import SensorElement, make_sensor
from denoc_ros.model.source import parse_xml, read_source
from denoc_ros.model.springs import check_springs
from denoc_ros.model.tree import InertialSensor, Loop, LoopFrame, Sensor, Tree


def load_tree(source: str | os.PathLike[str]) -> Tree:
    """Return the robot that a URDF with an optional `<flexibility>` block describes.

    Parameters
    ----------
    source : str or path
        A file's path, or the XML text (as on /robot_description), which starts with `<`.

    Returns
    -------
    Tree
        Bodies depth first, children in the order of their joints in the file. What is doubtful
        but harmless stands in its `warnings`.

    Raises
    ------
    ModelError
        With every finding of the file.
    """
    where, text = read_source(source)
    return tree_of(parse_xml(where, text), where, text)


def tree_of(root: Element, where: str, text: str) -> Tree:
    """Return the robot of a parsed description.

    Parameters
    ----------
    root : lxml element
        `<robot>`.
    where : str
        Its name in errors.
    text : str
        The description, kept in the tree as its source.

    Returns
    -------
    Tree
        As `load_tree`.

    Raises
    ------
    ModelError
        With every finding.
    """
    findings, warnings = Findings(), list[str]()
    robot = read_rigid_urdf(root, findings, warnings)
    flexibility = read_flexibility(root, findings)
    flexible = _flexible_links(robot, flexibility, findings, warnings)
    _check_segment_names(robot, flexible, findings)
    sensors = _sensor_elements(flexibility, findings, warnings)
    _check_loop_frames(robot, flexibility, findings)
    springs, armatures = flexibility.springs, flexibility.armatures
    check_springs(robot, springs, armatures, flexibility.loops, findings, warnings)
    ModelError.raise_any(where, findings.items)
    assembly = assemble(robot, flexible, armatures, springs)
    loops = tuple(_loop(loop, assembly) for loop in flexibility.loops)
    return Tree(
        robot.name,
        tuple(assembly.bodies),
        assembly.frames,
        loops,
        tuple(_sensor(sensor, assembly) for sensor in sensors),
        tuple(warnings),
        text,
        inertial_sensors=tuple(
            _inertial_sensor(sensor, flexibility, assembly)
            for sensor in flexibility.inertial_sensors
        ),
    )


def _flexible_links(
    robot: RigidUrdf, flexibility: Flexibility, findings: Findings, warnings: list[str]
) -> dict[str, FlexibleLink]:
    found: dict[str, FlexibleLink] = {}
    carrying = _carrying(robot, flexibility)
    for link, element in flexibility.beams.items():
        if link in robot.links:  # else the link itself has findings
            carries = link in carrying
            made = flexible_link(element, robot.links[link], findings, warnings, carries)
            if made is not None:
                found[link] = made
    return found


def _carrying(robot: RigidUrdf, flexibility: Flexibility) -> set[str]:
    """Return the links with a beam on which a mass or a loop hangs beyond the root."""
    over = {joint.child: joint.parent for joint in robot.joints}
    loaded: set[str] = set()
    for link, body in robot.links.items():
        up = link if body is not None and body.mass > 0.0 else None
        while up is not None and up not in loaded:
            loaded.add(up)
            up = over.get(up)
    ends = [(loop.parent, loop.parent_origin) for loop in flexibility.loops]
    ends += [(loop.child, loop.child_origin) for loop in flexibility.loops]
    ends += [(joint.parent, joint.origin) for joint in robot.joints if joint.child in loaded]
    return {
        link
        for link, origin in ends
        if link in flexibility.beams
        and (inverse_transform(flexibility.beams[link].origin) @ origin)[0, 3] > 0.0
    }


def _check_segment_names(
    robot: RigidUrdf, flexible: dict[str, FlexibleLink], findings: Findings
) -> None:
    for link, made in flexible.items():
        for segment in range(2, made.beam.segments + 1):
            if f'{link}/{segment}' in robot.links:
                rule = f'names of its segments, {link}/2 and on, must be no links'
                findings.add(f'beam {link!r}', f"{rule}, got '{link}/{segment}'")


def _sensor_elements(
    flexibility: Flexibility, findings: Findings, warnings: list[str]
) -> list[SensorElement]:
    for sensor in flexibility.sensors:
        beam = flexibility.beams.get(sensor.link)
        if beam is None:
            continue
        whose = f'sensor {sensor.name!r}'
        deformation = beam.y if sensor.direction == 'y' else beam.z
        if deformation is None or deformation.modes == 0:
            rule = f'direction must be one in which beam {sensor.link!r} bends'
            findings.add(whose, f'{rule}, got {sensor.direction!r}')
        if sensor.station > beam.length:
            rule = f'station must be at most the length {beam.length:g} m of beam {sensor.link!r}'
            warnings.append(f'{whose}: {rule}, got {sensor.station:g}, taken as the tip')
    for inertial in flexibility.inertial_sensors:
        beam = flexibility.beams.get(inertial.link)
        if beam is not None and inertial.station is not None and inertial.station > beam.length:
            rule = f'station must be at most the length {beam.length:g} m of beam {beam.link!r}'
            got = f'{inertial.station:g}, taken as the tip'
            warnings.append(f'sensor {inertial.name!r}: {rule}, got {got}')
    return flexibility.sensors


def _inertial_sensor(
    sensor: InertialElement, flexibility: Flexibility, assembly: Assembly
) -> InertialSensor:
    section = np.eye(4)
    if sensor.station is not None:
        beam = flexibility.beams[sensor.link]
        section[0, 3] = min(sensor.station, beam.length)
        section = beam.origin @ section
    return make_inertial_sensor(sensor, section, assembly.attach)


def _frame_names(loop: LoopElement) -> tuple[str, str]:
    return f'{loop.name}/parent', f'{loop.name}/child'


def _check_loop_frames(robot: RigidUrdf, flexibility: Flexibility, findings: Findings) -> None:
    for loop in flexibility.loops:
        for name in _frame_names(loop):
            if name in robot.links:
                rule = 'frame names <name>/parent and <name>/child must be no links'
                findings.add(f'loop {loop.name!r}', f'{rule}, got {name!r}')


def _loop(loop: LoopElement, assembly: Assembly) -> Loop:
    parent, child = _frame_names(loop)
    assembly.frames[parent] = assembly.attach(loop.parent, loop.parent_origin)
    assembly.frames[child] = assembly.attach(loop.child, loop.child_origin)
    return Loop(
        loop.name,
        loop.type,
        LoopFrame(loop.parent, parent),
        LoopFrame(loop.child, child),
        loop.axis,
        loop.axis2,
        loop.damping,
        loop.friction,
    )


def _sensor(sensor: SensorElement, assembly: Assembly) -> Sensor:
    index = assembly.frames[sensor.link].body
    return make_sensor(sensor, index, assembly.flexible[sensor.link].beams)
