"""Arrays of constraints between coordinates: loops in file order, then mimic joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.kernels.layout import constraint_layout, layout
from denoc_ros.model.tree import Body, Loop, Tree
from denoc_ros.types import Array

Int = NDArray[np.int64]

NONE = np.zeros((0, 3))
ALL = np.eye(3)


@dataclass(frozen=True)
class ConstraintRows:
    """Constraints for the kernels; see :mod:`denoc_ros.kernels.layout.constraint_layout`."""

    topology: list[Int]  # (TOPOLOGY_COLUMNS,) each
    constants: list[Array]
    rows: int  # of multipliers
    axis_rows: int  # of free axes with damping or friction
    names: tuple[str, ...]  # per multiplier, of its loop or mimic joint


def across(axis: Array) -> Array:
    """Return two unit vectors (2, 3) perpendicular to an axis.

    They are the two coordinate axes farthest from it, in order, made perpendicular to it and to
    each other: (x, y) for z, (x, z) for y, (y, z) for x.
    """
    first, second = np.sort(np.argsort(np.abs(axis), kind='stable')[:2])
    one = ALL[first] - axis * axis[first]
    one /= np.linalg.norm(one)
    two = ALL[second] - axis * axis[second]
    two -= one * (one @ two)
    return np.array([one, two / np.linalg.norm(two)])


def directions(loop: Loop) -> tuple[int, Array, Array, Array]:
    """Return the kind of a loop's angular rows, and its linear, angular and reference directions.

    Linear and angular rows are components along these in the parent's loop frame; references are
    the directions that must be the same on both sides.
    """
    if loop.type == 'spherical':
        return constraint_layout.POINT, ALL, NONE, NONE
    if loop.type == 'fixed':
        return constraint_layout.ORIENTED, ALL, ALL, ALL
    assert loop.axis is not None
    if loop.type == 'prismatic':
        return constraint_layout.ORIENTED, across(loop.axis), ALL, ALL
    if loop.type == 'revolute':
        return constraint_layout.ALIGNED, ALL, across(loop.axis), loop.axis[None]
    # the row of a universal joint is about axis x axis2, which turns: it has no fixed direction
    return constraint_layout.UNIVERSAL, ALL, np.zeros((1, 3)), NONE


def _meeting(topology: Sequence[Int], one: int, other: int) -> int:
    """Last common carrier of two rows: a body, or the base."""
    carriers = {0}
    while one > 0:
        carriers.add(one)
        one = int(topology[one][layout.PARENT])
    while other not in carriers:
        other = int(topology[other][layout.PARENT])
    return other


class _Ties:
    """One pass over loops and mimic joints."""

    def __init__(self, topology: Sequence[Int], start: int) -> None:
        self.topology = topology
        self.start = start  # of the next constants in constants
        self.made: list[Int] = []
        self.constants: list[Array] = []
        self.names: list[str] = []

    def _append(self, kind: int, child: int, other: int, constants: Array) -> Int:
        row = np.zeros(layout.TOPOLOGY_COLUMNS, dtype=np.int64)
        row[constraint_layout.KIND], row[constraint_layout.CHILD], row[constraint_layout.OTHER] = (
            kind,
            child,
            other,
        )
        row[constraint_layout.ROW] = len(self.names)
        row[constraint_layout.CONSTANTS] = self.start
        self.start += len(constants)
        self.constants.append(constants)
        self.made.append(row)
        return row

    def loop(self, loop: Loop, frame_rows: Mapping[str, int]) -> None:
        """Add a loop."""
        kind, linear, angular, references = directions(loop)
        header = np.array([loop.damping, loop.friction, float(loop.type == 'prismatic')])
        vectors = np.concatenate([linear, angular, references]).ravel()
        axes = [np.zeros(3) if each is None else each for each in (loop.axis, loop.axis2)]
        constants = np.concatenate([*axes, header, vectors])
        child, parent = frame_rows[loop.child.frame], frame_rows[loop.parent.frame]
        row = self._append(kind, child, parent, constants)
        row[constraint_layout.LINEAR] = len(linear)
        row[constraint_layout.ANGULAR] = len(angular)
        row[constraint_layout.REFERENCES] = len(references)
        carriers = [int(self.topology[k][layout.PARENT]) for k in (child, parent)]
        row[constraint_layout.COMMON_ANCESTOR] = _meeting(self.topology, *carriers)
        self.names += [loop.name] * (len(linear) + len(angular))

    def mimic(self, body: Body, child: int, leader: int) -> None:
        """Add a mimic joint: rows of topology of its body and of its leader's."""
        assert body.joint is not None
        assert body.joint.mimic is not None
        constants = np.array([body.joint.mimic.multiplier, body.joint.mimic.offset])
        row = self._append(constraint_layout.MIMIC, child, leader, constants)
        row[constraint_layout.COMMON_ANCESTOR] = _meeting(self.topology, child, leader)
        self.names.append(body.joint.name)


def constraints_to_arrays(
    tree: Tree,
    topology: Sequence[Int],
    joint_rows: Mapping[str, int],
    frame_rows: Mapping[str, int],
    start: int,
) -> ConstraintRows:
    """Write a tree's loops and mimic joints to arrays.

    Parameters
    ----------
    start : int
        Where their constants start in constants.
    """
    constraints = _Ties(topology, start)
    for loop in tree.loops:
        constraints.loop(loop, frame_rows)
    for body in tree.bodies:
        if body.joint is not None and body.joint.mimic is not None:
            own, leader = body.joint.name, body.joint.mimic.leader
            constraints.mimic(body, joint_rows[own], joint_rows[leader])
    rows = axis = len(constraints.names)
    for loop, row in zip(tree.loops, constraints.made, strict=False):
        if loop.damping > 0.0 or loop.friction > 0.0:
            row[constraint_layout.AXIS_ROW] = axis
            axis += 1
    return ConstraintRows(
        constraints.made, constraints.constants, rows, axis - rows, tuple(constraints.names)
    )
