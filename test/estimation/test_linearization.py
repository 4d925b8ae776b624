"""The observer's linearization: by the recursion of the dynamics, and by their differences."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import denoc_ros as dn
from denoc_ros.dynamics.equilibrium import response
from denoc_ros.estimation import amplitude_filter
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.types import Array

Response = Callable[[dn.Robot, Array, NDArray[Any]], Array]

STEP, TICKS = 2e-3, 200


def by_differences(robot: dn.Robot, q: Array, free: NDArray[Any]) -> Array:
    """The free coordinates' accelerations by forces on them, from the dynamics themselves."""
    joints = zip(robot.joint_names, robot.joint_indices, strict=True)
    names = [name for name, index in joints if index not in free]
    still, none, pushes = np.zeros(robot.n), np.zeros(len(names)), np.eye(robot.n)[free]
    columns = [
        robot.hybrid_dynamics(q, still, none, names, push)[1]
        - robot.hybrid_dynamics(q, still, none, names, -push)[1]
        for push in pushes
    ]
    return np.asarray(0.5 * np.array(columns).T, np.float64)


def estimates(robot: dn.Robot) -> Array:
    """Coordinates (ticks, n) estimated from moving joints and ringing gauges."""
    settings = ObserverSettings(step=STEP, fusion=FusionSettings())
    observer, joints = Observer(robot, settings), len(robot.joint_names)
    noise = np.array([sensor.noise for sensor in robot.tree.sensors])
    found = []
    for k in range(TICKS):
        t = k * STEP
        turn = np.full(joints, 0.2 * np.sin(0.5 * t))
        observer.measure(t, turn, np.full(joints, 0.1 * np.cos(0.5 * t)), np.zeros(joints))
        for place, size in enumerate(noise):
            observer.sense(place, t, 5.0 * size * np.sin(20.0 * t + place))
        observer.tick(t)
        found.append(observer.q.copy())
    return np.array(found)


def test_estimates_are_those_of_a_linearization_by_differences(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found(given: Response) -> Array:
        robot = dn.load_robot(repository / 'config/robots/canadarm_gauges.urdf')
        with monkeypatch.context() as patch:
            patch.setattr(amplitude_filter, 'response', given)
            return estimates(robot)

    exact = found(response)
    flexible = dn.load_robot(repository / 'config/robots/canadarm_gauges.urdf').flexible_indices
    size = np.abs(exact[:, flexible]).max()
    gap = np.abs(found(by_differences) - exact).max()
    assert gap < 1e-9 * size
    wrong = found(lambda *given: 1.01 * by_differences(*given))
    assert np.abs(wrong - exact).max() > 1e-5 * size  # they do depend on it
