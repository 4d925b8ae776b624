"""The book's flexible mechanisms against independent solutions (finite segments and elements).

Their README states what m assumed modes cost in loops, where links are pinned at both ends: two
clamped-free shapes put the first vibration 1.3 % too high, and its phase drifts. Craig-bampton
shapes have the static deflections between two pins, and no such error.
"""

from __future__ import annotations

import numpy as np
import pytest
from mechanism_runs import book_fall, columns, cut_four_bar, gaps, loaded
from planar_chains import reference

import denoc_ros as dn

RELATIVE, ABSOLUTE = 1e-6, 1e-8  # per step


@pytest.mark.parametrize(
    ('table', 'kind', 'shape', 'modes', 'end', 'angle', 'deflection'),
    # measured, and a tenth more: rad, and part of the peak deflection
    [
        ('four_bar', 'RRF', 'clamped-free', 2, 0.6, 4.2e-4, 0.06),
        ('four_bar', 'RRF', 'clamped-free', 6, 0.15, 1.6e-5, 0.003),
        ('four_bar', 'RRF', 'craig-bampton', 3, 0.6, 1.6e-4, 0.022),
        ('five_bar', 'RFFR', 'clamped-free', 2, 0.6, 1.5e-4, 0.07),
        ('five_bar', 'RFFR', 'clamped-free', 6, 0.15, 4e-6, 0.003),
        ('five_bar', 'RFFR', 'craig-bampton', 3, 0.6, 5e-5, 0.023),
        ('planar_3dof', '3RF', 'clamped-free', 2, 0.5, 5.4e-4, 0.125),
        ('planar_3dof', '3RF', 'clamped-free', 6, 0.1, 1.2e-5, 0.004),
        ('planar_3dof', '3RF', 'craig-bampton', 3, 0.5, 1.8e-4, 0.007),
        ('rssr', 'RRF', 'clamped-free', 2, 0.6, 2e-4, 0.052),
        ('rssr', 'RRF', 'clamped-free', 6, 0.15, 7e-6, 0.008),
        ('rssr', 'RRF', 'craig-bampton', 3, 0.6, 2.2e-5, 0.03),
    ],
)
def test_flexible_mechanisms_fall_as_the_reference_solutions(
    table: str, kind: str, shape: str, modes: int, end: float, angle: float, deflection: float
) -> None:
    robot, expected = loaded(table, kind, modes, shape), reference(f'{table}_{kind}')
    times = expected['t'][expected['t'] <= end + 1e-9]
    run = book_fall(robot, table, times, rtol=RELATIVE, atol=ABSOLUTE)
    got = gaps(columns(robot, run, table, kind), expected)
    assert got[0] <= angle
    assert got[1] <= deflection
    assert run.energy_drift <= 1e-8


def cut_gap(modes: int, shape: str) -> float:
    """Largest difference of the crank's angle [rad] between cuts at joints 2, 3 and 4."""
    times = np.linspace(0.0, 0.1, 11)
    angles = []
    for cut in (2, 3, 4):
        robot, q = cut_four_bar(cut, 'RFF', modes, shape)
        run = dn.simulate(robot, q, np.zeros(robot.n), times, rtol=RELATIVE, atol=ABSOLUTE)
        angles.append(run.coordinate('crank_joint'))
    return float(np.max(np.ptp(angles, axis=0)))


def test_cuts_of_a_flexible_mechanism_converge_with_the_shapes() -> None:
    two, four = (cut_gap(modes, 'clamped-free') for modes in (2, 4))
    assert two > 1e-6  # a re-rooted link has other clamped-free shapes
    assert four < 0.4 * two


def test_craig_bampton_shapes_do_not_mind_where_a_link_is_rooted() -> None:
    # Static shapes of both ends and clamped-clamped ones, with the rigid motions: the same space
    # from either end. What is left is the integrator's.
    assert cut_gap(2, 'craig-bampton') <= 1e-8
