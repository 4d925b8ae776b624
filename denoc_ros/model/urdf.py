"""Load a robot: URDF + `<flexibility>` to the immutable tree."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from denoc_ros.errors import ModelError
from denoc_ros.model.assembly import Assembly, assemble
from denoc_ros.model.beams import flexible_link
from denoc_ros.model.component_links import check_frame, component_link
from denoc_ros.model.findings import Element, Findings
from denoc_ros.model.flexibility import Flexibility, read_flexibility
from denoc_ros.model.inertia import inverse_transform
from denoc_ros.model.inertial_sensors import InertialElement, make_inertial_sensor
from denoc_ros.model.loops import LoopElement
from denoc_ros.model.rigid_urdf import RigidUrdf, read_rigid_urdf
from denoc_ros.model.sensors import SensorElement, make_sensor, make_strain_sensor
from denoc_ros.model.source import TEXT_NAME, parse_xml, read_source
from denoc_ros.model.springs import check_springs
from denoc_ros.model.tree import FlexibleLink, InertialSensor, Loop, LoopFrame, Sensor, Tree
from denoc_ros.types import Array


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


def tree_of(root: Element, where: str, text: str, folder: str | None = None) -> Tree:
    """Return the robot of a parsed description.

    Parameters
    ----------
    root : lxml element
        `<robot>`.
    where : str
        Its name in errors.
    text : str
        The description, kept in the tree as its source.
    folder : str, optional
        Of its file, which files that it names are relative to; None: that of `where`, if `where`
        is a file, else it is a text.

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
    if folder is None:
        folder = str(Path(where).parent) if where != TEXT_NAME and Path(where).is_file() else ''
    flexibility = read_flexibility(root, findings, folder)
    flexible = _flexible_links(robot, flexibility, findings, warnings)
    _check_segment_names(robot, flexible, findings)
    sensors = _sensor_elements(flexibility, findings, warnings)
    _check_loop_frames(robot, flexibility, findings)
    _check_component_frames(robot, flexibility, findings, warnings)
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
        folder=folder,
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
    for link, component in flexibility.components.items():
        if link in robot.links:
            made = component_link(component, robot.links[link], findings, warnings)
            if made is not None:
                found[link] = made
    return found


def _check_component_frames(
    robot: RigidUrdf, flexibility: Flexibility, findings: Findings, warnings: list[str]
) -> None:
    """Note what hangs on a link with component modes, but on none of its frames."""
    hung: list[tuple[str, str, Array, tuple[str, ...]]] = [
        (f'joint {joint.name!r}', joint.parent, joint.origin, (joint.name, joint.child))
        for joint in robot.joints
    ]
    for loop in flexibility.loops:
        parent, child = _frame_names(loop)
        whose = f'loop {loop.name!r}'
        hung.append((whose, loop.parent, loop.parent_origin, (parent, loop.name)))
        hung.append((whose, loop.child, loop.child_origin, (child, loop.name)))
    for sensor in flexibility.inertial_sensors:
        hung.append((f'sensor {sensor.name!r}', sensor.link, sensor.origin, (sensor.name,)))
    for whose, link, origin, names in hung:
        if (element := flexibility.components.get(link)) is not None:
            check_frame(whose, element, origin, names, findings, warnings)


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
        for segment in range(2, 1 if made.beam is None else made.beam.segments + 1):
            if f'{link}/{segment}' in robot.links:
                rule = f'names of its segments, {link}/2 and on, must be no links'
                findings.add(f'beam {link!r}', f"{rule}, got '{link}/{segment}'")


def _sensor_elements(
    flexibility: Flexibility, findings: Findings, warnings: list[str]
) -> list[SensorElement]:
    for sensor in flexibility.sensors:
        component = flexibility.components.get(sensor.link)
        if component is not None and sensor.point not in component.modes.link.strain:
            known = ', '.join(component.modes.link.strain) or 'none'
            rule = f'point must be a strain point of flexible link {sensor.link!r} ({known})'
            findings.add(f'sensor {sensor.name!r}', f'{rule}, got {sensor.point!r}')
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
    if sensor.link in flexibility.components:
        at = assembly.attach(sensor.link, sensor.origin, (sensor.name,))
        return make_inertial_sensor(sensor, at)
    if sensor.station is not None:
        beam = flexibility.beams[sensor.link]
        section[0, 3] = min(sensor.station, beam.length)
        section = beam.origin @ section
    at = assembly.attach(sensor.link, section)
    return make_inertial_sensor(sensor, replace(at, placement=at.placement @ sensor.origin))


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
    assembly.frames[parent] = assembly.attach(loop.parent, loop.parent_origin, (parent, loop.name))
    assembly.frames[child] = assembly.attach(loop.child, loop.child_origin, (child, loop.name))
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
    flexible = assembly.flexible[sensor.link]
    if flexible.modes is not None:
        return make_strain_sensor(sensor, index, flexible.modes)
    return make_sensor(sensor, index, flexible.beams)
