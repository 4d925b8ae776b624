"""The bodies that each link of a plain robot carries, and the end of the link."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from denoc_ros.model.inertia import moved, total
from denoc_ros.model.reading.rigid_urdf import RigidUrdf, RigidUrdfJoint
from denoc_ros.model.tree import JointKind, RigidInertia
from denoc_ros.types import Array


@dataclass
class SubtreeInertia:
    """A link's place in its robot, all joints at zero."""

    joint: RigidUrdfJoint | None  # that moves it, perhaps by way of fixed links; None: the base
    axis: Array  # (3,) of that joint, in the link's frame; 0 without one
    own: RigidInertia  # about its frame
    carried: RigidInertia = field(default_factory=RigidInertia)  # all beyond it, in its frame
    moving: list[tuple[Array, Array]] = field(default_factory=list)  # (3,) place, axis of joints
    fixed: list[Array] = field(default_factory=list)  # (3,) places of links fixed to it


def link_loads(robot: RigidUrdf) -> dict[str, SubtreeInertia]:
    """Return each link's load, in file order.

    Returns
    -------
    dict of str to SubtreeInertia
        `moving` has the next movable joints, also those of links that are fixed to the link.
    """
    above = {joint.child: joint for joint in robot.joints}
    children: dict[str, list[RigidUrdfJoint]] = {link: [] for link in robot.links}
    for joint in robot.joints:
        children[joint.parent].append(joint)
    order = [link for link in robot.links if link not in above]
    for link in order:  # it grows as it is walked: parents before children
        order.extend(joint.child for joint in children[link])
    loads: dict[str, SubtreeInertia] = {}
    for link in order:
        mover, axis = _moved_by(above.get(link), loads)
        loads[link] = SubtreeInertia(mover, axis, robot.links[link] or RigidInertia())
    for link in reversed(order):
        for joint in children[link]:
            _add_child(loads[link], joint, loads[joint.child])
    return {link: loads[link] for link in robot.links}


def _moved_by(
    joint: RigidUrdfJoint | None, loads: dict[str, SubtreeInertia]
) -> tuple[RigidUrdfJoint | None, Array]:
    """Return the joint that moves the link behind a joint, and its axis in that link's frame."""
    if joint is None:
        return None, np.zeros(3)
    if joint.kind is not JointKind.FIXED:
        return joint, joint.axis
    carrier = loads[joint.parent]
    return carrier.joint, joint.origin[:3, :3].T @ carrier.axis


def _add_child(load: SubtreeInertia, joint: RigidUrdfJoint, child: SubtreeInertia) -> None:
    beyond = total(child.own, child.carried)
    load.carried = total(load.carried, moved(beyond, joint.origin))
    rotation, place = joint.origin[:3, :3], joint.origin[:3, 3]
    if joint.kind is not JointKind.FIXED:
        load.moving.append((place, rotation @ joint.axis))
        return
    load.fixed.append(place)
    load.moving += [(rotation @ point + place, rotation @ axis) for point, axis in child.moving]
