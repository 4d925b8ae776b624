"""Linear models of robots: against simulations, natural modes, closed mechanisms and control."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.signal
from beam_closed_forms import HubBeam
from beam_robots import beam_robot

from denoc_ros.dynamics.linear.linear_model import LinearModel
from denoc_ros.dynamics.linear.natural_modes import mechanism_modes
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import DenocError, StateError
from denoc_ros.simulation.simulate import simulate
from denoc_ros.types import Array

BEAM = HubBeam(ei=120.0, density=1.5, length=1.6, tip_mass=0.8, hub=0.35)


def undamped(robot: Robot) -> Robot:
    paths = {f'damping.{joint}': 0.0 for joint in robot.joint_names}
    paths |= {f'joint.{joint}.friction': 0.0 for joint in robot.joint_names}
    for body in robot.tree.bodies:
        for part in ('y', 'z', 'torsion'):
            if body.beam is not None and getattr(body.beam, part) is not None:
                paths[f'beam.{body.name}.{part}.damping'] = 0.0
    return robot.with_overrides(paths)


@pytest.fixture
def canadarm(repository: Path) -> Robot:
    """Under gravity across its plane and in it, damped."""
    return load_robot(repository / 'config/robots/canadarm_gauges.urdf', gravity=(0, -2.0, 0))


def settled(robot: Robot, *angles: float) -> Array:
    return robot.static_deflection(np.array(angles))


def richardson(function: Callable[[Array], Array], x: Array, step: float) -> Array:
    """Derivative by central differences of two steps, their error of second order taken out."""
    columns = []
    for unit in np.eye(len(x)):
        coarse, fine = (
            (function(x + h * unit) - function(x - h * unit)) / (2 * h) for h in (step, step / 2)
        )
        columns.append((4 * fine - coarse) / 3)
    return np.stack(columns, axis=-1)


def test_model_is_the_derivative_of_simulations(canadarm: Robot) -> None:
    robot, n, time = canadarm, canadarm.n, 0.05
    force = 100.0  # N m: forces of 1 N m move it by 1e-4 of what states do
    q = settled(robot, 0.3, 0.6, -0.5)
    model = robot.linearize(q)
    np.testing.assert_allclose(model.qdd, 0, atol=1e-8)

    def after(x: Array) -> Array:
        tau = model.tau.copy()
        tau[robot.joint_indices] += force * x[2 * n :]
        state = q + x[:n], x[n : 2 * n]
        run = simulate(robot, *state, np.array([0, time]), lambda *_: tau, rtol=1e-12, atol=1e-14)
        return np.concatenate([run.q[-1], run.qd[-1]])

    held = model.discrete(time)
    expected = richardson(after, np.zeros(2 * n + 3), 1e-3)
    for block, column in ((held.a, slice(0, 2 * n)), (force * held.b, slice(2 * n, None))):
        scale = np.abs(expected[:, column]).max()
        np.testing.assert_allclose(block, expected[:, column], rtol=0, atol=2e-8 * scale)


def test_model_along_a_motion_is_the_derivative_of_the_dynamics(canadarm: Robot) -> None:
    robot, n = canadarm, canadarm.n
    rng = np.random.default_rng(4)
    q, qd = settled(robot, 0.3, 0.6, -0.5), rng.uniform(-0.5, 0.5, n)
    tau = rng.uniform(-20, 20, n)
    outputs = ('velocity:tool', 'acceleration:tool', 'rates', 'sensors', 'deflection:link_2')
    model = robot.linearize(q, qd, tau, outputs=outputs)

    def rates(x: Array) -> Array:
        force = tau.copy()
        force[robot.joint_indices] += x[2 * n :]
        qdd = robot.forward_dynamics(x[:n], x[n : 2 * n], force)
        motion = robot.frame_motion('tool', x[:n], x[n : 2 * n], qdd).ravel()
        outputs = (x[n : 2 * n][robot.joint_indices], robot.sensor_values(x[:n]))
        tip = robot.tip_deflection('link_2', x[:n])
        return np.concatenate([x[n : 2 * n], qdd, motion, *outputs, tip])

    expected = richardson(rates, np.concatenate([q, qd, np.zeros(3)]), 1e-3)
    found = np.block([[model.a, model.b], [model.c, model.d]])
    scale = np.maximum(np.abs(expected).max(axis=1, keepdims=True), 1.0)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-8)
    np.testing.assert_allclose(model.qdd, robot.forward_dynamics(q, qd, tau), rtol=1e-12)
    assert model.output_names[6] == 'acceleration:tool/ax'
    assert np.abs(model.d).max() > 1e-4  # accelerations feel forces at once


@pytest.mark.parametrize('name', ['canadarm', 'ssrms', 'two_link_ff', 'stanford_flexible'])
def test_poles_at_rest_are_the_natural_modes(repository: Path, name: str) -> None:
    robot = undamped(load_robot(repository / f'config/robots/{name}.urdf', gravity=(0, 0, 0)))
    q = settled(robot, *np.linspace(0.3, -0.6, len(robot.joint_indices)))
    for held in (False, True):
        model = robot.linearize(q, locked=robot.joint_names if held else ())
        omega = 2 * np.pi * robot.natural_frequencies(q, held)
        poles = model.poles()
        np.testing.assert_allclose(poles.real, 0, atol=1e-8 * omega[-1])
        np.testing.assert_allclose(np.sort(abs(poles))[::2], omega, rtol=1e-8, atol=1e-8)


def test_poles_of_a_damped_beam_have_its_ratio() -> None:
    robot = beam_robot(BEAM, 1, 'fixed', ratio=0.1)
    model = robot.linearize(np.zeros(1))
    modes = robot.natural_modes(np.zeros(1))
    omega, ratio = 2 * np.pi * modes.frequencies[0], modes.damping_ratios[0]
    pole = complex(-ratio * omega, -omega * np.sqrt(1 - ratio**2))
    expected = np.array([pole, pole.conjugate()])
    np.testing.assert_allclose(model.poles(), expected, rtol=1e-8)


def test_forces_and_their_deflections_are_reciprocal(canadarm: Robot) -> None:
    q = settled(canadarm, 0.3, 0.6, -0.5)
    joints = canadarm.joint_names
    model = undamped(canadarm).linearize(
        q, inputs=('wrench:tool', *joints), outputs=('pose:tool', 'joints')
    )
    response = model.frequency_response([7.0])[0]
    np.testing.assert_allclose(response, response.T, atol=1e-8 * abs(response).max())
    # stiffness is symmetric at rest
    n = canadarm.n
    tangent = model.inertia @ model.a[n:, :n]
    np.testing.assert_allclose(tangent, tangent.T, atol=1e-8 * abs(tangent).max())


@pytest.mark.parametrize('moving', [False, True])
def test_model_of_a_mechanism_is_the_derivative_along_its_loops(
    repository: Path, moving: bool
) -> None:
    robot = load_robot(repository / 'config/robots/five_bar_ffff.urdf', gravity=(0, -9.81, 0))
    rng, n = np.random.default_rng(1), robot.n
    guess = np.zeros(n)
    guess[robot.flexible_indices] = rng.uniform(-1e-3, 1e-3, len(robot.flexible_indices))
    q = robot.assemble(guess, fixed=[robot.coordinate_names[k] for k in robot.flexible_indices])
    qd = robot.assemble_rates(q, rng.uniform(-1, 1, n) if moving else np.zeros(n))
    tau = np.zeros(n)
    tau[robot.joint_indices] = rng.uniform(-1, 1, len(robot.joint_indices))
    model = robot.linearize(q, qd, tau, outputs=('joints', 'rates'))
    m = len(model.inertia)
    free = list(model.state_names[:m])
    own = [robot.coordinate_names.index(name) for name in free]
    inputs = [robot.coordinate_names.index(name) for name in model.input_names]

    def rates(x: Array) -> Array:
        near, near_rates, force = q.copy(), qd.copy(), tau.copy()
        near[own] += x[:m]
        here = robot.assemble(near, fixed=free)
        near_rates[own] += x[m : 2 * m]
        speed = robot.assemble_rates(here, near_rates, fixed=free)
        force[inputs] += x[2 * m :]
        qdd, _ = robot.constrained_forward_dynamics(here, speed, force)
        joints = robot.joint_indices
        return np.concatenate([speed[own], qdd[own], here[joints], speed[joints]])

    expected = richardson(rates, np.zeros(2 * m + len(inputs)), 2e-4)
    found = np.block([[model.a, model.b], [model.c, model.d]])
    scale = np.maximum(np.abs(expected).max(axis=1, keepdims=True), 1.0)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-7)


def test_poles_of_a_mechanism_are_its_modes(repository: Path) -> None:
    robot = load_robot(repository / 'config/robots/five_bar_ffff.urdf', gravity=(0, 0, 0))
    q = robot.assemble(np.zeros(robot.n))
    omega = 2 * np.pi * mechanism_modes(robot, q, ()).frequencies
    poles = np.sort(abs(undamped(robot).linearize(q).poles()))[::2]
    # differences of the closure rows round what should not move at all
    np.testing.assert_allclose(poles, omega, rtol=1e-8, atol=1e-3)


MIMIC = """<robot name="gripper"><link name="base"/>{links}
<joint name="left" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="9" velocity="5"/><dynamics damping="0.2"/></joint>
<joint name="right" type="revolute"><parent link="base"/><child link="b"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="9" velocity="5"/><mimic joint="left" multiplier="-2"/></joint>
</robot>"""
LINK = """<link name="{name}"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>"""


def test_mimic_joints_follow_in_the_model() -> None:
    robot = load_robot(MIMIC.format(links=''.join(LINK.format(name=x) for x in 'ab')))
    model = robot.linearize(np.zeros(2), outputs=('joints',))
    assert model.state_names == ('left', 'left_rate')
    assert model.input_names == ('left',)
    about = 0.03 + 2 * 0.1**2
    np.testing.assert_allclose(model.inertia, [[5 * about]], rtol=1e-12)
    expected = np.array([[0, 1], [0, -0.2 / (5 * about)]])
    np.testing.assert_allclose(model.a, expected, atol=1e-9)
    np.testing.assert_allclose(model.c, [[1, 0], [-2, 0]], atol=1e-12)


def test_friction_is_a_damper_at_rest_unless_left_out() -> None:
    text = MIMIC.replace('<dynamics damping="0.2"/>', '<dynamics damping="0.2" friction="0.03"/>')
    robot = load_robot(text.format(links=''.join(LINK.format(name=x) for x in 'ab')))
    with_it, without = (robot.linearize(np.zeros(2), friction=x) for x in (True, False))
    ratio = with_it.a[1, 1] / without.a[1, 1]
    assert ratio == pytest.approx((0.2 + 0.03 / 1e-3) / 0.2, rel=1e-9)


def test_what_holds_a_posture_off_equilibrium_leaves_accelerations(canadarm: Robot) -> None:
    q = np.zeros(canadarm.n)
    q[canadarm.joint_indices] = 0.4
    model = canadarm.linearize(q)
    torque, amplitudes = canadarm.hybrid_dynamics(q, 0 * q, np.zeros(3))
    np.testing.assert_allclose(model.tau[canadarm.joint_indices], torque, rtol=1e-9)
    np.testing.assert_allclose(model.qdd[canadarm.flexible_indices], amplitudes, rtol=1e-9)
    np.testing.assert_allclose(model.qdd[canadarm.joint_indices], 0, atol=1e-9)


def small_model() -> LinearModel:
    robot = beam_robot(BEAM, 2, ratio=0.02)
    return robot.linearize(np.zeros(robot.n), outputs=('joints', 'pose:tip', 'acceleration:tip'))


@pytest.mark.parametrize('delay', [0.0, 0.004, 0.01, 0.023, 0.03])
def test_sampled_model_is_the_continuous_one_with_its_delay(delay: float) -> None:
    model, period = small_model(), 0.01
    sampled = model.discrete(period, delay)
    fine = 1e-3  # the delays are whole multiples of it
    a, b, c, d, _ = scipy.signal.cont2discrete((model.a, model.b, model.c, model.d), fine)
    inputs = np.random.default_rng(2).uniform(-1, 1, 40)
    x, state = np.zeros(len(model.a)), np.zeros(len(sampled.a))
    steps, late = round(period / fine), round(delay / fine)
    for k in range(len(inputs)):
        y = sampled.c @ state + sampled.d @ inputs[k : k + 1]
        state = sampled.a @ state + sampled.b @ inputs[k : k + 1]
        for j in range(steps):
            acting = (k * steps + j - late) // steps
            u = inputs[acting : acting + 1] if acting >= 0 else np.zeros(1)
            if j == 0:
                np.testing.assert_allclose(y, c @ x + d @ u, rtol=1e-8, atol=1e-9)
            x = a @ x + b @ u
    assert (sampled.period, sampled.delay) == (period, delay)
    assert np.all(abs(sampled.poles()) < 1 + 1e-6)


def test_response_is_the_resolvent_between_outputs_and_inputs() -> None:
    model = small_model()
    omega = np.array([0.7, 9.0, 30.0])
    for w, found in zip(omega, model.frequency_response(omega), strict=True):
        resolvent = np.linalg.inv(1j * w * np.eye(len(model.a)) - model.a)
        expected = model.c @ resolvent @ model.b + model.d
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)


def test_zeros_are_where_nothing_gets_through() -> None:
    model = small_model()
    for output in ('hub', 'pose:tip/y', 'acceleration:tip/ay', 'acceleration:tip/alz'):
        zeros = model.zeros('hub', output)
        place = model.output_names.index(output)
        far = abs(model.frequency_response([5.0])[0, place, 0])
        nonzero = zeros[abs(zeros) > 1e-3]
        assert len(nonzero)
        for s in nonzero:
            pencil = np.block(
                [[s * np.eye(len(model.a)) - model.a, -model.b],
                 [model.c[[place]], model.d[[place]]]]
            )  # fmt: skip
            smallest = np.linalg.svd(pencil, compute_uv=False)
            assert smallest[-1] < 1e-9 * smallest[0], (output, s)
        assert far > 0
    # forces in the plane of the beam never move it out
    assert not len(model.zeros('hub', 'pose:tip/z'))


def test_python_control_takes_the_models() -> None:
    model = small_model()
    system = model.to_control()
    assert isinstance(system, control.StateSpace)
    assert system.input_labels == ['hub']
    assert system.output_labels[:2] == ['hub', 'pose:tip/x']
    assert system.isctime()
    omega = np.array([3.0, 8.0, 20.0])
    response = np.asarray(control.frequency_response(system, omega).frdata)
    expected = np.moveaxis(model.frequency_response(omega), 0, -1)
    np.testing.assert_allclose(response, expected, rtol=1e-6, atol=1e-12)
    sampled = model.discrete(0.01, 0.015).to_control()
    assert sampled.dt == 0.01
    assert sampled.state_labels[-2:] == ['hub[-2]', 'hub[-1]']


def test_missing_python_control_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'control', None)
    with pytest.raises(DenocError, match=r'pip install denoc_ros\[control\]'):
        small_model().to_control()


@pytest.mark.parametrize(
    ('change', 'says'),
    [
        ({'inputs': ('elbow',)}, 'input must be wrench:<frame> or one of hub, arm/y1, arm/y2'),
        ({'outputs': ('tip',)}, 'output must be joints, rates, states, sensors, pose:<name>'),
        ({'outputs': ('pose:nothing',)}, 'frame must be one of'),
        ({'locked': ('elbow',)}, 'joints must be different ones of'),
        ({'qd': np.zeros(2)}, r'qd must have shape \(3,\)'),
        ({'tau': np.full(3, np.nan)}, 'tau must be finite'),
    ],
)
def test_wrong_arguments_are_refused(change: dict[str, object], says: str) -> None:
    robot = beam_robot(BEAM, 2)
    with pytest.raises(StateError, match=says):
        robot.linearize(np.zeros(3), **change)  # type: ignore[arg-type]


def test_wrong_questions_are_refused() -> None:
    model = small_model()
    with pytest.raises(StateError, match='input must be one of hub, got'):
        model.zeros('elbow', 'hub')
    with pytest.raises(StateError, match='output must be one of hub, pose:tip/x'):
        model.zeros('hub', 99)
    with pytest.raises(StateError, match='period must be > 0 s, got 0'):
        model.discrete(0.0)
    with pytest.raises(StateError, match='delay must be >= 0 s, got -1'):
        model.discrete(0.1, -1.0)


def test_open_loops_are_refused(repository: Path) -> None:
    robot = load_robot(repository / 'config/robots/five_bar_rrrr.urdf')
    q = robot.assemble(np.zeros(robot.n))
    q[1] += 1e-3
    with pytest.raises(StateError, match=r'q must keep .* closed to 1e-06 m \(or rad\) \(see ass'):
        robot.linearize(q, tau=np.zeros(robot.n))
