"""`--at`: postures on a command line."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import numpy as np

from denoc_ros.cli.arguments import add_option
from denoc_ros.cli.robot_text import Posture
from denoc_ros.dynamics.equilibrium import Equilibrium
from denoc_ros.dynamics.linear.natural_modes import independent_joints
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError


def add_postures(parser: argparse.ArgumentParser) -> None:
    """Declare `--at`."""
    add_option(
        parser,
        '--at Q',
        'compute natural frequencies, or --bode, at these joint positions [rad, m], in '
        'the order of the table of joints, or at JOINT=VALUE with the others at zero; '
        'repeatable; default zero',
        action='append',
        nargs='+',
    )


def read_postures(robot: Robot, given: Sequence[Sequence[str]] | None) -> list[Posture]:
    """Return the postures of `--at`, loops closed and amplitudes in equilibrium.

    Raises
    ------
    ConfigError
        For what is no number, or not as many as there are joints.
    SolverError
        Loops do not close near it, or a beam has no equilibrium there.
    """
    names, postures, findings = robot.joint_names, [], []
    for words in given or ():
        values = _positions(names, [text for word in words for text in word.split(',') if text])
        if len(values) != len(names) or not all(map(math.isfinite, values)):
            order = f'{len(names)} numbers ({", ".join(names)})'
            findings.append(f'--at must be {order} or JOINT=VALUE, got {" ".join(words)!r}')
            continue
        postures.append(values)
    ConfigError.raise_any('command line', findings)
    return [posture(robot, values) for values in postures]


def _positions(names: Sequence[str], texts: Sequence[str]) -> list[float]:
    """Numbers in order or by their joints' names; NaN where a text is neither."""
    pairs = [text.rpartition('=') for text in texts]
    try:
        numbers = [float(number) for _, _, number in pairs]
    except ValueError:
        return [math.nan]
    named = {name: number for (name, _, _), number in zip(pairs, numbers, strict=True)}
    if set(named) == {''}:
        return numbers
    if not named.keys() <= set(names) or len(named) < len(texts):
        return [math.nan]
    return [named.get(name, 0.0) for name in names]


def posture(robot: Robot, joints: Sequence[float]) -> Posture:
    """Return a posture by its joints' positions."""
    q = np.zeros(robot.n)
    q[robot.joint_indices] = joints
    if robot.constraint_names:
        q = robot.assemble(q)
        held = robot.indices(independent_joints(robot, q))
        Equilibrium(robot, np.setdiff1d(np.arange(robot.n), held)).find(q)
    else:
        q = robot.static_deflection(q[robot.joint_indices])
    return Posture(', '.join(f'{value:.3g}' for value in joints), q)
