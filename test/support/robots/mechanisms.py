"""The book's mechanisms: what is shipped, and variants of it with other shapes and cuts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from denoc_ros.export.dh_system import load_system
from denoc_ros.export.dh_verb import urdf_text

CONFIG = Path(__file__).resolve().parents[3] / 'config'
DOWN = (0.0, -9.81, 0.0)
# Table, the book's kind, kinds link by link.
SHIPPED = [
    ('four_bar', 'RRR', 'RRR'),
    ('four_bar', 'RRF', 'RRF'),
    ('four_bar', 'RFF', 'RFF'),
    ('four_bar', 'FFF', 'FFF'),
    ('five_bar', 'RRRR', 'RRRR'),
    ('five_bar', 'RFFR', 'RFRF'),
    ('five_bar', 'FRRF', 'FRFR'),
    ('five_bar', 'FFFF', 'FFFF'),
    ('planar_3dof', '3RR', 'RRRRRRR'),
    ('planar_3dof', '3RF', 'RFRRFRF'),
    ('planar_3dof', '3FF', 'FFRFFFF'),
    ('rssr', 'RRR', 'RRRR'),
    ('rssr', 'RRF', 'FRRR'),
    ('rssr', 'FRR', 'RRRF'),
    ('rssr', 'FFF', 'FRFF'),
]
KINDS = {(table, kind): links for table, kind, links in SHIPPED}
# The book's joint angles at the start (tables 5.1 to 5.4, 6.1), closed to nine digits.
_THIRD = 1.00069288 + np.pi / 6 - 0.785394774 + 0.4211674  # the platform's X is at alpha + 30 deg
START = {
    'four_bar': np.deg2rad([0.0, 81.08320375, 130.54160187]),
    'five_bar': np.deg2rad([108.0, -72.0, 72.0, 72.0]),
    'planar_3dof': np.array(
        [0.785394774, -0.4211674, _THIRD, 2.35611582, -1.00747903, 3.92699724, 2.65334062]
    ),
    'rssr': np.array([2.094529, -3.93956514, 0.181833462, 0.0]),
}


def mechanism(table: str, kind: str, modes: int = 2, shape: str = 'clamped-free') -> str:
    """URDF text of a mechanism of the book; its kind is spelled as there."""
    system = load_system(CONFIG / 'dh' / f'{table}.yaml', kinds=KINDS[table, kind])
    text: str = urdf_text(replace(system, modes=modes, shape=shape))
    return text
