"""Motions in minimum time against a single factor, and rigid ones against TOPP-RA.

Prints tables: `python -m campaigns fastest [PATHS] [ROBOT ...]`; the robot `nodes` stands for the
processor time of searches on ever finer grids.
"""

from __future__ import annotations

import sys
import time
from typing import Any
from xml.etree import ElementTree

import numpy as np
from control_runs import ROBOTS, cycloid
from timed_paths import SHARES, rigid_arm

import denoc_ros as dn
from denoc_ros.export.dh_system import read_system
from denoc_ros.export.dh_verb import urdf_text
from denoc_ros.planning.timing.limit_rows import LimitRows, motion_limits
from denoc_ros.types import Array

LEAST = 1e-9  # a strain that a link has at all
SURFACE = 0.14  # m: the outer fibre of the arms' booms
HURRIED = 0.8  # of its time, so that each path is beyond the limits
SHARE = 0.8  # of the torques and strains that the motion as it was asked for needs
STEPS, REPEATS = (0.16, 0.08, 0.04, 0.02), 3
STARTS = {
    'canadarm': (10.0, np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0])),
    'ssrms': (20.0, np.array([0.2, 0.5, -0.9, 0.4, 0.3, 0.2]), np.full(6, 0.5)),
    'seven': (20.0, np.array([0.2, 0.3, 0.5, -0.9, 0.4, 0.3, 0.2]), np.full(7, 0.5)),
}
SEVEN = {  # joints, each of whose links bends in two modes, as the SSRMS with one joint more
    'dh': {
        'a': [1.0, 1.0, 6.0, 7.0, 1.0, 1.0, 1.0],
        'b': [0.0] * 7,
        'alpha_over_pi': [0.5, -0.5, 0.0, 0.5, -0.5, 0.5, 0.0],
    },
    'm': [47.5, 47.5, 140.0, 85.0, 47.5, 47.5, 47.5],
    'EI': [1e5] * 7,
    'modes': 1,  # in either direction
    'shape': 'clamped-free',
    'armature': [300.0, 300.0, 300.0, 150.0, 20.0, 20.0, 20.0],
    'damping_ratio': 0.005,
    'limits': {'effort': 5000.0, 'velocity': 1.0, 'lower': -6.0, 'upper': 6.0},
}


def flexible(name: str, paths: int, own: bool) -> None:
    """Print each path's duration by one factor and with a free timing, and how much is possible.

    The limits are those of the first path; with `own` each path has some of its own, so that
    every limit binds at the same pace. What is possible is less than what the same arm saves
    with stiff links and torques alone, which may jump.
    """
    robot, stiff = (
        dn.load_robot(_description(name, bends), gravity=(0, 0, 0)) for bends in (True, False)
    )
    fixed = None if own else _limits(robot, *_path(name, 0, 1.0))
    saved, possible, efforts = [], [], []
    for seed in range(paths):
        times, joints = _path(name, seed, 1.0 if own else HURRIED)
        limits = fixed or _limits(robot, times, joints)
        single = dn.shape_motion(robot, times, joints, **limits)
        began = time.process_time()
        plan = dn.shape_motion(robot, times, joints, time='minimum', **limits)
        took = time.process_time() - began
        rigid = dn.shape_motion(stiff, times, joints, time='minimum', effort=limits['effort'])
        assert plan.limits is not None
        duration = times[-1] * plan.stretch
        saved.append(100.0 * (1.0 - plan.stretch / single.stretch))
        possible.append(100.0 * (1.0 - rigid.stretch / single.stretch))
        efforts.append(100.0 * took / duration)
        print(
            f'{name} {seed}: {times[-1] * single.stretch:.3f} -> {duration:.3f} s, '
            f'{saved[-1]:.1f} % less (stiff {possible[-1]:.1f} %); largest shares '
            f'{_largest(plan, "effort"):.4f} of effort, {_largest(plan, "strain"):.4f} of strain, '
            f'{max(plan.limits.largest.values()):.4f} of all, '
            f'tip {1e3 * plan.tip_error.max():.4f} mm, '
            f'processor time {efforts[-1]:.0f} %',
            flush=True,
        )
    whose = "each path's" if own else "the arm's"
    print(
        f'{name}, {whose} limits, {paths} paths: median {np.median(saved):.1f} % less (stiff '
        f'{np.median(possible):.1f} %), processor time {np.median(efforts):.0f} % in the median'
    )


def growth(name: str) -> None:
    """Print the processor time of searches on ever finer grids."""
    robot = dn.load_robot(_description(name, True), gravity=(0, 0, 0))
    times, joints = _path(name, 0, 1.0)
    limits = _limits(robot, times, joints)
    for step in STEPS:
        took = []
        for _ in range(REPEATS):
            began = time.process_time()
            plan = dn.shape_motion(robot, times, joints, time='minimum', step=step, **limits)
            took.append(time.process_time() - began)
        nodes = round(float(plan.t[-1] - plan.t[0]) / step)
        print(
            f'{name}: {nodes} nodes, {plan.stretch * times[-1]:.3f} s, processor time '
            f'{np.median(took):.2f} s, {1e3 * np.median(took) / nodes:.2f} ms a node',
            flush=True,
        )


def _path(name: str, seed: int, share: float) -> tuple[Array, Array]:
    """Return times and joints of a path, in a share of the time that suits its length."""
    duration, start, way = STARTS[name]
    random = np.random.default_rng(seed)
    first = start + (random.uniform(-0.3, 0.3, len(start)) if seed else 0.0)
    by = way * (random.uniform(0.5, 1.1, len(way)) if seed else 1.0)
    duration *= share
    times = np.linspace(0.0, duration, 201)
    return times, cycloid(first, first + by, duration)(times)


def _limits(robot: dn.Robot, times: Array, joints: Array) -> dict[str, Any]:
    """Return a share of the torques and strains that a motion needs."""
    asked = dn.shape_motion(robot, times, joints)
    rows = LimitRows(robot, robot.joint_indices, (), motion_limits(robot, {}, {'strain': 1.0}))
    largest = rows.use(asked).largest
    strains = {name.split()[1]: value for name, value in largest.items() if 'strain' in name}
    efforts = SHARE * np.abs(asked.torque).max(axis=0)
    return {
        'effort': dict(zip(asked.joint_names, efforts, strict=True)),
        'strain': {link: SHARE * value for link, value in strains.items() if value > LEAST},
    }


def _largest(plan: dn.Plan, what: str) -> float:
    """Return the largest share of all limits of a kind."""
    assert plan.limits is not None
    largest: dict[str, float] = dict(plan.limits.largest)
    return max(v for name, v in largest.items() if name.startswith(f'{what} '))


def _description(name: str, bends: bool) -> str:
    """Return the URDF with the surface of its beams, or without flexibility."""
    if name == 'seven':
        text = urdf_text(read_system(name, name, SEVEN))
    else:
        text = (ROBOTS / f'{name}.urdf').read_text()
    root = ElementTree.fromstring(text.encode())
    for each in root.findall('flexibility'):
        for beam in each.findall('beam'):
            beam.set('surface', str(SURFACE))
        if not bends:
            root.remove(each)
    return ElementTree.tostring(root, encoding='unicode')


def rigid(name: str, paths: int) -> None:
    """Print the ratio of durations to TOPP-RA's, without friction and with it."""
    for friction in (False, True):
        arm = rigid_arm(name, friction)
        ratios, shares = [], []
        for seed in range(paths):
            plan = arm.fastest(seed)
            ratios.append(plan.t[-1] / arm.toppra_duration(seed))
            shares.append(arm.largest_share(plan))
            print(f'{name} {seed}: {ratios[-1]:.4f} of the time by TOPP-RA', flush=True)
        known = [ratio for ratio in ratios if ratio > 0.0]
        print(
            f'{name}, {paths} paths, {"with" if friction else "without"} friction, over TOPP-RA: '
            f'median {np.median(known):.4f}, {min(known):.4f} to {max(known):.4f}; largest '
            f"share of a limit by Pinocchio's torques {max(shares):.4f}; TOPP-RA found none of "
            f'{paths - len(known)} paths',
            flush=True,
        )


if __name__ == '__main__':
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for each in sys.argv[2:] or (*SHARES, *STARTS, 'nodes'):
        if each in SHARES:
            rigid(each, count)
        elif each == 'nodes':
            growth('ssrms')
        else:
            for own in (False, True):
                flexible(each, count, own)
