"""The robot without springs that the links of a robot with elastic joints are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from denoc_ros.model.coordinates import names, spring_name
from denoc_ros.model.tree import Body, Joint, Tree


def has_springs(tree: Tree) -> bool:
    """Say whether a joint of a robot is elastic."""
    return any(joint.spring is not None for joint in tree.joints.values())


def without_springs(tree: Tree) -> Tree:
    """Return the bodies of a robot on joints that go with the link side of its own.

    What belongs to the motor side (armature, friction and damping of elastic joints), and what
    takes no part in the motion of an open tree, is left out.
    """
    bodies = tuple(_rigid(body) for body in tree.bodies)
    return replace(tree, bodies=bodies, frames={}, loops=(), sensors=(), warnings=())


def _rigid(body: Body) -> Body:
    if body.joint is None:
        return body
    return replace(body, joint=replace(_behind_spring(body.joint), mimic=None))


def _behind_spring(joint: Joint) -> Joint:
    """Return the joint that the link side of an elastic joint sees."""
    if joint.spring is None:
        return joint
    return replace(joint, spring=None, damping=0.0, friction=0.0, armature=0.0)


def looped_joints(tree: Tree) -> set[str]:
    """Return the joints that loops close over: those on the way between their two sides."""
    found: set[str] = set()
    for loop in tree.loops:
        ways = []
        for frame in (loop.parent.frame, loop.child.frame):
            way, place = set(), tree.frames[frame].body
            while place >= 0:
                joint = tree.bodies[place].joint
                way |= set() if joint is None else {joint.name}
                place = tree.bodies[place].attachment.body
            ways.append(way)
        found |= ways[0] ^ ways[1]
    return found


def is_measured_behind(joint: Joint) -> bool:
    """Say whether the states of a joint mean the link side of its spring."""
    return joint.spring is not None and joint.spring.measured == 'link'


def motors_behind(tree: Tree) -> tuple[str, ...]:
    """Return the joints whose states mean the link side of their springs."""
    return tuple(n for n, joint in tree.joints.items() if is_measured_behind(joint))


def seen_from_links(tree: Tree) -> Tree:
    """Return a robot without the springs behind which its joints are measured; itself if none."""
    if not motors_behind(tree):
        return tree
    bodies = tuple(
        replace(body, joint=_behind_spring(body.joint))
        if body.joint is not None and is_measured_behind(body.joint)
        else body
        for body in tree.bodies
    )
    return replace(tree, bodies=bodies)


def link_map(tree: Tree) -> NDArray[np.uint32]:
    """Return (2, m): which coordinate stands for each of the m of the robot without springs.

    Of an elastic joint it is that of its spring, the motor's stands before it, and the second row
    is 1.
    """
    where = {name: k for k, name in enumerate(names(tree)[0])}
    places = []
    for name in names(without_springs(tree))[0]:
        elastic = spring_name(name) in where
        places.append((where[spring_name(name) if elastic else name], int(elastic)))
    return np.ascontiguousarray(np.array(places, dtype=np.uint32).reshape(-1, 2).T)
