"""A robot with its floating base held, for a base with a known motion."""

from __future__ import annotations

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.model.overrides import with_held_base


def held_robot(robot: Robot) -> Robot:
    """Return the same robot, overrides and payloads included, on a base that is held.

    Itself, if no base floats. The base's motion is then that of its verbs' `base`.
    """
    if not len(robot.base_indices):
        return robot
    text = with_held_base(robot.tree.source)
    held = load_robot(text, robot.gravity, robot.geometric_stiffness)
    if robot.tree.overrides:
        held = held.with_overrides(dict(robot.tree.overrides))
    held._take_payloads(robot)
    return held
