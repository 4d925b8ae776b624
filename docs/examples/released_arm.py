"""An arm that is let go.

The tool of the planar Canadarm is pulled aside by 10 N and let go, without gravity and with
free joints. Links and joints swing; the energy stays the same.
"""

import matplotlib.pyplot as plt
import numpy as np

import denoc_ros as dn

robot = dn.load_robot('config/robots/canadarm.urdf', gravity=(0, 0, 0))
# without its damping, nothing takes energy away
robot = robot.with_overrides({f'beam.link_{k}.y.damping': 0.0 for k in (1, 2)})
pulled = robot.static_deflection([0.2, 0.5, -0.4], wrenches={'tool': (0, 10, 0, 0, 0, 0)})
run = dn.simulate(robot, pulled, np.zeros(robot.n), np.linspace(0, 10, 401))
assert run.energy_drift < 1e-6

figure, axes = plt.subplots(2, 1, sharex=True, figsize=(7, 5))
for link in ('link_1', 'link_2'):
    deflection = [1e3 * robot.tip_deflection(link, q)[1] for q in run.q]
    axes[0].plot(run.t, deflection, label=link)
axes[0].set_ylabel('deflection [mm]')
axes[0].legend()
axes[1].stackplot(run.t, *run.energy.T - run.energy.T.min(axis=1)[:, None])
axes[1].set(xlabel='time [s]', ylabel='kinetic, potential energy [J]')
