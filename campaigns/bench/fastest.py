"""Motions in minimum time against a single factor, and rigid ones against TOPP-RA.

Prints tables: `python -m bench.fastest [PATHS] [ROBOT ...]`.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from control_runs import ROBOTS, cycloid
from timed_paths import SHARES, rigid_arm

import denoc_ros as dn
from denoc_ros.control.limit_rows import LimitRows, motion_limits

SHARE = 0.8  # of the torques and moments that the motion as it was asked for needs
STARTS = {
    'canadarm': (10.0, np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0])),
    'ssrms': (20.0, np.array([0.2, 0.5, -0.9, 0.4, 0.3, 0.2]), np.full(6, 0.5)),
}


def flexible(name: str, paths: int) -> None:
    """Print each path's duration by one factor and with a free timing, and what binds."""
    duration, start, way = STARTS[name]
    robot = dn.load_robot(ROBOTS / f'{name}.urdf', gravity=(0, 0, 0))
    times = np.linspace(0.0, duration, 201)
    links = sorted({body.link for body in robot.tree.bodies if body.beam is not None})
    unit = motion_limits(robot, {}, {'moment': 1.0})
    saved = []
    for seed in range(paths):
        random = np.random.default_rng(seed)
        first = start + (random.uniform(-0.3, 0.3, len(start)) if seed else 0.0)
        by = way * (random.uniform(0.5, 1.1, len(way)) if seed else 1.0)
        joints = cycloid(first, first + by, duration)(times)
        asked = dn.shape_motion(robot, times, joints)
        rows = LimitRows(robot, robot.joint_indices, (), unit)
        moments = rows.use(asked).largest
        limits: dict[str, Any] = {
            'effort': dict(
                zip(asked.joint_names, SHARE * np.abs(asked.torque).max(axis=0), strict=True)
            ),
            'moment': {
                link: SHARE * moments[f'moment {link}']
                for link in links
                if moments[f'moment {link}'] > 1e-3
            },
        }
        single = dn.shape_motion(robot, times, joints, **limits)
        began = time.process_time()
        plan = dn.shape_motion(robot, times, joints, time='minimum', **limits)
        took = time.process_time() - began
        assert plan.limits is not None
        saved.append(1.0 - plan.stretch / single.stretch)
        print(
            f'{name} {seed}: {duration * single.stretch:.3f} -> {duration * plan.stretch:.3f} s, '
            f'{100.0 * saved[-1]:.1f} % less; largest share '
            f'{max(plan.limits.largest.values()):.4f}, tip {1e3 * plan.tip_error.max():.4f} mm, '
            f'processor time {100.0 * took / (duration * plan.stretch):.0f} %',
            flush=True,
        )
    print(f'{name}: median {100.0 * np.median(saved):.1f} % less')


def rigid(name: str, paths: int) -> None:
    """Print the ratio of durations to TOPP-RA's, without friction and with it."""
    for friction in (False, True):
        arm = rigid_arm(name, friction)
        plans = [arm.fastest(seed) for seed in range(paths)]
        ratios = [plan.t[-1] / arm.toppra_duration(seed) for seed, plan in enumerate(plans)]
        worst = max(arm.largest_share(plan) for plan in plans)
        print(
            f'{name}, {paths} paths, {"with" if friction else "without"} friction, over TOPP-RA: '
            f'median {np.median(ratios):.4f}, {min(ratios):.4f} to {max(ratios):.4f}; largest '
            f"share of a limit by Pinocchio's torques {worst:.4f}",
            flush=True,
        )


if __name__ == '__main__':
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for each in sys.argv[2:] or (*SHARES, *STARTS):
        if each in SHARES:
            rigid(each, count)
        else:
            flexible(each, count)
