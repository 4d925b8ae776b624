"""A spacecraft that reacts to its arm.

The Canadarm on a free spacecraft of 10 t moves its joints and stops. The spacecraft turns
with it; linear and angular momentum stay zero, whatever the links do.
"""

import matplotlib.pyplot as plt
import numpy as np

import denoc_ros as dn

robot = dn.load_robot('config/robots/canadarm_10t.urdf', gravity=(0, 0, 0))
t = np.linspace(0, 15, 301)


def motion(time, start, way):  # of a joint: smooth, in 10 s
    s, w = min(time / 10, 1), 2 * np.pi
    return (
        start + way * (s - np.sin(w * s) / w),
        way / 10 * (1 - np.cos(w * s)),
        way / 100 * w * np.sin(w * s),
    )


joints = [name for name in robot.joint_names if name.startswith('joint')]
prescribed = {name: lambda time: motion(time, 0.3, 0.7) for name in joints}
q0 = np.zeros(robot.n)
q0[[robot.coordinate_names.index(name) for name in joints]] = 0.3
run = dn.simulate(robot, q0, np.zeros(robot.n), t, prescribed=prescribed)
assert np.abs(robot.momentum(run.q, run.qd)).max() < 1e-4 * 10e3

plt.plot(t, np.degrees(run.q[:, robot.base_indices[5]]), label='spacecraft')
plt.plot(t, np.degrees(run.coordinate(joints[0]) - 0.3), label=joints[0])
plt.xlabel('time [s]')
plt.ylabel('turned by [°]')
plt.legend()
