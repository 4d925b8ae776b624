"""A scenario prepared for a robot, and the numbers of its run."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.cli.arguments import given_file
from denoc_ros.cli.config import find_file, read_yaml
from denoc_ros.cli.setpoints import rounded_setpoints, smoothed
from denoc_ros.dynamics.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.simulation.scenario import Scenario, model_settings, scenario_from_config
from denoc_ros.simulation.simulate import Run


def load(robot: str, scenario: str, smooth: float | None = None) -> tuple[Robot, Scenario, str]:
    """Return the robot as the scenario wants it, the scenario, and the robot's URDF text.

    Parameters
    ----------
    robot, scenario : str
        Paths; ones that are not here are looked for where the package is installed.
    smooth : float, optional
        What is faster is taken out of the scenario's points [Hz]; without it, points whose
        accelerations are mostly rounding are warned of.

    Raises
    ------
    ConfigError, ModelError
        With every finding of the file.
    """
    robot_file, scenario_file = given_file(robot, 'robot'), given_file(scenario, 'scenario')
    values = _smooth_enough(_with_reference(read_yaml(scenario_file), scenario_file), smooth)
    loaded, made = prepare(robot_file, values, str(scenario_file))
    return loaded, made, robot_file.read_text(encoding='utf-8')


def _with_reference(values: dict[str, Any], scenario: Path) -> dict[str, Any]:
    """Return a scenario with the reference of another file in place of that file's name."""
    name = values.get('reference')
    if not isinstance(name, str):
        return values
    found = find_file(Path(name), scenario.parent)
    if found is None:
        rule = f'reference must be a mapping or an existing YAML file, got {name!r}'
        raise ConfigError(str(scenario), [rule])
    return {**values, 'reference': read_yaml(found)}


def _smooth_enough(values: Mapping[str, Any], smooth: float | None) -> Mapping[str, Any]:
    if smooth is None:
        for warning in rounded_setpoints(values):
            print(f'denoc simulate: warning: {warning}', file=sys.stderr)
        return values
    if not 0.0 < smooth < float('inf'):
        raise ConfigError('--smooth', [f'the frequency must be > 0 Hz, got {smooth}'])
    return smoothed(values, smooth)


def prepare(
    robot: Path | str,
    values: Mapping[str, Any],
    where: str,
    overrides: Mapping[str, float] | None = None,
) -> tuple[Robot, Scenario]:
    """Return the robot as a scenario wants it, and the scenario.

    Parameters
    ----------
    robot : Path or str
        The URDF file, or its text.
    values : mapping
        The scenario.
    where : str
        The scenario's name in errors.
    overrides : mapping, optional
        Of the model, beside and above those of the scenario.

    Raises
    ------
    ConfigError, ModelError
        With every finding.
    """
    loaded = model_settings(values, where).load(robot, overrides)
    return loaded, scenario_from_config(values, loaded, where)


def summarize(robot: Robot, result: Run) -> dict[str, Any]:
    """Return duration, work done, energy drift and each flexible tip's largest deflection."""
    tips = TipDeflections(robot)
    rows = np.array([tips.evaluate(q, qd)[0] for q, qd in zip(result.q, result.qd, strict=True)])
    largest = {
        name: float(np.max(np.abs(rows[:, column])))
        for column, name in enumerate(tips.names)
        if name.rpartition('/')[2] in ('uy', 'uz', 'rx') and np.any(rows[:, column])
    }
    return {
        'duration_s': float(result.t[-1] - result.t[0]),
        'samples': len(result.t),
        'evaluations': result.evaluations,
        'largest_torque': dict(
            zip(
                robot.joint_names,
                np.max(np.abs(result.torque[:, robot.joint_indices]), axis=0).tolist(),
                strict=True,
            )
        ),
        'largest_deflection': largest,
        'energy_change': result.energy_drift,
    }
