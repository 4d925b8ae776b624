"""A closed mechanism that falls.

The five-bar with four flexible links falls from a closed configuration. Its loop stays
closed while its links bend.
"""

import matplotlib.pyplot as plt
import numpy as np

import denoc_ros as dn

robot = dn.load_robot('config/robots/five_bar_ffff.urdf', gravity=(0, -9.81, 0))
guess = np.zeros(robot.n)
guess[list(robot.joint_indices)] = np.radians([108, -72, 72, 72])
start = robot.assemble(guess)
run = dn.simulate(robot, start, np.zeros(robot.n), np.linspace(0, 0.8, 161))
assert max(np.abs(robot.closure(q)).max() for q in run.q) < 1e-8

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4))
links = [name.split('/')[0] for name in robot.coordinate_names if name.endswith('/y1')]
for instant in (0, 60, 120, 160):
    points = [robot.frame_pose(link, run.q[instant])[:2, 3] for link in links]
    left.plot(*np.array(points).T, 'o-', label=f'{run.t[instant]:.1f} s')
left.set(xlabel='x [m]', ylabel='y [m]', aspect='equal')
left.legend()
for link in links:
    right.plot(run.t, [1e3 * robot.tip_deflection(link, q)[1] for q in run.q], label=link)
right.set(xlabel='time [s]', ylabel='deflection [mm]')
right.legend()
