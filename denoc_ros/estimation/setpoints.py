"""Detection of setpoints rounded so coarsely that their accelerations are noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from denoc_ros.estimation.joint_motion import smooth
from denoc_ros.types import Array

FEWEST_POINTS = 16
WHOLE = 1e-3  # of a step: how far positions may be off a multiple of it
SMALLEST_STEP = 1e-12  # of the range: less is the rounding of floating point
# of second differences, over the step: sqrt(6) times the deviation of rounding
ROUNDING_DEVIATION = (6.0 / 12.0) ** 0.5
ROUNDING = 0.6  # share of the acceleration that comes from rounding; above it, it is reported


def rounded_setpoints(values: Mapping[str, Any]) -> list[str]:
    """Return a warning per column of setpoints whose accelerations are mostly rounding.

    Parameters
    ----------
    values : mapping
        A scenario: its `reference`, `prescribed` and torque's reference are looked at, where they
        are points without accelerations.
    """
    found = []
    for where, points in _point_lists(values):
        times, rows = _arrays(points)
        for column, x in enumerate(rows.T):
            step, share = _rounding(x)
            if share > ROUNDING:
                interval = float(np.median(np.diff(times)))
                off = ROUNDING_DEVIATION * step / interval**2
                found.append(
                    f'{where}: positions of column {column} are rounded to {step:.2g} at steps of '
                    f'{interval:.3g} s: their accelerations are off by about '
                    f'{off:.2g} per s^2; --smooth HZ removes that'
                )
    return found


def smoothed(values: Mapping[str, Any], cutoff: float) -> dict[str, Any]:
    """Return a scenario whose points are smoothed, rates and accelerations left to the spline.

    Parameters
    ----------
    values : mapping
        The scenario.
    cutoff : float
        [Hz]; motion that is faster is taken out by polynomials around each time, so nothing
        comes late.
    """
    changed = deepcopy(dict(values))
    for _, points in _point_lists(changed):
        times, rows = _arrays(points)
        points['positions'] = smooth(times, rows, cutoff=cutoff).q.tolist()
        points.pop('velocities', None)
    return changed


def _point_lists(values: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    torque = values.get('torque')
    prescribed = values.get('prescribed')
    some = {'reference': values.get('reference')}
    some['torque.reference'] = torque.get('reference') if isinstance(torque, dict) else None
    for name, one in (prescribed if isinstance(prescribed, dict) else {}).items():
        some[f'prescribed.{name}'] = one
    for where, one in some.items():
        if isinstance(one, dict) and one.get('kind') == 'points' and _readable(one):
            yield where, one


def _readable(points: Mapping[str, Any]) -> bool:
    try:
        times, rows = _arrays(points)
    except (KeyError, TypeError, ValueError):
        return False  # the scenario's own reader says what is wrong
    fits = times.ndim == 1 and rows.ndim == 2 and len(times) == len(rows)
    given = points.get('accelerations')
    return bool(
        fits and not given and len(times) >= FEWEST_POINTS and np.all(np.diff(times) > 0.0)
    )


def _arrays(points: Mapping[str, Any]) -> tuple[Array, Array]:
    return np.asarray(points['times'], float), np.asarray(points['positions'], float)


def _rounding(x: Array) -> tuple[float, float]:
    """Return the step that positions are rounded to, and rounding's share of acceleration."""
    steps = np.unique(np.abs(np.diff(x)))
    steps = steps[steps > SMALLEST_STEP * max(float(np.ptp(x)), 1e-300)]
    if not steps.size:
        return 0.0, 0.0
    step = float(steps[0])
    parts = x / step
    if np.max(np.abs(parts - np.round(parts))) > max(WHOLE, 1e-9 * float(np.abs(parts).max())):
        return 0.0, 0.0
    size = float(np.sqrt(np.mean(np.diff(x, 2)[1:-1] ** 2)))
    return step, ROUNDING_DEVIATION * step / size if size else 0.0
