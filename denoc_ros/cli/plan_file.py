"""A plan as a file: a reference that sessions and scenarios read, or a table of everything."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from denoc_ros.control.grid import GridMotion
from denoc_ros.control.plan import Plan
from denoc_ros.output_files import write_text
from denoc_ros.types import Array

DIGITS = 12  # of a number in a file


def write_plan(plan: Plan, file: Path, interval: float) -> None:
    """Write a plan: `.csv` as a table, anything else as a YAML reference.

    Parameters
    ----------
    plan : Plan
    file : Path
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
    file: Path,
    head: str,
    joints: Sequence[str],
    times: Array,
    motion: tuple[Array, Array, Array],
) -> None:
    """Write a motion as a YAML reference of kind points.

    Parameters
    ----------
    file : Path
    head : str
        Comment lines above it.
    joints : sequence of str
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
