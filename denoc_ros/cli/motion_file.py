"""Motions of joints in files: references, scenarios and trajectories read; plans written."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from denoc_ros.cli.session.session_config import read_reference
from denoc_ros.dynamics.driven.motion_grid import GridMotion
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.errors import ConfigError
from denoc_ros.output_files import write_text
from denoc_ros.runtime.inputs.trajectory_messages import RESTING
from denoc_ros.simulation.reference_motion import trajectory_from_config
from denoc_ros.trajectories import Trajectory
from denoc_ros.types import Array

STEP = 0.01  # s between samples of a motion that is a formula
DIGITS = 12  # of a number in a file


def read_motion(
    values: Mapping[str, Any], file: Path, joints: Sequence[str]
) -> tuple[Array, Array]:
    """Return times (k,) and positions (k, joints) from rest to rest.

    Parameters
    ----------
    values : mapping
        Of the file: a `reference` (kind book, sine or points), a scenario or configuration of
        `denoc up` that has one, or a trajectory_msgs/JointTrajectory as `ros2 topic echo` shows
        it. `joints` says whose the numbers of a configuration are, `posture` where the others
        are.
    joints : sequence of str
        The robot's joints, in their order; what the file does not name stays at 0.
    """
    named = list(joints)
    if 'kind' not in values and isinstance(values.get('joints'), list) and values['joints']:
        named = values['joints']
    findings = [f'joints must be of {list(joints)}, got {n!r}' for n in named if n not in joints]
    posture = values.get('posture') or [0.0] * len(joints)
    if not isinstance(posture, list) or len(posture) != len(joints):
        findings.append(f'posture must be {len(joints)} numbers, got {posture!r}')
    ConfigError.raise_any(str(file), findings)
    if 'joint_names' in values:
        times, rows = _joint_trajectory(values, named, str(file))
    else:
        reference = _reference(values, file)
        trajectory = trajectory_from_config(reference, named, f'{file}: reference')
        _require_rest(reference.get('velocities'), str(file))
        times, rows = _table(trajectory, reference)
    every = np.tile(np.asarray(posture, dtype=np.float64), (len(times), 1))
    every[:, [list(joints).index(name) for name in named]] = rows
    return times, every


def _reference(values: Mapping[str, Any], file: Path) -> dict[str, Any]:
    reference: Any = values if 'kind' in values else values.get('reference')
    if reference is None and isinstance(values.get('torque'), dict):
        reference = values['torque'].get('reference')
    if isinstance(reference, str):
        reference = read_reference(reference, file.parent, str(file))
    if not isinstance(reference, Mapping):
        rule = 'the file must have a kind, a reference or joint_names, got none of them'
        raise ConfigError(str(file), [rule])
    return dict(reference)


def _table(trajectory: Trajectory, reference: Mapping[str, Any]) -> tuple[Array, Array]:
    """Return the points themselves where the motion is points, else close samples of it."""
    if reference['kind'] == 'points' and len(reference['times']) > 1:
        times = np.asarray(reference['times'], dtype=np.float64)
        rows, scratch = np.zeros((len(times), trajectory.n)), np.zeros((2, trajectory.n))
        for row, time in zip(rows, times, strict=True):
            trajectory.sample(float(time), row, *scratch)
        return times, rows
    times, rows, _, _ = trajectory.table(min(STEP, trajectory.duration / 200.0))
    return times, rows


def _joint_trajectory(
    values: Mapping[str, Any], joints: Sequence[str], where: str
) -> tuple[Array, Array]:
    names, given = values['joint_names'], values.get('points')
    points = given if isinstance(given, list) else []
    findings = []
    if not isinstance(names, list) or not set(names) <= set(joints):
        findings.append(f'joint_names must be of {list(joints)}, got {names}')
    if len(points) < 2:
        findings.append(f'points must be two or more, got {len(points)}')
    ConfigError.raise_any(where, findings)
    columns = [list(joints).index(name) for name in names]
    rows, times = np.zeros((len(points), len(joints))), np.zeros(len(points))
    rates: list[list[float]] = []
    for k, point in enumerate(points):
        try:
            since = point['time_from_start']
            times[k] = float(since.get('sec', 0)) + 1e-9 * float(since.get('nanosec', 0))
            rows[k, columns] = point['positions']
            rates.append([float(each) for each in point.get('velocities') or ()])
        except (KeyError, TypeError, ValueError, AttributeError):
            findings.append(
                f'points {k} must have time_from_start (sec, nanosec) and {len(names)} positions'
            )
    ConfigError.raise_any(where, findings)
    _require_rest(rates, where)
    return times, rows


def _require_rest(velocities: Sequence[Sequence[float]] | None, where: str) -> None:
    if velocities is None:
        return
    largest = float(np.abs(np.concatenate((velocities[0], velocities[-1]))).max(initial=0.0))
    if largest > RESTING:
        rule = f'a motion must begin and end at rest, got {largest:.3g} (rad/s, m/s) at an end'
        raise ConfigError(where, [rule])


def write_plan(plan: Plan, file: Path, interval: float) -> None:
    """Write a plan: `.csv` as a table, anything else as a YAML reference.

    Parameters
    ----------
    interval : float
        Between rows [s], at most; quintics between them.
    """
    count = max(1, math.ceil(float(plan.t[-1] - plan.t[0]) / interval - 1e-9))
    times: Array = np.linspace(plan.t[0], plan.t[-1], count + 1)
    step = float(plan.t[-1] - plan.t[0]) / (len(plan.t) - 1)
    motion = GridMotion(float(plan.t[0]), step, plan.q, plan.qd, plan.qdd).sample(times)
    if file.suffix == '.csv':
        _write_table(plan, file, times, motion)
    else:
        _write_reference(plan, file, times, motion)


def _write_reference(
    plan: Plan, file: Path, times: Array, motion: tuple[Array, Array, Array]
) -> None:
    """Write the driven joints' points; their times begin at 0."""
    columns = [plan.coordinate_names.index(name) for name in plan.joint_names]
    positions, velocities, accelerations = (part[:, columns] for part in motion)
    head = (
        f'# Planned by `denoc shape`, method {plan.method}: 0 s is {plan.t[0]:.6g} s of the '
        f'motion that was asked for,\n# which is {plan.stretch:.6g} times slower here.\n'
    )
    write_points(
        file, head, plan.joint_names, times - times[0], (positions, velocities, accelerations)
    )


def write_points(
    file: Path, head: str, joints: Sequence[str], times: Array, motion: tuple[Array, Array, Array]
) -> None:
    """Write a motion as a YAML reference of kind points.

    Parameters
    ----------
    times : (k,) array
        From 0 on [s].
    motion : three (k, joints) arrays
        Positions, velocities, accelerations.
    """
    names = ('positions', 'velocities', 'accelerations')
    reference = {
        'kind': 'points',
        'joints': list(joints),
        'times': _numbers(times),
        **{
            name: [_numbers(row) for row in part] for name, part in zip(names, motion, strict=True)
        },
    }
    text = yaml.safe_dump(reference, sort_keys=False, default_flow_style=None, width=110)
    write_text(file, head + text)


def write_joint_trajectory(
    file: Path, joints: Sequence[str], times: Array, motion: tuple[Array, Array, Array]
) -> None:
    """Write a motion as the YAML of a trajectory_msgs/JointTrajectory; arguments as there."""
    points = []
    for time, *rows in zip(times, *motion, strict=True):
        names = ('positions', 'velocities', 'accelerations')
        whole = round(1e9 * float(time))
        since = {'sec': whole // 10**9, 'nanosec': whole % 10**9}
        point = {name: _numbers(row) for name, row in zip(names, rows, strict=True)}
        points.append({**point, 'time_from_start': since})
    message = {'joint_names': list(joints), 'points': points}
    text = yaml.safe_dump(message, sort_keys=False, default_flow_style=None, width=110)
    write_text(file, text)


def _write_table(plan: Plan, file: Path, times: Array, motion: tuple[Array, Array, Array]) -> None:
    """Write a row per time: the motion of a JointTrajectory, the amplitudes, the tip's error."""
    names = plan.coordinate_names
    head = ['time']
    for what in ('position', 'velocity', 'acceleration'):
        head += [f'{name}/{what}' for name in names]
    head += [f'{name}/effort' for name in plan.joint_names] + ['tip_error', 'tip_turn']
    columns = [plan.torque, plan.tip_error, plan.tip_turn]
    if plan.base_wrench is not None:
        head += [f'base/{what}_{axis}' for what in ('force', 'torque') for axis in 'xyz']
        columns.append(plan.base_wrench)
    rest = np.column_stack(columns)
    between = np.column_stack([np.interp(times, plan.t, column) for column in rest.T])
    out = io.StringIO(newline='')
    writer = csv.writer(out)
    writer.writerow(head)
    writer.writerows(_numbers(row) for row in np.column_stack([times, *motion, between]))
    write_text(file, out.getvalue())


def _numbers(row: Array) -> list[float]:
    return [float(f'{value:.{DIGITS}g}') for value in row]
