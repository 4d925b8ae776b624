"""The book's systems as they are shipped: robot and scenario files, loaded and run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from denoc_ros.cli.session.session_config import read_yaml
from denoc_ros.dynamics.robot import Robot
from denoc_ros.simulation.scenario import Scenario, model_settings, scenario_from_config
from denoc_ros.simulation.simulate import Run
from denoc_ros.simulation.time_functions import TimeFunction
from denoc_ros.types import Array

CONFIG = Path(__file__).resolve().parents[3] / 'config'


def shipped(
    robot: str, scenario: str, overrides: Mapping[str, float] | None = None
) -> tuple[Robot, Scenario]:
    """A robot of config/robots as a scenario of config/scenarios wants it, and the scenario.

    `overrides` are dotted paths beside those of the scenario's own `model`.
    """
    values = read_yaml(CONFIG / 'scenarios' / f'{scenario}.yaml')
    values['model'] = {**(values.get('model') or {}), **(overrides or {})}
    settings = model_settings(values, scenario)
    loaded = settings.load(CONFIG / 'robots' / f'{robot}.urdf')
    return loaded, scenario_from_config(values, loaded, scenario)


def until(scenario: Scenario, end: float) -> Scenario:
    """The scenario up to an earlier time [s]."""
    return replace(scenario, times=scenario.times[scenario.times <= end + 1e-9])


def joints(robot: Robot, run: Run) -> Array:
    """Joint coordinates (k, joints) of a run."""
    return np.asarray(run.q[:, robot.joint_indices])


def desired(scenario: Scenario) -> Array:
    """Desired joint coordinates (k, joints) at the output times."""
    assert scenario.reference is not None
    law = TimeFunction(scenario.reference)
    return np.array([law(float(t))[0].copy() for t in scenario.times])


def tips(robot: Robot, run: Run, link: str) -> Array:
    """Tip deflection (k, 3) of a link over a run, beam frame [m]."""
    return np.array([robot.tip_deflection(link, q) for q in run.q])
