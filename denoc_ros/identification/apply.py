"""Results of identification put to use: in a robot, compared with each other, as a mode table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.identification.decay.damping import (
    USABLE,
    Assigned,
    assign_damping,
    configuration,
    damping_overrides,
)
from denoc_ros.identification.decay.modes import GOOD
from denoc_ros.model.mode_table import ModeTable

SAME_MODE = 0.1  # largest step between the log frequencies of one mode in two runs
REPEATABILITY = 1.96 * np.sqrt(2.0)  # of the deviation: what two runs differ by at most in 95 %
NORMAL_95 = 3.92  # standard deviations in a 95 % interval


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
    results : sequence of mapping
        Results of `denoc identify modal`, of the same configuration of the robot. Where several
        have a mode, the one with the narrower interval counts.
    joints : mapping
        Positions of joints [rad, m]; those not named are at 0.
    held : bool
        Whether the joints were locked (or held by their controllers), or free.

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


@dataclass(frozen=True)
class ComparedMode:
    """One mode over several runs."""

    runs: tuple[int, ...]  # places of the results that have it
    # means
    frequency_hz: float
    damping_ratio: float
    # standard deviations between runs; nan of a single one
    frequency_deviation_hz: float
    damping_deviation: float
    repeatability: float  # what the damping ratios of two runs differ by at most in 95 % of cases
    # what the runs' own 95 % intervals of the damping ratio let expect (root mean square)
    expected_deviation: float
    verdicts: tuple[str, ...]  # the runs'

    @property
    def consistent(self) -> bool:
        """Whether the runs differ by at most three times their intervals."""
        return not self.damping_deviation > 3.0 * self.expected_deviation


def compare_results(results: Sequence[Mapping[str, Any]]) -> list[ComparedMode]:
    """Return the modes of several results of `denoc identify modal`, by rising frequency.

    Raises
    ------
    IdentificationError
        For fewer than two results, or one of another kind.
    """
    if len(results) < 2:
        raise IdentificationError(f'compare: results must be at least 2, got {len(results)}')
    for k, one in enumerate(results):
        if one.get('kind') != 'modal':
            raise IdentificationError(
                f'compare: results must be of modes, got {one.get("kind")!r} in result {k + 1}'
            )
    found = [(k, mode) for k, one in enumerate(results) for mode in one['modes']]
    found.sort(key=lambda entry: float(entry[1]['frequency_hz']))
    groups: list[list[tuple[int, Mapping[str, Any]]]] = []
    for run, mode in found:
        last = groups[-1] if groups else []
        same = last and np.log(mode['frequency_hz'] / last[-1][1]['frequency_hz']) < SAME_MODE
        if same and run not in {other for other, _ in last}:
            last.append((run, mode))
        else:
            groups.append([(run, mode)])
    return [_compared(group) for group in groups]


def _compared(group: Sequence[tuple[int, Mapping[str, Any]]]) -> ComparedMode:
    group = sorted(group, key=lambda entry: entry[0])
    frequency = np.array([mode['frequency_hz'] for _, mode in group])
    ratio = np.array([mode['damping_ratio'] for _, mode in group])
    width = np.array([mode['interval'][1] - mode['interval'][0] for _, mode in group])
    several = len(group) > 1
    deviation = float(np.std(ratio, ddof=1)) if several else float('nan')
    return ComparedMode(
        runs=tuple(run for run, _ in group),
        frequency_hz=float(frequency.mean()),
        damping_ratio=float(ratio.mean()),
        frequency_deviation_hz=float(np.std(frequency, ddof=1)) if several else float('nan'),
        damping_deviation=deviation,
        repeatability=float(REPEATABILITY * deviation),
        expected_deviation=float(np.sqrt(np.mean((width / NORMAL_95) ** 2))),
        verdicts=tuple(str(mode['verdict']) for _, mode in group),
    )


def overrides_of_results(
    robot: Robot,
    results: Sequence[Mapping[str, Any]],
    at: Mapping[str, float],
    held: bool,
    doubtful: bool,
    joint: str,
) -> dict[str, Any]:
    """Return the numbers of a robot that results of modes and of a joint change, by dotted path.

    Parameters
    ----------
    at : mapping
        Positions of joints [rad, m]; the others' are those of the first result of modes, else 0.

    Raises
    ------
    IdentificationError
        Of another kind of result, or several of one joint.
    """
    overrides: dict[str, Any] = {}
    modal = [one for one in results if one['kind'] == 'modal']
    of_joint = [one for one in results if one['kind'] == 'joint']
    if modal:
        recorded = modal[0].get('model', {}).get('joints', {})
        joints = {name: recorded[name] for name in robot.joint_names if name in recorded}
        overrides |= modal_overrides(robot, modal, {**joints, **at}, held, doubtful)[0]
    if of_joint:
        if joint not in robot.joint_names or len(of_joint) > 1:
            raise IdentificationError(
                f'apply: --joint must name one of {", ".join(robot.joint_names)} for one result '
                f'of a joint, got {joint!r} for {len(of_joint)}'
            )
        overrides |= joint_overrides(of_joint[0], joint)
    if not overrides:
        raise IdentificationError('apply: results must be of modes or of a joint, got others')
    return overrides


def posture_table(
    results: Sequence[tuple[Path, Mapping[str, Any]]], doubtful: bool, name: str
) -> tuple[ModeTable, bool]:
    """Return the modes over postures that results have, one posture each; and if all are good.

    Parameters
    ----------
    results : sequence of (Path, mapping)
        With their files, which errors name.

    Raises
    ------
    ConfigError, IdentificationError
        Results without a posture, of other joints or of another number of modes.
    """
    rows = [_posture_row(path, result, doubtful) for path, result in results]
    first, modes = rows[0]
    findings = [
        f'{path}: must have the joints and as many modes as {results[0][0]} '
        f'({len(modes)} of {", ".join(first)}), got {len(row[1])} of {", ".join(row[0])}'
        for (path, _), row in zip(results, rows, strict=True)
        if row[0].keys() != first.keys() or len(row[1]) != len(modes)
    ]
    ConfigError.raise_any('command line', findings)
    joints = tuple(first)
    postures = np.array([[posture[joint] for joint in joints] for posture, _ in rows])
    frequency, damping = (
        np.array([[mode[key] for mode in modes] for _, modes in rows])
        for key in ('frequency_hz', 'damping_ratio')
    )
    good = all(mode['verdict'] == GOOD for _, modes in rows for mode in modes)
    return ModeTable(joints, postures, frequency, damping, name), good


def _posture_row(
    path: Path, result: Mapping[str, Any], with_doubtful: bool
) -> tuple[dict[str, float], list[Mapping[str, Any]]]:
    """Return where the joints stood, and the modes that a result's verdict is of, ascending."""
    joints = result.get('model', {}).get('joints', {})
    if result['kind'] != 'modal' or not joints:
        raise IdentificationError(
            f'{path}: result must be of `denoc identify modal` with a posture (--at JOINT=VALUE, '
            f'or joint states in the bag), got one without'
        )
    asked = [mode for mode in result['modes'] if mode.get('asked')]
    usable = USABLE if with_doubtful else USABLE[:1]
    bad = [mode for mode in asked if mode['verdict'] not in usable]
    if bad or not asked:
        said = ', '.join(f'{mode["frequency_hz"]:.4g} Hz: {mode["verdict"]}' for mode in bad)
        is_doubtful = bad and all(mode['verdict'] in USABLE for mode in bad)
        hint = ': --doubtful takes them' if is_doubtful else ''
        raise IdentificationError(
            f'{path}: modes must be {" or ".join(usable)}, got {said or "none"}{hint}'
        )
    return dict(joints), sorted(asked, key=lambda mode: float(mode['frequency_hz']))
