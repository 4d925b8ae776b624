"""Constraints of joints: mimic joints follow their leaders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.errors import StateError
from denoc_ros.model.tree import Mimic
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot


def mimic_ties(
    robot: Robot, joints: Sequence[str] | None, held: Mapping[str, float]
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return T (all joints, driven) and c (all joints,) of q_all = T q + c, and the driven names.

    Raises
    ------
    StateError
        A driven joint is unknown, repeated or a mimic; a mimic's leader is unknown.
    """
    free, mimics = list(robot.tree.non_mimic_joints), robot.tree.mimics
    driven = tuple(joints) if joints is not None else tuple(free)
    if len(set(driven)) != len(driven) or not set(driven) <= set(free):
        raise StateError(f'driven joints must be different ones of {free}, got {list(driven)}')
    constraints = np.zeros((len(robot.joint_names), len(driven)))
    offsets = np.zeros(len(robot.joint_names))
    for row, name in enumerate(robot.joint_names):
        mimic = mimics.get(name, Mimic(name, 1.0, 0.0))
        if mimic.leader in driven:
            constraints[row, driven.index(mimic.leader)] = mimic.multiplier
            offsets[row] = mimic.offset
        else:
            offsets[row] = mimic.multiplier * held.get(mimic.leader, 0.0) + mimic.offset
    return constraints, offsets, driven
