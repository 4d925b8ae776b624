"""Load a robot: URDF + `<flexibility>` to the immutable tree."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from denoc_ros.errors import ModelError
from denoc_ros.model.beams.beams import flexible_link
from denoc_ros.model.beams.component_links import check_frame, component_link, find_frame
from denoc_ros.model.beams.segments import locate
from denoc_ros.model.inertia import inverse_transform, moved, total
from denoc_ros.model.payloads import with_payloads
from denoc_ros.model.reading.findings import Element, Findings
from denoc_ros.model.reading.flexibility import (
    Flexibility,
    LoopElement,
    check_springs,
    read_flexibility,
)
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.reading.rigid_urdf import RigidUrdf, RigidUrdfJoint, read_rigid_urdf
from denoc_ros.model.reading.source import TEXT_NAME, parse_xml, read_source, with_absolute_files
from denoc_ros.model.sensors import make_sensor, make_strain_sensor
from denoc_ros.model.tree import (
    Attachment,
    Body,
    FlexibleLink,
    InertialElement,
    InertialSensor,
    Joint,
    JointKind,
    Loop,
    LoopFrame,
    RigidInertia,
    Sensor,
    SensorElement,
    Spring,
    Tree,
)
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
    folder : str, optional
        Of its file, which files that it names are relative to; None: that of `where`, if `where`
        is a file, else it is a text.
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
    tree = Tree(
        robot.name,
        tuple(assembly.bodies),
        assembly.frames,
        loops,
        tuple(_sensor(sensor, assembly) for sensor in sensors),
        tuple(warnings),
        with_absolute_files(text, Path(folder)) if folder else text,
        inertial_sensors=tuple(
            _inertial_sensor(sensor, flexibility, assembly)
            for sensor in flexibility.inertial_sensors
        ),
        folder=folder,
        payloads=flexibility.payloads,
    )
    return with_payloads(tree) if tree.payloads else tree


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
    """Note children of a link with component modes that hang on none of its frames."""
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
        return InertialSensor(**vars(sensor), mount=at)
    if sensor.station is not None:
        beam = flexibility.beams[sensor.link]
        section = beam.origin @ pose_of((min(sensor.station, beam.length), 0.0, 0.0))
    at = assembly.attach(sensor.link, section)
    mount = replace(at, placement=at.placement @ sensor.origin)
    return InertialSensor(**vars(sensor), mount=mount)


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


# from links and joints to bodies ----------------------------------------------------------------

BASE = -1


@dataclass
class Assembly:
    """Bodies in coordinate order and the frames that hang on them."""

    flexible: Mapping[str, FlexibleLink]  # by link
    bodies: list[Body] = field(default_factory=list)
    frames: dict[str, Attachment] = field(default_factory=dict)  # by link

    def attach(self, link: str, origin: Array, names: Collection[str] = ()) -> Attachment:
        """Return where a frame hangs that is given in a link's frame.

        Parameters
        ----------
        origin : ndarray (4, 4)
            The frame seen from the link frame.
        names : collection of str
            The names that it may have among the frames of a link with component modes.

        Returns
        -------
        Attachment
            On a beam at the station of its origin, on component modes at its frame; rigidly on
            the body else.
        """
        at = self.frames[link]
        placement = at.placement @ origin
        if link not in self.flexible:
            return Attachment(at.body, at.station, placement, at.section)
        beam, modes = self.flexible[link].beam, self.flexible[link].modes
        if modes is not None:
            name = find_frame(modes.link, origin, names)
            assert name is not None, names
            if name:
                placement = placement.copy()
                placement[:3, 3] -= modes.link.frames[name].origin
            return Attachment(at.body, 0.0, placement, name)
        assert beam is not None
        segment, station = locate(beam.whole_length, beam.segments, float(placement[0, 3]))
        if segment == 0 and station == 0.0:
            return Attachment(at.body, 0.0, placement)
        from_section = placement.copy()
        from_section[0, 3] -= segment * beam.length + station
        return Attachment(at.body + segment, station, from_section)

    def add_body(
        self,
        link: str,
        at: Attachment,
        joint: Joint | None,
        inertia: RigidInertia,
        floating: str = '',
    ) -> None:
        """Add a link as a body of its own, or as one per segment.

        On a floating joint if that is named.
        """
        flexible = self.flexible.get(link)
        frame, beam, modes = np.eye(4), None, None
        if flexible is not None:
            frame, beam, inertia = flexible.origin, flexible.beam, flexible.rest
            modes = flexible.modes
        self.frames[link] = Attachment(len(self.bodies), 0.0, inverse_transform(frame))
        body = Body(link, at, joint, frame, inertia, beam, floating, modes=modes)
        self.bodies.append(body)
        for segment in range(2, 1 if beam is None else beam.segments + 1):
            assert flexible is not None
            beam = flexible.beams[segment - 1]
            tip = Attachment(len(self.bodies) - 1, beam.length, np.eye(4))
            name, none = f'{link}/{segment}', RigidInertia()
            self.bodies.append(Body(name, tip, None, np.eye(4), none, beam, segment=segment))

    def merge(self, link: str, at: Attachment, inertia: RigidInertia) -> None:
        """Add a rigid link to the body that it is fixed to; on the base its mass is nothing."""
        self.frames[link] = at
        if at.body != BASE:
            body = self.bodies[at.body]
            merged = total(body.inertia, moved(inertia, at.placement))
            self.bodies[at.body] = replace(body, inertia=merged)


def assemble(
    robot: RigidUrdf,
    flexible: Mapping[str, FlexibleLink],
    armatures: Mapping[str, float],
    springs: Mapping[str, Spring],
) -> Assembly:
    """Return the bodies of a robot without findings.

    Returns
    -------
    Assembly
        Bodies depth first, children in the order of their joints in the file; those of a link of
        several segments from its tip inwards, so that the link's segments stand together.
    """
    children: dict[str, list[RigidUrdfJoint]] = {link: [] for link in robot.links}
    for joint in robot.joints:
        children[joint.parent].append(joint)
    ends = {joint.child for joint in robot.joints}
    root = next(link for link in robot.links if link not in ends)
    assembly = Assembly(flexible)
    _add_root(assembly, root, robot)
    stack = _inwards(assembly, root, children[root])[::-1]
    while stack:
        joint = stack.pop()
        armature, spring = armatures.get(joint.name, 0.0), springs.get(joint.name)
        moving = replace(joint, armature=armature, spring=spring)
        _add_link(assembly, joint, robot.links[joint.child], moving)
        stack.extend(_inwards(assembly, joint.child, children[joint.child])[::-1])
    return assembly


def _inwards(assembly: Assembly, link: str, joints: list[RigidUrdfJoint]) -> list[RigidUrdfJoint]:
    """Return a link's joints by the segment that they hang on, outermost first."""
    return sorted(joints, key=lambda joint: -_attach(assembly, joint).body)


def _attach(assembly: Assembly, joint: RigidUrdfJoint) -> Attachment:
    return assembly.attach(joint.parent, joint.origin, (joint.name, joint.child))


def _add_root(assembly: Assembly, root: str, robot: RigidUrdf) -> None:
    at = Attachment(BASE, 0.0, np.eye(4))
    if root in assembly.flexible:
        assembly.add_body(root, at, None, RigidInertia())
    else:
        assembly.merge(root, at, robot.links[root] or RigidInertia())


def _add_link(
    assembly: Assembly, joint: RigidUrdfJoint, inertia: RigidInertia | None, moving: Joint
) -> None:
    at = _attach(assembly, joint)
    inertia = RigidInertia() if inertia is None else inertia
    if joint.kind is JointKind.FLOATING:
        assembly.add_body(joint.child, at, None, inertia, joint.name)
    elif joint.kind is not JointKind.FIXED:
        assembly.add_body(joint.child, at, moving, inertia)
    elif joint.child in assembly.flexible or at.deforms:
        assembly.add_body(joint.child, at, None, inertia)
    else:
        assembly.merge(joint.child, at, inertia)
