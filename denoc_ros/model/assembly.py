"""Assemble a robot's links, joints and beams to the tree of bodies."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from denoc_ros.model.component_links import find_frame
from denoc_ros.model.inertia import inverse_transform, moved, total
from denoc_ros.model.rigid_urdf import RigidUrdf, RigidUrdfJoint
from denoc_ros.model.segments import locate
from denoc_ros.model.tree import (
    Attachment,
    Body,
    FlexibleLink,
    Joint,
    JointKind,
    RigidInertia,
    Spring,
)
from denoc_ros.types import Array

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
        link : str
            The link, already in the tree.
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

    Parameters
    ----------
    robot : RigidUrdf
        Links and joints, a tree.
    flexible : mapping of str to FlexibleLink
        The links with a beam.
    armatures : mapping of str to float
        By joint.
    springs : mapping of str to Spring
        By joint.

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
        moving = _moving(joint, armatures, springs)
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
    assembly: Assembly,
    joint: RigidUrdfJoint,
    inertia: RigidInertia | None,
    moving: Joint,
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


def _moving(
    joint: RigidUrdfJoint, armatures: Mapping[str, float], springs: Mapping[str, Spring]
) -> Joint:
    return Joint(
        joint.name,
        joint.kind,
        joint.axis,
        joint.limits,
        joint.damping,
        joint.friction,
        armatures.get(joint.name, 0.0),
        joint.mimic,
        joint.continuous,
        springs.get(joint.name),
    )
