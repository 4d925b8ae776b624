"""`denoc identify model` beside mujoco.sysid and figaroh: one rigid robot, the same data, one run.

Both must be installed: `pip install 'mujoco[sysid]' figaroh`. The robot is the UR10; the true one
has other bodies, friction and torque with noise. Each tool gets the same smoothed motion and
measured torque. It is judged by the torque of its robot on motions of another kind.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from identification_runs import recorded, sweeping
from lxml import etree

import denoc_ros as dn
from denoc_ros.estimation.joint_motion import smooth
from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.types import Array

FILE = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'ur10.urdf'
FREE = ['link.*.inertial', 'joint.*.damping']
DURATION, STEP, NOISE = 6.0, 0.005, 0.01
FINE = 0.001  # s: MuJoCo's
CHUNK = 20  # samples of a forward simulation: one of six seconds diverges
ITERATIONS = 15
DAMPING = np.array([8.0, 8.0, 4.0, 0.5, 0.3, 0.05])
Torque = Callable[[Array, Array, Array], Array]


def plain_urdf() -> str:
    """Return the robot without pictures, which MuJoCo would want to read."""
    root = etree.parse(str(FILE)).getroot()
    for element in [*root.iter('visual'), *root.iter('collision')]:
        element.getparent().remove(element)
    return str(etree.tostring(root, encoding='unicode'))


def truth(start: dn.Robot) -> dn.Robot:
    """Return the robot with other bodies, some 20 % off, and friction."""
    parameters = FreeParameters(start, ['link.*.inertial'])
    theta = np.random.default_rng(4).normal(0.0, 0.1, parameters.size)
    damping = zip(start.joint_names, DAMPING.tolist(), strict=True)
    true: dn.Robot = parameters.robot_at(parameters.settings(theta))
    return true.with_overrides({f'joint.{name}.damping': value for name, value in damping})


def ours(start: dn.Robot, run: dn.Recording) -> tuple[Torque, str]:
    """Identify with denoc_ros."""
    found = dn.identify_model(start, run, FREE, held_out=0.0)
    masses = [path for path in found.values if path.endswith('.mass')]
    claimed = [path for path in masses if found.verdict[path] != 'not identifiable']
    lines = len(found.combinations)
    verdict = f'{len(claimed)} of {len(masses)} masses; {lines} lines say what is seen of the rest'
    return found.robot.inverse_dynamics, verdict


def of_figaroh(
    urdf: str, run: dn.Recording, motion: tuple[Array, Array, Array]
) -> tuple[Torque, str]:
    """Identify with figaroh's regressor, base parameters and least squares."""
    import pinocchio as pin
    from figaroh.tools.qrdecomposition import QRDecomposer
    from figaroh.tools.regressor import RegressorBuilder

    model = pin.buildModelFromXML(urdf)
    builder = RegressorBuilder(pin.RobotWrapper(model))
    width = model.nv

    def regressor(q: Array, qd: Array, qdd: Array) -> Array:
        bodies = builder.build_basic_regressor(q, qd, qdd, {'act_idxv': range(width)})
        rates = np.zeros((width, len(q), width))
        for joint in range(width):
            rates[joint, :, joint] = qd[:, joint]
        return np.hstack([bodies, rates.reshape(-1, width)])

    whole = regressor(*motion)
    kept = np.flatnonzero(np.linalg.norm(whole, axis=0) > 1e-6)
    names = [f'p{k}' for k in kept]
    found = QRDecomposer().decompose(whole[:, kept], names, run.effort.T.ravel())
    base = kept[found.base_indices]
    measured, weight = run.effort.T.ravel(), np.ones(len(run.t) * width)
    for _ in range(2):  # as it does: each joint counts by the deviation of its residuals
        weighted = weight[:, None] * whole[:, base]
        solved = np.linalg.lstsq(weighted, weight * measured, rcond=None)[0]
        left = (measured - whole[:, base] @ solved).reshape(width, -1)
        weight = np.repeat(1.0 / left.std(axis=1), len(run.t))

    def torque(q: Array, qd: Array, qdd: Array) -> Array:
        return np.asarray((regressor(q, qd, qdd)[:, base] @ solved).reshape(width, -1).T)

    verdict = (
        f'no mass alone; {found.rank} base parameters, not one of them a body that must exist'
    )
    return torque, verdict


def set_body(body: Any, theta: Array) -> None:
    """Give a body the inertia of MuJoCo's ten numbers: its own modifier does not compile here."""
    import mujoco
    from mujoco.sysid import model_modifier

    ten = model_modifier.pi_from_theta(theta)
    centre = ten[1:4] / ten[0]
    shift = float(centre @ centre) * np.eye(3) - np.outer(centre, centre)
    sizes, axes = np.linalg.eigh(ten[4:].reshape(3, 3) - ten[0] * shift)
    axes *= np.sign(np.linalg.det(axes))
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, axes.ravel())
    body.mass, body.ipos, body.inertia, body.iquat = ten[0], centre, sizes, turn


def mujoco_robot(urdf: str, joints: list[str]) -> Any:
    """Return the robot with a motor and sensors of motion at each joint."""
    import mujoco

    read = mujoco.MjSpec.from_string(urdf)
    read.compile()
    spec = mujoco.MjSpec.from_string(read.to_xml())
    spec.option.timestep = FINE
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name in joints:
        joint = spec.joint(name)
        joint.limited = False
        joint.damping[0] = 0.1
        motor = spec.add_actuator(name=f'motor_{name}', target=name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        for kind, what in (
            (mujoco.mjtSensor.mjSENS_JOINTPOS, 'pos'),
            (mujoco.mjtSensor.mjSENS_JOINTVEL, 'vel'),
        ):
            spec.add_sensor(
                name=f'{name}_{what}', type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name
            )
    return spec


def mujoco_sequences(
    spec: Any, model: Any, run: dn.Recording, motion: tuple[Array, Array, Array]
) -> Any:
    """Return the recording in pieces, each from its measured state."""
    import mujoco
    from mujoco import sysid

    q, qd, _ = motion
    starts = range(0, len(q) - CHUNK, CHUNK)
    data = mujoco.MjData(model)
    pieces: tuple[list[Any], ...] = ([], [], [], [])
    t = STEP * np.arange(CHUNK + 1)
    for first in starts:
        rows = slice(first, first + CHUNK + 1)
        pieces[0].append(f'chunk_{first}')
        pieces[1].append(sysid.create_initial_state(model, q[first], qd[first], data.act))
        pieces[2].append(sysid.TimeSeries(t, run.effort[rows]))
        both = np.stack([q[rows], qd[rows]], axis=2).reshape(CHUNK + 1, -1)
        pieces[3].append(sysid.TimeSeries.from_names(t, both, model))
    return sysid.ModelSequences('ur10', spec, *pieces)


def of_mujoco(
    urdf: str, run: dn.Recording, motion: tuple[Array, Array, Array]
) -> tuple[Torque, str]:
    """Identify with mujoco.sysid: simulations of a tenth of a second from measured states."""
    import mujoco
    from mujoco import sysid

    joints = list(run.joints)
    spec = mujoco_robot(urdf, joints)
    model = spec.compile()
    parameters = sysid.ParameterDict()
    bodies = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, k) for k in range(1, model.nbody)]
    bodies = [name for name in bodies if model.body(name).mass[0] > 0.0]
    for name in bodies:
        parameters.add(
            sysid.body_inertia_param(
                spec,
                model,
                name,
                sysid.InertiaType.Pseudo,
                modifier=lambda s, p, name=name: set_body(s.body(name), p.value),
            )
        )
    for name in joints:
        parameters.add(
            sysid.Parameter(
                f'damping_{name}', 0.1, 0.0, 20.0,
                modifier=lambda s, p, name=name: s.joint(name).damping.__setitem__(0, p.value[0]),
            )
        )  # fmt: skip
    sequences = mujoco_sequences(spec, model, run, motion)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    best, result = sysid.optimize(
        parameters, residual, optimizer='mujoco', verbose=False, max_iters=ITERATIONS
    )
    final = residual(result.x, best)[0]
    _, widths = sysid.calculate_intervals(final, np.asarray(result.jac))
    found = sysid.apply_param_modifiers_spec(best, spec.copy()).compile()
    data = mujoco.MjData(found)

    def torque(q: Array, qd: Array, qdd: Array) -> Array:
        rows = []
        for state in zip(q, qd, qdd, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = state
            mujoco.mj_inverse(found, data)
            rows.append(data.qfrc_inverse.copy())
        return np.array(rows)

    # the first of a body's ten is half the logarithm of its mass
    half = 2.0 * np.asarray(widths)[: 10 * len(bodies) : 10]
    claimed = int(np.sum(half < 0.5))
    return torque, f'{claimed} of {len(bodies)} masses get an interval within 50 %'


def main() -> None:
    """Print a row for each tool."""
    urdf = plain_urdf()
    start = dn.load_robot(urdf)
    true = truth(start)
    run = recorded(true, sweeping(start.n, 5), DURATION, NOISE)
    smoothed = smooth(run.t, run.position, run.velocity, cutoff=20.0)
    motion = (smoothed.q, smoothed.qd, smoothed.qdd)
    draw = np.random.default_rng(7)
    q, qd, qdd = (draw.normal(0.0, scale, (200, start.n)) for scale in (1.0, 1.0, 2.0))
    wanted = true.inverse_dynamics(q, qd, qdd)
    size = np.sqrt(np.mean(wanted**2, axis=0))
    tools: dict[str, Callable[[], tuple[Torque, str]]] = {
        'denoc_ros': lambda: ours(start, run),
        'figaroh': lambda: of_figaroh(urdf, run, motion),
        'mujoco.sysid': lambda: of_mujoco(urdf, run, motion),
    }
    before = start.inverse_dynamics(q, qd, qdd) - wanted
    print(f'before: {100.0 * np.mean(np.sqrt(np.mean(before**2, axis=0)) / size):.1f} % of torque')
    for name in sys.argv[1:] or tools:
        began, processor = time.perf_counter(), time.process_time()
        torque, verdict = tools[name]()
        spent = time.perf_counter() - began, time.process_time() - processor
        error = torque(q, qd, qdd) - wanted
        share = 100.0 * np.sqrt(np.mean(error**2, axis=0)) / size
        row = {
            'tool': name,
            'error_percent': [round(float(each), 2) for each in share],
            'mean': round(float(np.mean(share)), 2),
            'seconds': round(spent[0], 1),
            'processor_s': round(spent[1], 1),
            'masses claimed': verdict,
        }
        print(json.dumps(row))


if __name__ == '__main__':
    main()
