"""Setpoints that are rounded: told, and smoothed so that the torque's peaks are gone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from denoc_ros.estimation.setpoints import rounded_setpoints, smoothed

T = np.arange(0.0, 1.0005, 1e-3)
Q = 0.4 * (1.0 - np.cos(np.pi * T))


def scenario(positions: np.ndarray[Any, Any]) -> dict[str, Any]:
    points = {'kind': 'points', 'times': T.tolist(), 'positions': positions[:, None].tolist()}
    return {'prescribed': {'joint_1': points}, 'duration': 1.0}


def test_rounded_setpoints_are_told_with_what_they_do_to_accelerations() -> None:
    (warning,) = rounded_setpoints(scenario(np.round(Q, 5)))
    assert warning.startswith('prescribed.joint_1: positions of column 0 are rounded to 1e-05')
    assert '--smooth HZ' in warning
    # fine ones, coarse ones that are far apart and given accelerations are as they should be
    assert rounded_setpoints(scenario(Q)) == []
    assert rounded_setpoints(scenario(np.round(Q, 9))) == []
    few = scenario(np.round(Q, 5))
    one = few['prescribed']['joint_1']
    one['times'], one['positions'] = one['times'][::50], one['positions'][::50]
    assert rounded_setpoints(few) == []
    given = scenario(np.round(Q, 5))
    given['prescribed']['joint_1']['accelerations'] = [[0.0]] * T.size
    assert rounded_setpoints(given) == []


def test_smoothing_gives_the_acceleration_back_and_moves_nothing() -> None:
    rough = scenario(np.round(Q, 5))
    smooth = np.ravel(smoothed(rough, 10.0)['prescribed']['joint_1']['positions'])
    assert smooth == pytest.approx(Q, abs=2e-5)
    truth = 0.4 * np.pi**2 * np.cos(np.pi * T)
    inside = slice(100, -100)
    before = CubicSpline(T, np.round(Q, 5))(T, 2)[inside] - truth[inside]
    after = CubicSpline(T, smooth)(T, 2)[inside] - truth[inside]
    assert np.abs(before).max() > 10.0
    assert np.abs(after).max() < 1.0
    # the scenario that was given stays
    assert rough['prescribed']['joint_1']['positions'][7] == [round(Q[7], 5)]
