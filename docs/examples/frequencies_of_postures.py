"""Natural frequencies over the workspace.

The lowest frequency of the Canadarm with held joints, over the positions of elbow and
wrist. State feedback and shapers need it at every posture.
"""

import matplotlib.pyplot as plt
import numpy as np

import denoc_ros as dn

robot = dn.load_robot('config/robots/canadarm.urdf', gravity=(0, 0, 0))
elbow, wrist = np.linspace(-np.pi, np.pi, 41), np.linspace(-np.pi, np.pi, 21)
q = np.zeros(robot.n)
lowest = np.empty((len(wrist), len(elbow)))
for row, column in np.ndindex(lowest.shape):
    q[list(robot.joint_indices)] = 0.0, elbow[column], wrist[row]
    lowest[row, column] = robot.natural_frequencies(q)[0]
assert np.allclose(lowest, lowest[::-1, ::-1], rtol=1e-6)  # the mirror image

drawn = plt.contourf(np.degrees(elbow), np.degrees(wrist), lowest, levels=12)
plt.colorbar(drawn, label='lowest frequency [Hz]')
plt.xlabel('elbow [°]')
plt.ylabel('wrist [°]')
