"""Runs of the book's mechanisms, and what of them stands in the reference solutions' columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mechanisms import CONFIG, DOWN, START, mechanism

import denoc_ros as dn
from denoc_ros.cli.session.session_config import read_yaml
from denoc_ros.export.dh_system import read_system
from denoc_ros.export.dh_verb import urdf_text
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array

# Reference column of a joint angle -> our joint, of a tip deflection -> our link and direction.
ANGLES = {
    'planar_3dof': {f'th{link}{leg}': f'joint_{link}{leg}' for leg in '123' for link in '12'},
    'four_bar': {f'th{k}': f'joint_{k}' for k in range(1, 4)},
    'five_bar': {f'th{k}': f'joint_{k}' for k in range(1, 5)},
    'rssr': {f'th{k}': f'joint_{k}' for k in range(1, 5)},
}
DEFLECTIONS = {
    'four_bar_RRF': {'v3': ('link_3', 1)},
    'five_bar_RFFR': {'v2': ('link_2', 1), 'v4': ('link_4', 1)},
    'planar_3dof_3RF': {f'v2{leg}': (f'link_2{leg}', 1) for leg in '123'},
    'rssr_RRF': {'v1y': ('link_1', 1), 'v1z': ('link_1', 2)},
}


def loaded(table: str, kind: str, modes: int = 2, shape: str = 'clamped-free') -> dn.Robot:
    """A mechanism with shapes of choice, gravity as in the book."""
    return dn.load_robot(mechanism(table, kind, modes, shape), gravity=DOWN)


def closed_start(robot: dn.Robot, joints: Sequence[float] | Array) -> Array:
    """A closed configuration near joint angles, undeformed."""
    q = np.zeros(robot.n)
    q[robot.joint_indices] = joints
    return robot.assemble(q)


def fall(robot: dn.Robot, joints: Sequence[float] | Array, times: Array, **options: Any) -> Run:
    """Free fall from rest."""
    q = closed_start(robot, joints)
    return dn.simulate(robot, q, np.zeros(robot.n), times, **options)


def book_fall(robot: dn.Robot, table: str, times: Array, **options: Any) -> Run:
    """Free fall from the book's start."""
    return fall(robot, START[table], times, **options)


def columns(robot: dn.Robot, run: Run, table: str, kind: str) -> dict[str, Array]:
    """A run's joint angles and deflections by the reference's names."""
    found = {name: run.coordinate(joint) for name, joint in ANGLES[table].items()}
    for name, (link, axis) in DEFLECTIONS.get(f'{table}_{kind}', {}).items():
        found[name] = robot.tip_deflection(link, run.q)[:, axis]
    return found


def gaps(got: dict[str, Array], table: dict[str, Array]) -> tuple[float, float]:
    """Largest differences of angles [rad], and of deflections over their peak."""
    angle = deflection = 0.0
    for name, values in got.items():
        expected = table[name][: len(values)]
        gap = float(np.max(np.abs(values - expected)))
        if name.startswith('th'):
            angle = max(angle, gap)
        else:
            deflection = max(deflection, gap / float(np.max(np.abs(table[name]))))
    return angle, deflection


def cut_four_bar(
    joint: int, kinds: str = 'RRR', modes: int = 2, shape: str = 'clamped-free'
) -> tuple[dn.Robot, Array]:
    """The four-bar opened at joint 2, 3 or 4, and its start: links crank, coupler, rocker.

    The tree differs and with it where links are rooted; 4 is the book's cut.
    """
    table = read_yaml(CONFIG / 'dh' / 'four_bar.yaml')
    rods = [dict(rod) for chain in table['chains'] for rod in chain['links']]
    for name, rod, kind in zip(('crank', 'coupler', 'rocker'), rods, kinds, strict=True):
        rod['name'] = name
        rod.update({'EI': 1570.7963267948967} if kind == 'F' else {})
    crank, coupler, rocker = rods
    left, right = {'base': [0.0, 0.0]}, {'base': [1.5, 0.0]}
    trees: dict[int, list[dict[str, Any]]] = {
        2: [{**left, 'links': [crank]}, {**right, 'links': [rocker, coupler]}],
        3: [{**left, 'links': [crank, coupler, rocker]}],
        4: [{**left, 'links': [crank, coupler]}, {**right, 'links': [rocker]}],
    }
    chains = trees[joint]
    ends: dict[int, tuple[Any, Any]] = {
        2: ('crank', 'coupler'),
        3: ({'link': 'base', 'at': right['base']}, 'rocker'),
        4: ('coupler', 'rocker'),
    }
    parent, child = ends[joint]
    loop = {'name': f'cut_{joint}', 'type': 'revolute', 'parent': parent, 'child': child}
    letters = ''.join('F' if 'EI' in rod else 'R' for chain in chains for rod in chain['links'])
    system = {
        'planar': True,
        'chains': chains,
        'loops': [loop],
        'modes': modes,
        'shape': shape,
        'kinds': letters,
    }
    robot = dn.load_robot(urdf_text(read_system('cut', f'cut_{joint}', system)), gravity=DOWN)
    one, two, three = START['four_bar']
    start = {
        2: [one, three, one + two - np.pi - three],
        3: [one, two, three - np.pi - one - two],
        4: [one, two, three],
    }[joint]
    return robot, closed_start(robot, start)
