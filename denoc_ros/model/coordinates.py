"""Data per coordinate: names, elasticity, damping, friction, armature."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from denoc_ros.model.floating import PARTS, coordinate_names
from denoc_ros.model.tree import Body, JointKind, Tree
from denoc_ros.types import Array

# rows of the diagonals, in the kernels' order
TERMS = ('stiffness', 'damping', 'friction', 'armature', 'stiffness3', 'play')


def spring_name(joint: str) -> str:
    """Return the name of the coordinate that an elastic joint has beside its own."""
    return f'{joint}/spring'


def diagonals(tree: Tree) -> Array:
    """Return the terms (6, n) of all coordinates, in the order of `TERMS`."""
    columns = [np.zeros((0, len(TERMS)))]
    for body in tree.bodies:
        if body.floating:
            columns.append(np.zeros((len(PARTS), len(TERMS))))
        columns += [np.array(list(_joint_terms(body))).reshape(-1, len(TERMS))]
        if body.modes is not None:
            terms = np.zeros((body.modes.count, len(TERMS)))
            terms[:, 0], terms[:, 1] = body.modes.stiffness, body.modes.damping
            columns.append(terms)
        if body.beam is None:
            continue
        for part in (body.beam.y, body.beam.z, body.beam.torsion):
            if part is not None:
                terms = np.zeros((part.modes, len(TERMS)))
                terms[:, 0], terms[:, 1] = part.modal_stiffness, part.damping
                columns.append(terms)
    return np.ascontiguousarray(np.concatenate(columns).T)


def _joint_terms(body: Body) -> Iterator[tuple[float, ...]]:
    joint = body.joint
    if joint is None or joint.kind is JointKind.FIXED:
        return
    yield 0.0, joint.damping, joint.friction, joint.armature, 0.0, 0.0
    spring = joint.spring
    if spring is not None:
        half = 0.5 * spring.backlash
        yield spring.stiffness, spring.damping, 0.0, 0.0, spring.stiffness3, half


def names(tree: Tree) -> tuple[list[str], list[str], list[int]]:
    """Return coordinate names, joint names and the joints' indices."""
    coordinates: list[str] = []
    joints: list[str] = []
    indices: list[int] = []
    for body in tree.bodies:
        if body.floating:
            coordinates += coordinate_names(body.floating)
        joint = body.joint
        if joint is not None and joint.kind is not JointKind.FIXED:
            indices.append(len(coordinates))
            joints.append(joint.name)
            coordinates.append(joint.name)
            if joint.spring is not None:
                coordinates.append(spring_name(joint.name))
        if body.modes is not None:
            coordinates += [f'{body.name}/m{k + 1}' for k in range(body.modes.count)]
        if body.beam is not None:
            for letter, modes in zip('yzt', body.beam.modes, strict=True):
                coordinates += [f'{body.name}/{letter}{k + 1}' for k in range(modes)]
    return coordinates, joints, indices
