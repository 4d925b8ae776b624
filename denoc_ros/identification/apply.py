"""Write identified damping and friction into a robot's description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from denoc_ros.dynamics.measured_side import measured_equilibrium
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import IdentificationError
from denoc_ros.identification.damping import Assigned, assign_damping, damping_overrides

USABLE = ('good', 'doubtful')


def modal_overrides(
    robot: Robot,
    results: Sequence[Mapping[str, Any]],
    joints: Mapping[str, float],
    held: bool,
    doubtful: bool = False,
) -> tuple[dict[str, list[float]], list[Assigned]]:
    """Return damping ratios by dotted path with which the robot has the identified modes.

    Parameters
    ----------
    robot : Robot
        The model.
    results : sequence of mapping
        Results of `denoc identify modal`, of the same configuration of the robot. Where several
        have a mode, the one with the narrower interval counts.
    joints : mapping
        Positions of joints [rad, m]; those not named are at 0.
    held : bool
        Whether the joints were locked (or held by their controllers), or free.
    doubtful : bool
        Whether doubtful modes count too.

    Raises
    ------
    IdentificationError
        When there is no mode to apply, or the model does not have one of them.
    """
    wanted = USABLE if doubtful else USABLE[:1]
    modes = [mode for one in results for mode in one['modes'] if mode['verdict'] in wanted]
    modes = _without_repeats(modes)
    if not modes:
        raise IdentificationError(
            f'{robot.tree.name}: results must have a mode whose verdict is '
            f'{" or ".join(wanted)}, got {_left_out(results, doubtful)}'
        )
    assigned = assign_damping(
        robot,
        configuration(robot, joints),
        [mode['frequency_hz'] for mode in modes],
        [mode['damping_ratio'] for mode in modes],
        held,
        [mode['amplitude'] for mode in modes],
    )
    return damping_overrides(robot, assigned), assigned


def joint_overrides(result: Mapping[str, Any], joint: str) -> dict[str, float]:
    """Return viscous damping and Coulomb friction of a joint by dotted path.

    Parameters
    ----------
    result : mapping
        Result of `denoc identify joint`.
    joint : str
        Whose they are.

    Raises
    ------
    IdentificationError
        When the result does not give them in N m s/rad and N m.
    """
    if result.get('inertia_kg_m2') is None:
        raise IdentificationError(
            f'joint {joint}: result must have coefficients in N m, got some per inertia: give '
            'denoc identify joint the inertia or the gravity torque'
        )
    terms = result['terms']
    if 'quadratic' in terms:
        raise IdentificationError(
            f'joint {joint}: friction must be viscous and Coulomb, got a quadratic term, which '
            'a URDF cannot have'
        )
    found = {name: float(term['value']) for name, term in terms.items()}
    return {
        f'joint.{joint}.damping': float(f'{found.get("viscous", 0.0):.6g}'),
        f'joint.{joint}.friction': float(f'{found.get("coulomb", 0.0):.6g}'),
    }


def configuration(robot: Robot, joints: Mapping[str, float]) -> np.ndarray[Any, Any]:
    """Return the state (n,) at given joint positions, the amplitudes in equilibrium."""
    unknown = sorted(set(joints) - set(robot.joint_names))
    if unknown:
        raise IdentificationError(
            f'{robot.tree.name}: joints must be some of {", ".join(robot.joint_names)}, '
            f'got {", ".join(unknown)}'
        )
    return measured_equilibrium(robot, np.array([joints.get(n, 0.0) for n in robot.joint_names]))


def _left_out(results: Sequence[Mapping[str, Any]], doubtful: bool) -> str:
    """Verdicts of the modes that do not count, and the option that would take them."""
    verdicts = [mode['verdict'] for one in results for mode in one['modes']]
    if 'doubtful' in verdicts and not doubtful:
        return f'{verdicts.count("doubtful")} doubtful: --doubtful takes them'
    return ', '.join(f'{verdicts.count(one)} {one}' for one in sorted(set(verdicts))) or 'none'


def _without_repeats(modes: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Keep the better known one of modes that are the same within 3 %."""
    kept: list[Mapping[str, Any]] = []
    for mode in sorted(modes, key=_width):
        same = (abs(np.log(one['frequency_hz'] / mode['frequency_hz'])) < 0.03 for one in kept)
        if not any(same):
            kept.append(mode)
    return sorted(kept, key=lambda mode: float(mode['frequency_hz']))


def _width(mode: Mapping[str, Any]) -> float:
    low, high = mode['interval']
    return float((high - low) / mode['damping_ratio'])
