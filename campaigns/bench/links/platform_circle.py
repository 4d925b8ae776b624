"""Figures 5.65 to 5.68: the three-legged manipulator on a circle, legs rigid and flexible.

python -m campaigns circle docs/platform_circle.png
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from book_runs import desired, joints, shipped

from denoc_ros.simulation.reference_motion import Circle
from denoc_ros.types import Array

SCENARIO = 'planar_3dof_circle'
CIRCLE = Circle('tool', np.array([0.25, 0.1443, 0.0]), 0.06, 1.0)
LEGS = ('11', '12', '13'), ('21', '22', '23')


@dataclass(frozen=True)
class Tracking:
    """A run on the circle: times (k,), joints (k, 7) meant and reached, errors (k, 2) [m]."""

    t: Array
    meant: Array
    reached: Array
    error: Array
    names: tuple[str, ...]


def track(robot_name: str) -> Tracking:
    """Run the scenario with a robot."""
    robot, scenario = shipped(robot_name, SCENARIO)
    run = scenario.run(robot)
    place = np.array([robot.frame_pose('tool', q)[:2, 3] for q in run.q])
    wanted = np.array([CIRCLE.sample(float(t))[0][:2] for t in run.t])
    return Tracking(
        run.t, desired(scenario), joints(robot, run), place - wanted, robot.joint_names
    )


def draw(rigid: Tracking, flexible: Tracking, path: str) -> None:
    """Write the picture."""
    mpl.use('Agg')
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True, constrained_layout=True)
    for axis, numbers in zip(axes[0], LEGS, strict=True):
        for number in numbers:
            column = rigid.names.index(f'joint_{number}')
            line = axis.plot(rigid.t, rigid.reached[:, column], '--', lw=2.5, alpha=0.5)
            axis.plot(
                flexible.t, flexible.reached[:, column], color=line[0].get_color(), lw=1,
                label=f'joint_{number}',
            )  # fmt: skip
        axis.set_ylabel('rad')
        axis.legend(title='dashed: 3RR, line: 3FF', fontsize=8, title_fontsize=8)
    for axis, name, column in zip(axes[1], 'xy', (0, 1), strict=True):
        axis.plot(rigid.t, 1e3 * rigid.error[:, column], '--', label='3RR')
        axis.plot(flexible.t, 1e3 * flexible.error[:, column], lw=1, label='3FF')
        axis.set_ylabel(f'error of the platform in {name} [mm]')
        axis.set_xlabel('s')
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=90)


def main() -> None:
    """Run both, draw, and print the largest errors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('picture')
    args = parser.parse_args()
    rigid, flexible = track('planar_3dof_3rr'), track('planar_3dof_3ff')
    draw(rigid, flexible, args.picture)
    for name, run in (('3RR', rigid), ('3FF', flexible)):
        strayed = np.max(np.abs(run.reached - run.meant), axis=0)
        print(name, 'platform [m]', np.max(np.abs(run.error), axis=0), 'joints [rad]', strayed)


if __name__ == '__main__':
    main()
