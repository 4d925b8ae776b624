"""A base that sways in waves: its motion is the derivative of its pose; scenarios that say so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import ConfigError
from denoc_ros.simulation.scenario import scenario_from_config
from denoc_ros.simulation.time_functions import SHIFTS, TURNS, Harmonic, SwayingBase
from denoc_ros.types import Array

CONFIG = Path(__file__).resolve().parents[2] / 'config'
STEP = 1e-4


def rough() -> SwayingBase:
    rng = np.random.default_rng(3)
    return SwayingBase(
        {
            name: Harmonic(0.5 * rng.uniform(0.5, 1.0), rng.uniform(3, 9), rng.uniform(0, 6))
            for name in (*SHIFTS, *TURNS)
        }
    )


def pose(base: SwayingBase, t: float) -> Array:
    found = base(t).pose
    assert found is not None
    return found


def test_twist_and_acceleration_are_derivatives_of_the_pose() -> None:
    base = rough()
    for t in (0.0, 1.7, 4.2):
        motion, here = base(t), pose(base, t)
        before, after = pose(base, t - STEP), pose(base, t + STEP)
        turn = here[:3, :3]
        velocity = (after - before)[:3, 3] / (2 * STEP)
        np.testing.assert_allclose(motion.twist[:3], turn.T @ velocity, atol=1e-7)
        spin = turn.T @ (after - before)[:3, :3] / (2 * STEP)
        rates = [spin[2, 1], spin[0, 2], spin[1, 0]]
        np.testing.assert_allclose(motion.twist[3:], rates, atol=1e-7)
        second = (after - 2 * here + before)[:3, 3] / STEP**2
        np.testing.assert_allclose(motion.acceleration[:3], turn.T @ second, atol=1e-5)
        grow = (base(t + STEP).twist - base(t - STEP).twist)[3:] / (2 * STEP)
        # components along turning axes: their rates are those of the vector, as w x w = 0
        np.testing.assert_allclose(motion.acceleration[3:], grow, atol=1e-7)


def shipped(name: str) -> dict[str, Any]:
    values = yaml.safe_load((CONFIG / 'scenarios' / name).read_text())
    assert isinstance(values, dict)
    return values


def test_boom_on_a_rolling_ship_swings() -> None:
    """The demo configuration: with the ship at rest the boom swings less."""
    robot = load_robot(CONFIG / 'robots' / 'ship_boom.urdf')
    values = {**shipped('ship_boom.yaml'), 'duration': 6.0}
    rolling = scenario_from_config(values, robot, 'test')
    assert rolling.base is not None
    moored = scenario_from_config({k: v for k, v in values.items() if k != 'base'}, robot, 'test')
    tips = [
        np.ptp(robot.tip_deflection('boom', scenario.run(robot).q[150:])[:, 1])
        for scenario in (rolling, moored)
    ]
    assert tips[0] > 1.5 * tips[1] > 0.0


BAD = [
    ({'rolling': {'amplitude': 1, 'period': 1}}, "base's keys must be of surge, .*got 'rolling'"),
    ({'roll': {'amplitude': 1}}, 'base roll must have numbers amplitude, period > 0 s'),
    ({'roll': {'amplitude': 1, 'period': 0}}, 'base roll must have numbers'),
    ({'heave': {'amplitude': 1, 'period': 2, 'size': 1}}, "base heave's keys must be of .*'size'"),
    ({'heave': 3}, 'base heave must be a mapping, got 3'),
    ([1], r'base must be a mapping, got \[1\]'),
]


@pytest.mark.parametrize(('base', 'message'), BAD)
def test_a_wrong_base_is_a_finding(base: Any, message: str) -> None:
    robot = load_robot(CONFIG / 'robots' / 'ship_boom.urdf')
    with pytest.raises(ConfigError, match=message):
        scenario_from_config({'duration': 1.0, 'base': base}, robot, 'test')


@pytest.mark.parametrize('arm', ['ssrms', 'canadarm'])
@pytest.mark.parametrize('tonnes', [10, 100])
def test_arms_on_spacecraft(arm: str, tonnes: int) -> None:
    """Same arm, its base free: rigid motions, and its torque at rest of the base."""
    robot = load_robot(CONFIG / 'robots' / f'{arm}_{tonnes}t.urdf', gravity=(0, 0, 0))
    fixed = load_robot(CONFIG / 'robots' / f'{arm}.urdf', gravity=(0, 0, 0))
    assert robot.joint_names == fixed.joint_names
    assert robot.mass == pytest.approx(1e3 * tonnes + fixed.mass)
    rng = np.random.default_rng(1)
    q, qd, qdd = 0.1 * rng.normal(size=(3, fixed.n))
    spread = [np.append(np.zeros(6), part) for part in (q, qd, qdd)]
    tau = robot.inverse_dynamics(spread[0], spread[1], spread[2])
    np.testing.assert_allclose(tau[6:], fixed.inverse_dynamics(q, qd, qdd), rtol=1e-9, atol=1e-9)


def test_spacecraft_scenario_keeps_its_momentum() -> None:
    robot = load_robot(CONFIG / 'robots' / 'ssrms_10t.urdf', gravity=(0, 0, 0))
    scenario = scenario_from_config({**shipped('ssrms_10t.yaml'), 'duration': 2.0}, robot, 'test')
    run = scenario.run(robot)
    momentum = robot.momentum(run.q, run.qd)
    np.testing.assert_allclose(momentum, 0.0, atol=1e-5)  # rtol 1e-8 per step, of 1e3 kg m^2/s
    assert np.abs(run.q[-1, robot.base_indices]).max() > 1e-4
