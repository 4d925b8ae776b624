"""Cycle time and swing that is left: plain motion, input shapers and minimum time.

All at the same limits: `python -m campaigns rests [two_link | panda | canadarm | ssrms]`. Of the
arms in space what binds as well, and the swing of a plant of eight segments a link.
"""

from __future__ import annotations

import re
import sys
import time
from collections import Counter
from typing import Any

import numpy as np
from control_runs import ROBOTS
from shaped_runs import cycloid, swing_after

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError
from denoc_ros.planning.shapers.ringing import ringing_modes
from denoc_ros.types import Array

FINE = 1e-4  # s: steps of simulated swings


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
    plain = swing_after(robot, t, q, tip, step=FINE)
    print(f'{name}, plain: {T:.3f} s, swing {1e3 * plain:.2f} mm', flush=True)
    resting = len(ringing_modes(robot, ends[1]).frequencies)
    for modes in dict.fromkeys((resting, len(robot.flexible_indices))):
        began = time.process_time()
        plan = dn.shape_motion(robot, t, q, 'rest_to_rest', time='minimum', modes=modes, **limits)
        took = time.process_time() - began
        left = swing_after(robot, plan.t, plan.q[:, joints], tip, step=FINE)
        assert plan.limits is not None
        print(
            f'{name}, minimum time, {modes} modes at rest: {plan.t[-1]:.3f} s, swing '
            f'{100.0 * left / plain:.3f} %, largest share '
            f'{max(plan.limits.largest.values()):.4f}, processor time {took:.1f} s',
            flush=True,
        )
        print_binding(plan)
    for method in ('zv', 'zvd'):
        shaped = fastest_shaped(robot, ends, method, limits)
        if shaped is None:
            print(f'{name}, {method}: none within the limits')
            continue
        left = swing_after(robot, shaped.t, shaped.q[:, joints], tip, step=FINE)
        print(
            f'{name}, {method}: {shaped.t[-1] - shaped.t[0]:.3f} s, swing '
            f'{100.0 * left / plain:.2f} %',
            flush=True,
        )


def print_binding(plan: dn.Plan) -> None:
    """Print how long each limit binds, and by how much 1 % more of it shortens the motion."""
    assert plan.limits is not None
    for what, count in Counter(plan.limits.binding()).most_common():
        gain = 100.0 * plan.limits.gains.get(what, 0.0)
        print(f'  {what or "nothing"} {100 * count / len(plan.t):.0f} %; 1 % more: {gain:.2f} %')


ARMS: dict[str, tuple[Array, Array]] = {  # ends, and efforts
    'canadarm': (
        np.radians([[10.0, 40.0, 30.0], [70.0, 85.0, 60.0]]),
        np.array([1500.0, 700.0, 180.0]),
    ),
    'ssrms': (
        np.array([[0.2, 0.5, -0.9, 0.4, 0.3, 0.2], [0.7, 1.0, -0.4, 0.9, 0.8, 0.7]]),
        np.array([1000.0, 1000.0, 1000.0, 200.0, 200.0, 200.0]),
    ),
}
WATCH = 6.0  # s


def space_arm(name: str) -> None:
    """Print the least time of an arm, what binds, and what a richer plant swings after it."""
    text = (ROBOTS / f'{name}.urdf').read_text()
    robot = dn.load_robot(text, gravity=(0, 0, 0))
    divided = re.sub(r'(<beam [^>]*)shape="[^"]*"', r'\1segments="8"', text)
    rich = dn.load_robot(divided, gravity=(0, 0, 0))
    ends, effort = ARMS[name]
    began = time.process_time()
    plan = dn.shape_motion(robot, [0, 10], ends, 'rest_to_rest', time='minimum', effort=effort)
    took = time.process_time() - began
    assert plan.limits is not None
    print(f'{name}: {plan.t[-1]:.3f} s, processor time {took:.1f} s', flush=True)
    print_binding(plan)
    rows = slice(None, None, 4)
    t = plan.t[rows]
    t, q = np.linspace(t[0], plan.t[-1], len(t)), plan.q[:, robot.joint_indices]
    q = np.array([np.interp(t, plan.t, column) for column in q.T]).T
    tip = robot.frame_names[-1]
    plain = ends[0] + (ends[1] - ends[0]) * cycloid(t, t[-1])[:, None]
    left, swing = (swing_after(rich, t, each, tip, WATCH) for each in (q, plain))
    print(
        f'  eight segments, joints on the plan: swing {1e3 * left:.2f} mm, of a cycloid in this '
        f'time {1e3 * swing:.0f} mm',
        flush=True,
    )


def main(names: list[str]) -> None:
    """Print the tables."""
    if 'two_link' in names:
        robot = dn.load_robot(ROBOTS / 'two_link_ff.urdf', gravity=(0, 0, 0))
        table('two_link', robot, np.array([[0.0, 0.0], [0.5, 0.5]]), 'tool', {}, 0.6)
    for name in ARMS:
        if name in names:
            space_arm(name)
    if 'panda' in names:
        from panda_strip import ACCELERATION, DURATION, JERK, panda_strip, plain_motion

        robot = panda_strip()
        _, q = plain_motion(robot)
        limits = {'acceleration': ACCELERATION, 'jerk': JERK}
        table('panda', robot, q[[0, -1]], 'strip_tip', limits, DURATION)


if __name__ == '__main__':
    main(sys.argv[1:] or ['two_link', *ARMS, 'panda'])
