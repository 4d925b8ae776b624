"""Frequency responses of an arm.

From the torque of a joint to that joint and to the tool: each peak is a mode, each notch at
the joint one of the arm with that joint held.
"""

import matplotlib.pyplot as plt
import numpy as np

import denoc_ros as dn

robot = dn.load_robot('config/robots/canadarm_gauges.urdf', gravity=(0, 0, 0))
model = robot.linearize(robot.static_deflection([0.2, 0.5, -0.4]), outputs=('joints', 'pose:tool'))
frequencies = np.geomspace(0.05, 20, 600)
response = model.frequency_response(2 * np.pi * frequencies)

figure, axes = plt.subplots()
for output in ('joint_2', 'pose:tool/y'):
    row = [str(name).startswith(output) for name in model.output_names].index(True)
    gain = np.abs(response[:, row, list(model.input_names).index('joint_2')])
    axes.loglog(frequencies, gain, label=model.output_names[row])
assert np.isfinite(response).all()
axes.set(xlabel='frequency [Hz]', ylabel='rad, m per N m', xlim=(0.05, 20))
axes.legend()
