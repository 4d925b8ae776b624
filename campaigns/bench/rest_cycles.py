"""Cycle time and swing that is left: plain motion, input shapers and minimum time.

All at the same limits: `python -m bench.rest_cycles [two_link | panda]`.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from control_runs import ROBOTS
from shaped_runs import cycloid, swing_after

import denoc_ros as dn
from denoc_ros.control.ringing import ringing_modes
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError
from denoc_ros.types import Array


def fastest_shaped(robot: Robot, ends: Array, method: str, limits: dict[str, Any]) -> Any:
    """Return the shortest cycloid through a shaper within the limits, to 1 %, as a plan."""
    below, above, best = 0.02, 4.0, None
    while above > 1.01 * below:
        middle = float(np.sqrt(below * above))
        t = np.linspace(0.0, middle, 201)
        q = ends[0] + (ends[1] - ends[0]) * cycloid(t, middle)[:, None]
        try:
            best, above = dn.shape_motion(robot, t, q, method, **limits), middle
        except SolverError:
            below = middle
    return best


def table(
    name: str, robot: Robot, ends: Array, tip: str, limits: dict[str, Any], T: float
) -> None:
    """Print cycle times and swings of all methods; T is the plain motion's duration [s]."""
    joints = robot.joint_indices
    t = np.linspace(0.0, T, 221)
    q = ends[0] + (ends[1] - ends[0]) * cycloid(t, T)[:, None]
    plain = swing_after(robot, t, q, tip)
    print(f'{name}, plain: {T:.3f} s, swing {1e3 * plain:.2f} mm', flush=True)
    resting = len(ringing_modes(robot, ends[1]).frequencies)
    for modes in dict.fromkeys((resting, len(robot.flexible_indices))):
        began = time.process_time()
        plan = dn.shape_motion(robot, t, q, 'rest_to_rest', time='minimum', modes=modes, **limits)
        took = time.process_time() - began
        left = swing_after(robot, plan.t, plan.q[:, joints], tip)
        assert plan.limits is not None
        print(
            f'{name}, minimum time, {modes} modes at rest: {plan.t[-1]:.3f} s, swing '
            f'{100.0 * left / plain:.3f} %, largest share '
            f'{max(plan.limits.largest.values()):.4f}, processor time {took:.1f} s',
            flush=True,
        )
    for method in ('zv', 'zvd'):
        shaped = fastest_shaped(robot, ends, method, limits)
        if shaped is None:
            print(f'{name}, {method}: none within the limits')
            continue
        left = swing_after(robot, shaped.t, shaped.q[:, joints], tip)
        print(
            f'{name}, {method}: {shaped.t[-1] - shaped.t[0]:.3f} s, swing '
            f'{100.0 * left / plain:.2f} %',
            flush=True,
        )


def main(names: list[str]) -> None:
    """Print the tables."""
    if 'two_link' in names:
        robot = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, 0, 0))
        table('two_link', robot, np.array([[0.0, 0.0], [0.5, 0.5]]), 'tool', {}, 0.6)
    if 'panda' in names:
        from panda_strip import ACCELERATION, DURATION, JERK, panda_strip, plain_motion

        robot = panda_strip()
        _, q = plain_motion(robot)
        limits = {'acceleration': ACCELERATION, 'jerk': JERK}
        table('panda', robot, q[[0, -1]], 'strip_tip', limits, DURATION)


if __name__ == '__main__':
    main(sys.argv[1:] or ['two_link', 'panda'])
