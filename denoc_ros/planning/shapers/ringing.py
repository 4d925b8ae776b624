"""The modes that a motion of the joints excites, along the motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.base.reacting_base import held_robot
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.model.mode_table import ModeTable
from denoc_ros.planning.shapers.impulses import damped_frequency
from denoc_ros.planning.tip.reaction import in_free_fall
from denoc_ros.types import Array

WIDEST = 10.0  # modes above this multiple of the lowest one are hardly excited, and die quickly


class RingingModes(NamedTuple):
    """Modes with the joints held: damped frequencies (k,) [Hz], ascending, damping ratios (k,)."""

    frequencies: Array
    ratios: Array


def require_flexible(robot: Robot) -> None:
    """Refuse a robot without flexible coordinates.

    Raises
    ------
    SolverError
    """
    if not len(robot.flexible_indices):
        raise SolverError(
            f'{robot.tree.name}: a shaper needs a flexible link or a mode table, got none'
        )


def ringing_robot(robot: Robot, base: str) -> Robot:
    """Return a copy whose modes a motion is shaped for.

    Of a base that floats: ``free_flying`` where thrusters hold it, else it reacts.
    """
    return in_free_fall(held_robot(robot) if base == 'free_flying' else robot)


def ringing_modes(
    robot: Robot,
    q_joints: ArrayLike,
    count: int | None = None,
    table: ModeTable | None = None,
) -> RingingModes:
    """Return the modes to be shaped, with the joints held, at static equilibrium.

    A base that floats moves with them (see :func:`in_free_fall`).

    Parameters
    ----------
    robot : Robot
        With the payload it carries.
    q_joints : (joints,) array
        Posture [rad, m].
    count : int, optional
        The lowest so many; default those below `WIDEST` times the lowest, or all of a table.
    table : ModeTable, optional
        Measured modes, in place of the robot's own, which may be rigid.

    Raises
    ------
    StateError
        A count that is not >= 1.
    ConfigError
        The table has other joints.
    SolverError
        The robot has no such modes, one does not oscillate (buckling), or the posture has no
        equilibrium.
    """
    if count is not None and count < 1:
        raise StateError(f'{robot.tree.name}: modes to be shaped must be >= 1, got {count}')
    if table is not None:
        own, damping = table.at(robot.joint_names, np.asarray(q_joints))
        own, damping = own[:count], damping[:count]
        return RingingModes(damped_frequency(own, damping), damping)
    require_flexible(robot)
    modes = robot.natural_modes(robot.static_deflection(q_joints))
    rigid = len(robot.base_indices)  # a floating base's motions come first, without a frequency
    frequencies, ratios = modes.frequencies[rigid:], modes.damping_ratios[rigid:]
    if count is None:
        count = max(1, int(np.count_nonzero(frequencies < WIDEST * frequencies[0])))
    chosen = slice(0, count)
    frequencies, ratios = frequencies[chosen], ratios[chosen]
    if (frequencies <= 0.0).any() or (ratios >= 1.0).any():
        raise SolverError(
            f'{robot.tree.name}: every mode to be shaped must oscillate at the posture '
            f'{np.round(np.asarray(q_joints), 6).tolist()}, got frequencies '
            f'{np.round(frequencies, 4).tolist()} Hz and damping ratios '
            f'{np.round(ratios, 4).tolist()}'
        )
    return RingingModes(damped_frequency(frequencies, ratios), np.asarray(ratios))


def fastest_mode(robot: Robot, q_joints: ArrayLike, rests: float) -> float:
    """Return the frequency [Hz] of the fastest mode that a simulation of a motion resolves.

    The fastest of all with the joints held, at most `WIDEST` times the fastest one that rests.
    """
    if not len(robot.flexible_indices):
        return rests
    own = robot.natural_frequencies(robot.static_deflection(q_joints))
    return float(np.clip(own.max(), rests, WIDEST * rests))


def modes_along(
    robot: Robot, postures: Array, count: int | None = None, table: ModeTable | None = None
) -> RingingModes:
    """Return the modes at many postures (m, joints): frequencies and ratios (m, k).

    As many at each posture as at the first one; errors as of :func:`ringing_modes`.
    """
    first = ringing_modes(robot, postures[0], count, table)
    rest = [ringing_modes(robot, row, len(first.ratios), table) for row in postures[1:]]
    return RingingModes(
        np.array([first.frequencies, *(each.frequencies for each in rest)]),
        np.array([first.ratios, *(each.ratios for each in rest)]),
    )
