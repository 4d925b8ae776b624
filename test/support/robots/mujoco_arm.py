"""An arm with six elastic joints in MuJoCo: two hinges on one axis, the first with armature.

`python test/support/robots/mujoco_arm.py > test/data/mujoco_elastic_arm.csv` (needs `mujoco`)
writes what the test compares with.
"""

from __future__ import annotations

import sys

import numpy as np

from denoc_ros.types import Array

AXES = ('0 0 1', '0 1 0', '0 1 0', '1 0 0', '0 1 0', '1 0 0')
OFFSETS = ('0 0 0.2', '0 0.1 0.3', '0.5 0 0', '0.4 0 0.05', '0.1 0 0', '0.1 0 0')
MASSES = (8.0, 6.0, 4.0, 2.0, 1.0, 0.5)
CENTRES = ('0 0.02 0.1', '0.25 0 0', '0.2 0.01 0', '0.05 0 0', '0.03 0 0.01', '0.05 0.02 0')
INERTIAS = (  # xx yy zz xy xz yz about the centre
    (0.08, 0.07, 0.05, 0.002, 0.0, 0.001),
    (0.02, 0.15, 0.15, 0.0, 0.001, 0.0),
    (0.01, 0.08, 0.08, 0.001, 0.0, 0.0),
    (0.004, 0.006, 0.006, 0.0, 0.0, 0.0002),
    (0.001, 0.0015, 0.0014, 0.0, 0.0, 0.0),
    (0.0008, 0.0009, 0.0007, 0.0001, 0.0, 0.0),
)
STIFFNESS = (2e4, 2e4, 1.2e4, 3e3, 2e3, 1e3)
SPRING_DAMPING = (8.0, 8.0, 5.0, 1.0, 0.5, 0.2)
ARMATURE = (1.5, 1.5, 0.9, 0.3, 0.2, 0.1)
JOINT_DAMPING = (2.0, 2.0, 1.0, 0.5, 0.2, 0.1)
START = np.array([0.3, -0.5, 0.8, 0.2, -0.4, 0.6])
TIMES = np.linspace(0.0, 2.0, 21)
FREE_UNTIL = 1.0  # s: then torques act


def torque(t: float) -> Array:
    """Motor torques (6,) [N m]: none, then swinging ones that begin smoothly."""
    since = max(0.0, t - FREE_UNTIL)
    size = np.array([30.0, 60.0, 30.0, 5.0, 3.0, 1.0])
    rate = np.array([7.0, 9.0, 11.0, 13.0, 15.0, 17.0])
    return np.asarray(size * np.sin(rate * since) * since**2 / (0.05 + since**2))


def urdf() -> str:
    """Description with `<spring>`s."""
    links, joints, block = '<link name="link0"/>', '', ''
    names = ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
    for k in range(6):
        inertia = ' '.join(f'{name}="{v}"' for name, v in zip(names, INERTIAS[k], strict=True))
        links += (
            f'<link name="link{k + 1}"><inertial><origin xyz="{CENTRES[k]}"/>'
            f'<mass value="{MASSES[k]}"/><inertia {inertia}/></inertial></link>'
        )
        joints += (
            f'<joint name="joint{k + 1}" type="continuous"><parent link="link{k}"/>'
            f'<child link="link{k + 1}"/><origin xyz="{OFFSETS[k]}"/><axis xyz="{AXES[k]}"/>'
            f'<dynamics damping="{JOINT_DAMPING[k]}"/></joint>'
        )
        block += (
            f'<actuator joint="joint{k + 1}" armature="{ARMATURE[k]}"/><spring '
            f'joint="joint{k + 1}" stiffness="{STIFFNESS[k]}" damping="{SPRING_DAMPING[k]}"/>'
        )
    return f'<robot name="arm">{links}{joints}<flexibility>{block}</flexibility></robot>'


def mjcf(step: float) -> str:
    """The same as MuJoCo's model."""
    inner = ''
    for k in reversed(range(6)):
        inertia = ' '.join(str(value) for value in INERTIAS[k])
        inner = (
            f'<body pos="{OFFSETS[k]}"><inertial pos="{CENTRES[k]}" mass="{MASSES[k]}" '
            f'fullinertia="{inertia}"/>'
            f'<joint type="hinge" axis="{AXES[k]}" armature="{ARMATURE[k]}" '
            f'damping="{JOINT_DAMPING[k]}"/>'
            f'<joint type="hinge" axis="{AXES[k]}" stiffness="{STIFFNESS[k]}" '
            f'damping="{SPRING_DAMPING[k]}"/>{inner}</body>'
        )
    option = f'<option timestep="{step}" integrator="RK4" gravity="0 0 -9.81"/>'
    return f'<mujoco>{option}<worldbody>{inner}</worldbody></mujoco>'


def simulate(step: float) -> Array:
    """Coordinates (21, 12) [rad], motor and spring by turns, by Runge-Kutta steps."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf(step))
    found = mujoco.MjData(model)
    found.qpos[::2] = START

    def drive(_model: object, now: mujoco.MjData) -> None:
        now.qfrc_applied[::2] = torque(now.time)

    mujoco.set_mjcb_control(drive)
    rows = []
    try:
        for t in TIMES:
            while found.time < t - 0.5 * step:
                mujoco.mj_step(model, found)
            rows.append(np.array(found.qpos))
    finally:
        mujoco.set_mjcb_control(None)
    return np.array(rows)


if __name__ == '__main__':
    np.savetxt(sys.stdout, simulate(1e-4), fmt='%.12e', delimiter=',')
