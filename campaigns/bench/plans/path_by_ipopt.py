"""Least times along a path against IPOPT's: `python -m campaigns ipopt-path [NAME ...]`.

Both have the same model, path of the tip, torque limits and further limits, and the same time
before and after in which the joints move while the tip stands. The peer's torques are free at its
points, and the acceleration along the path; its tip is as exact as its collocation.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from bench.plans.rest_by_ipopt import EFFORT, EI, TWO, arm_of
from control_runs import cycloid
from ipopt_path import PathBeams
from scipy.interpolate import make_interp_spline

import denoc_ros as dn
from denoc_ros.planning.timing.limit_rows import LimitRows, motion_limits

FIRST, LAST = np.array([0.3, 0.6]), np.array([0.8, 1.1])
# curvature at most, and intervals, with which the peer nearly keeps its limits between its points;
# a straight arm that bends could not reach its path
PROBLEMS = {'path': (np.inf, (84, 120)), 'path_strain': (0.06, (21, 35))}
TIMES = np.linspace(0.0, 1.0, 201)
PIECES = 56  # of our timing
FINE, STEP = 1201, 0.001  # moments of its timing, and s between the nodes of its motion
BEYOND = 1.01


def compare(name: str) -> None:
    """Print the least times of a problem, and the ratio."""
    robot, (curvature, meshes) = arm_of(TWO), PROBLEMS[name]
    efforts = dict(zip(robot.joint_names, EFFORT, strict=True))
    moment = None if np.isinf(curvature) else EI * curvature
    began = time.process_time()
    plan = dn.shape_motion(
        robot,
        TIMES,
        cycloid(FIRST, LAST, 1.0)(TIMES),
        time='minimum',
        pieces=PIECES,
        turn=0.0,
        effort=efforts,
        moment=moment,
    )
    took = time.process_time() - began
    assert plan.limits is not None
    print(
        f'{name}: {plan.stretch:.5f} s, {plan.preaction:.3f} s before, {plan.postaction:.3f} s '
        f'after, largest share {max(plan.limits.largest.values()):.4f}, tip '
        f'{1e3 * plan.tip_error.max():.4f} mm, processor time {took:.1f} s',
        flush=True,
    )
    assert plan.passed is not None
    share = cycloid(np.zeros(1), np.ones(1), 1.0)(plan.passed)
    known = make_interp_spline(plan.t, np.concatenate([plan.q, share], axis=1), k=3)
    windows = plan.preaction, plan.postaction
    problem = PathBeams(TWO, FIRST, LAST, EFFORT, 2 * TWO.links, curvature, windows=windows)
    for mesh in meshes:
        try:
            least, place = problem.along(known, plan.stretch, mesh)
        except RuntimeError as error:
            print(f'{name}: IPOPT, {mesh} intervals: {error}', flush=True)
            continue
        over = 100.0 * (plan.stretch / least - 1.0)
        print(f'{name}: IPOPT, {mesh} intervals: {least:.5f} s; {over:+.2f} %', flush=True)
        times = np.linspace(0.0, least, FINE)
        way = np.clip(place(times), 0.0, 1.0)[:, None]
        exact = dn.shape_motion(
            robot,
            times,
            FIRST + way * (LAST - FIRST),
            turn=0.0,
            effort=np.inf,
            velocity=np.inf,
            step=STEP,
            preaction=plan.preaction,
            postaction=plan.postaction,
        )
        limits = motion_limits(robot, {'effort': efforts}, {'moment': moment})
        shares = LimitRows(robot, robot.joint_indices, (), limits).use(exact).shares.max(axis=1)
        beyond = 1e3 * float(np.mean(shares > BEYOND) * np.ptp(exact.t))
        print(
            f'  between its points, with its timing: up to {shares.max():.3f} of a limit, beyond '
            f'{BEYOND:g} of it in {beyond:.0f} ms',
            flush=True,
        )


if __name__ == '__main__':
    for each in sys.argv[1:] or PROBLEMS:
        compare(each)
