"""Least times from rest to rest against IPOPT's: `python -m campaigns ipopt-rest [NAME ...]`.

Both have the same model, torque limits, terminal condition (the modes that rest by default) and
further limits; the peer has free torques at its collocation points, on two meshes.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from control_runs import ROBOTS
from ipopt_rest import Beams, RestBeams
from planar_chains import FLEXIBLE, planar_chain

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

MODES = 2  # that rest
RADIUS = 0.05  # m
MESHES = 14, 21  # intervals
EI = 1000.0  # N m^2, of all links
ONE = Beams(1, 1.0, 5.0, EI, armature=0.2)
TWO = Beams(2, 1.0, 5.0, EI, armature=0.5)
HEAVY = Beams(2, 1.0, 5.0, EI, armature=0.5, gravity=-9.81)
WAY = np.array([[0.0, 0.0], [0.5, 0.5]])
EFFORT = np.array([100.0, 40.0])
VIA = np.array([0.6, 0.6])
# arm, ends, efforts, the rest
PROBLEMS: dict[str, tuple[Beams, Array, Array, dict[str, Any]]] = {
    'one_link': (ONE, np.array([[0.0], [0.2]]), np.array([100.0]), {}),
    'two_links': (TWO, WAY, EFFORT, {}),
    'gravity': (HEAVY, np.array([[0.3, 0.6], [1.1, 1.4]]), np.array([200.0, 60.0]), {}),
    'waypoint': (TWO, WAY, EFFORT, {'via': VIA}),
    'strain': (TWO, WAY, EFFORT, {'curvature': 0.06}),
}


def arm_of(beams: Beams) -> Robot:
    """Return the robot of a problem."""
    file = planar_chain((FLEXIBLE,)) if beams.links == 1 else ROBOTS / 'two_link_ff.urdf'
    robot = dn.load_robot(file, gravity=(0, beams.gravity, 0))
    return robot.with_overrides({
        f'joint.{name}.armature': beams.armature for name in robot.joint_names
    })  # fmt: skip


def compare(name: str) -> None:
    """Print the least times of a problem, and the ratio."""
    beams, ends, effort, more = PROBLEMS[name]
    robot = arm_of(beams)
    efforts = dict(zip(robot.joint_names, effort, strict=True))
    options: dict[str, Any] = {'modes': MODES, 'effort': efforts}
    theirs: dict[str, Any] = {}
    if 'via' in more:
        options.update(waypoints=[more['via']], radius=RADIUS)
        q = np.zeros(robot.n)
        q[robot.joint_indices] = more['via']
        theirs.update(via=robot.frame_pose('tool', q)[:2, 3], radius=RADIUS)
    if 'curvature' in more:
        options['moment'] = EI * more['curvature']
        theirs['curvature'] = more['curvature']
    times = np.array([0.0, 1.0])
    began = time.process_time()
    plan = dn.shape_motion(robot, times, ends, 'rest_to_rest', time='minimum', **options)
    took = time.process_time() - began
    assert plan.limits is not None
    print(
        f'{name}: {plan.t[-1]:.5f} s, largest share {max(plan.limits.largest.values()):.4f}, '
        f'processor time {took:.1f} s',
        flush=True,
    )
    problem = RestBeams(beams, ends[0], ends[1], effort, MODES, **theirs)
    for mesh in MESHES:
        least = problem.shortest(1.2 * float(plan.t[-1]), mesh, more.get('via'))
        over = 100.0 * (plan.t[-1] / least - 1.0)
        print(f'{name}: IPOPT, {mesh} intervals: {least:.5f} s; {over:+.2f} %', flush=True)


if __name__ == '__main__':
    for each in sys.argv[1:] or PROBLEMS:
        compare(each)
