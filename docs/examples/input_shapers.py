"""Input shapers on a two-link arm.

A shaper convolves the commanded motion with impulses, so that the links are at rest when
the joints arrive. The vibration that is left is simulated, with joints that follow exactly.
"""

import matplotlib.pyplot as plt
import numpy as np

import denoc_ros as dn
from denoc_ros.planning.shapers.impulses import shaper

frequencies = np.linspace(1.4, 2.6, 241)
for method in ('zv', 'zvd', 'ei'):
    left = shaper(method, 2.0).residual(frequencies)
    plt.plot(frequencies / 2.0, 100 * left, label=method)
    # at the frequency it was made for: nothing, or the 5 % that ei allows
    assert abs(left[120] - (0.05 if method == 'ei' else 0.0)) < 1e-3
plt.xlabel('true over assumed frequency')
plt.ylabel('vibration left [%]')
plt.legend()

arm = dn.load_robot('config/robots/two_link_ff.urdf', gravity=(0, 0, 0))
t = np.linspace(0, 0.8, 81)
share = t / 0.8 - np.sin(2 * np.pi * t / 0.8) / (2 * np.pi)
asked = np.array([0.3, 0.6]) + share[:, None]
plan = dn.shape_motion(arm, t, asked, method='zvd', modes=2)
print(f'zvd on the arm: arrives {plan.delay:.2f} s later')
