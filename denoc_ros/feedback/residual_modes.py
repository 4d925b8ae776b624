"""Robots with modes that the model leaves out: for the design of feedback, and for its proof."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.arrays import is_flexible
from denoc_ros.model.beams.segments import deformations

MORE = 2  # modes per deformation
SEGMENTS = 8


def without_armature(robot: Robot, joints: Sequence[str]) -> list[str]:
    """Return those of some joints that have no rotor inertia, if there are beams.

    At high frequency such a joint moves the root of a beam alone, which has no inertia: any
    feedback of its rate is unstable with any delay, if the beam has modes enough.
    """
    if not _has_beams(robot):
        return []
    return [n for n, one in robot.tree.joints.items() if n in joints and not one.armature]


def is_hardened(robot: Robot, joints: Sequence[str]) -> bool:
    """Say whether feedback of some joints is designed for modes that nobody knows.

    Of robots with beams whose driven joints all have rotor inertia.
    """
    return _has_beams(robot) and not without_armature(robot, joints)


def _has_beams(robot: Robot) -> bool:
    return any(body.beam is not None and any(body.beam.modes) for body in robot.tree.bodies)


def with_residual_modes(robot: Robot, joints: Sequence[str]) -> Robot:
    """Return the robot of the design: with more modes of every beam; itself if there is none.

    Itself, too, if some of the joints that are driven have no rotor inertia: then no feedback is
    stable on such a robot. Each deformation has two modes more, damped as the last one;
    clamped-free shapes become Craig-Bampton ones, which turn rightly under moments.
    """
    if not is_hardened(robot, joints):
        return robot
    return _varied(robot, shape={'clamped-free': 'craig-bampton'}, more=MORE)


def other_robots(robot: Robot) -> dict[str, Robot]:
    """Return robots with other modes of the beams than the model or its design has, by name."""
    found = {
        f'{MORE} modes fewer per deformation': _varied(robot, more=-MORE),
        'clamped-free shapes': _varied(robot, shape={'craig-bampton': 'clamped-free'}, more=MORE),
        f'{SEGMENTS} segments per beam': _varied(robot, segments=SEGMENTS),
    }
    return {name: other for name, other in found.items() if other is not robot}


def _varied(
    robot: Robot, shape: dict[str, str] | None = None, more: int = 0, segments: int = 1
) -> Robot:
    """Return a robot with other shapes, more modes or more segments of every beam."""
    overrides: dict[str, Any] = {}
    for body in robot.tree.bodies:
        beam = body.beam
        if beam is None or not is_flexible(body) or body.segment > 1:
            continue
        path, divided = f'beam.{body.name}', beam.segments > 1 or segments > 1
        if segments > 1:
            overrides[f'{path}.segments'] = segments * beam.segments
        bends = next((part for part in (beam.y, beam.z) if part is not None and part.modes), None)
        if bends is not None and shape and bends.shape in shape and not divided:
            overrides[f'{path}.shape'] = shape[bends.shape]
        for name, part, critical in deformations(beam):
            if not part.modes:
                continue
            ratios = [float(ratio) for ratio in part.damping / critical]
            modes = max(part.modes + more, 1 if name == 'torsion' else 2)
            overrides[f'{path}.{name}.modes'] = modes
            ratios = ratios[:1] if divided else (ratios + ratios[-1:] * max(more, 0))[:modes]
            overrides[f'{path}.{name}.damping_ratio'] = ratios
    return robot.with_overrides(overrides) if overrides else robot
