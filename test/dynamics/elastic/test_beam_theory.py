"""One beam against the closed forms of Euler-Bernoulli theory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

LENGTH, EI, DENSITY = 2.0, 350.0, 1.7
GJ, POLAR = 90.0, 0.03
NONE = (0.0, 0.0, 0.0)
CLAMPED_FREE = np.array(
    [
        brentq(lambda b: np.cos(b) + 1 / np.cosh(b), np.pi * k + 0.5, np.pi * k + 2.8)
        for k in range(4)
    ]
)
PINNED_FREE = np.array([brentq(lambda b: np.tan(b) - np.tanh(b), 3.5, 4.1)])


def beam(
    parts: str,
    shape: str = 'clamped-free',
    joint: str = 'revolute',
    tip_mass: float = 0.0,
    density: float = DENSITY,
    axis: str = '0 0 1',
    up: bool = False,
    sensors: str = '',
) -> str:
    """URDF of one beam along x (or upwards) on a joint, with a point mass at its tip."""
    m = density * LENGTH
    bend = m * LENGTH**2 / 12
    turn = '0 -1.5707963267948966 0' if up else '0 0 0'
    polar = POLAR * LENGTH if 'torsion' in parts else 0.0
    zeros = ' '.join(f'{name}="0"' for name in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'))
    tip = f'<inertial><mass value="{tip_mass}"/><inertia {zeros}/></inertial>'
    return f"""<robot name="beam"><link name="base"/>
      <link name="arm"><inertial><origin xyz="{LENGTH / 2} 0 0"/><mass value="{m}"/>
        <inertia ixx="{polar}" ixy="0" ixz="0" iyy="{bend}" iyz="0" izz="{bend}"/>
      </inertial></link>
      <link name="tip">{tip if tip_mass else ''}</link>
      <joint name="root" type="{joint}"><parent link="base"/><child link="arm"/>
        <origin rpy="{turn}"/><axis xyz="{axis}"/>
        <limit lower="-9" upper="9" effort="9" velocity="9"/></joint>
      <joint name="end" type="fixed"><parent link="arm"/><child link="tip"/>
        <origin xyz="{LENGTH} 0 0"/></joint>
      <flexibility><beam link="arm" length="{LENGTH}" mass_per_length="{density}" shape="{shape}">
        {parts}</beam>{sensors}</flexibility></robot>"""


def bending(modes: int, direction: str = 'y', ratio: float = 0.0) -> str:
    return f'<bending direction="{direction}" ei="{EI}" modes="{modes}" damping_ratio="{ratio}"/>'


def hertz(roots: Array, density: float = DENSITY) -> Array:
    return np.asarray(roots**2 / LENGTH**2 * np.sqrt(EI / density) / (2 * np.pi))


def test_cantilever_frequencies() -> None:
    robot = load_robot(beam(bending(4)), gravity=NONE)
    np.testing.assert_allclose(
        robot.natural_frequencies(np.zeros(5)), hertz(CLAMPED_FREE), rtol=1e-10
    )


def test_torsion_frequencies() -> None:
    parts = f'<torsion gj="{GJ}" polar_inertia="{POLAR}" modes="3"/>'
    robot = load_robot(beam(parts), gravity=NONE)
    expected = (np.arange(3) + 0.5) / (2 * LENGTH) * np.sqrt(GJ / POLAR)
    np.testing.assert_allclose(robot.natural_frequencies(np.zeros(4)), expected, rtol=1e-10)


def test_free_joint_gives_the_pinned_free_beam() -> None:
    robot = load_robot(beam(bending(2, ratio=0.0), shape='pinned-pinned'), gravity=NONE)
    assert len(robot.natural_frequencies(np.zeros(3), held=False)) == 3
    robot = load_robot(beam(bending(8)), gravity=NONE)
    found = robot.natural_frequencies(np.zeros(9), held=False)
    assert len(found) == 9
    assert abs(found[0]) < 1e-3 * found[1]  # the rigid motion
    # assumed shapes bound from above; clamped-free ones hold a root curvature that is not there
    assert 1 <= found[1] / hertz(PINNED_FREE)[0] < 1.01


def test_modes_of_a_damped_cantilever() -> None:
    ratio = 0.013
    robot = load_robot(beam(bending(2, ratio=ratio)), gravity=NONE)
    frequencies, shapes, ratios = robot.natural_modes(np.zeros(3))
    np.testing.assert_allclose(frequencies, hertz(CLAMPED_FREE[:2]), rtol=1e-10)
    np.testing.assert_allclose(ratios, ratio, rtol=1e-9)
    assert shapes.shape == (3, 2)
    np.testing.assert_allclose(shapes[0], 0, atol=1e-14)
    assert abs(shapes[1, 0]) > 1e3 * abs(shapes[2, 0])
    assert abs(shapes[2, 1]) > 1e3 * abs(shapes[1, 1])


@pytest.mark.parametrize(
    ('shape', 'modes', 'accuracy'), [('craig-bampton', 2, 1e-8), ('clamped-free', 8, 1e-3)]
)
@pytest.mark.parametrize('direction', ['y', 'z'])
def test_cantilever_deflection(shape: str, modes: int, accuracy: float, direction: str) -> None:
    robot = load_robot(beam(bending(modes, direction), shape), gravity=NONE)
    load, axis = 1e-2, 'xyz'.index(direction)
    wrench = np.zeros(6)
    wrench[axis] = load
    q = robot.static_deflection(np.zeros(1), {'tip': wrench})
    deflection = robot.tip_deflection('arm', q)
    assert deflection[axis] == pytest.approx(load * LENGTH**3 / (3 * EI), rel=accuracy)
    if shape == 'craig-bampton':
        x = 0.7
        expected = load * x**2 * (3 * LENGTH - x) / (6 * EI)
        assert robot.tip_deflection('arm', q, station=x)[axis] == pytest.approx(expected, rel=1e-8)


def test_tip_moment_and_twist() -> None:
    parts = (
        bending(2) + bending(2, 'z') + f'<torsion gj="{GJ}" polar_inertia="{POLAR}" modes="10"/>'
    )
    robot = load_robot(beam(parts, 'craig-bampton'), gravity=NONE)
    moment = 1e-2
    q = robot.static_deflection(np.zeros(1), {'tip': np.array([0, 0, 0, moment, moment, moment])})
    u = robot.tip_deflection('arm', q)
    assert u[1] == pytest.approx(moment * LENGTH**2 / (2 * EI), rel=1e-3)
    assert u[2] == pytest.approx(-moment * LENGTH**2 / (2 * EI), rel=1e-3)
    R = robot.frame_pose('tip', q)[:3, :3]
    # the sine series of a constant torque converges as 1 / modes
    assert R[2, 1] == pytest.approx(moment * LENGTH / GJ, rel=3e-2)


def test_gravity_sag_makes_the_flexible_rows_vanish() -> None:
    robot = load_robot(beam(bending(3, 'z') + bending(2), tip_mass=0.8))
    q = robot.static_deflection(np.array([0.4]))
    assert q[0] == 0.4
    h = robot.bias_forces(q, np.zeros(robot.n))
    np.testing.assert_allclose(h[1:], 0, atol=1e-10 * np.abs(h).max() + 1e-12)
    sag = DENSITY * 9.81 * LENGTH**4 / (8 * EI) + 0.8 * 9.81 * LENGTH**3 / (3 * EI)
    assert robot.tip_deflection('arm', q)[2] == pytest.approx(-sag, rel=0.02)


def test_tip_mass_on_a_light_cantilever() -> None:
    light, heavy = 1e-7, 2.0
    robot = load_robot(
        beam(bending(2), 'craig-bampton', tip_mass=heavy, density=light), gravity=NONE
    )
    found = robot.natural_frequencies(np.zeros(3))[0]
    assert found == pytest.approx(np.sqrt(3 * EI / (heavy * LENGTH**3)) / (2 * np.pi), rel=1e-6)


def standing(load: float, gravity: float = -9.81) -> Robot:
    """A light beam under a tip mass whose weight is `load` times Euler's."""
    euler = np.pi**2 * EI / (4 * LENGTH**2)
    weight = load * euler / 9.81
    text = beam(bending(5), 'craig-bampton', tip_mass=weight, density=1e-3, up=True)
    return load_robot(text, gravity=(0, 0, gravity))


def test_standing_beam_buckles_at_eulers_load() -> None:
    assert standing(0.998).natural_frequencies(np.zeros(6))[0] > 0
    assert standing(1.002).natural_frequencies(np.zeros(6))[0] < 0  # unstable ones are negative


def test_hanging_beam_is_stiffer_than_the_standing_one() -> None:
    up, level, down = (
        standing(0.5, g).natural_frequencies(np.zeros(6))[0] for g in (-9.81, 0, 9.81)
    )
    assert up < level < down
    a = np.pi / 2 * np.sqrt(0.5)  # beam column: lateral tip stiffness under half of Euler's load
    assert (up / level) ** 2 == pytest.approx(a**3 / (3 * (np.tan(a) - a)), rel=1e-4)


def test_self_weight_buckling() -> None:
    critical = 7.8373 * EI / LENGTH**3 / 9.81
    for factor, sign in ((0.998, 1), (1.002, -1)):
        text = beam(bending(4), density=factor * critical, up=True)
        robot = load_robot(text)
        assert np.sign(robot.natural_frequencies(np.zeros(5))[0]) == sign


@pytest.mark.parametrize('geometric', [True, False])
def test_spin_stiffens_a_beam(geometric: bool) -> None:
    rate, modes, step = 7.0, 3, 1e-4
    text = beam(bending(modes) + bending(modes, 'z'))
    robot = load_robot(text, gravity=NONE, geometric_stiffness=geometric)
    deformation = robot.tree.bodies[0].beam
    assert deformation is not None
    assert deformation.y is not None
    x, w = np.polynomial.legendre.leggauss(60)
    x, w = (x + 1) * LENGTH / 2, w * LENGTH / 2
    s, ds = deformation.y.shapes.values(x), deformation.y.shapes.slopes(x)
    tension = DENSITY * (LENGTH**2 - x**2) / 2  # over rate^2
    stiff = rate**2 * np.einsum('g,gi,gj->ij', w * tension, ds, ds) * geometric
    mass = rate**2 * DENSITY * np.einsum('g,gi,gj->ij', w, s, s)
    elastic = np.diag(deformation.y.modal_stiffness)
    qd = np.zeros(robot.n)
    qd[0] = rate

    def rows(k: int, d: float) -> Array:
        q = np.zeros(robot.n)
        q[k] = d
        return np.asarray(robot.bias_forces(q, qd))

    found = np.array([(rows(k, step) - rows(k, -step)) / (2 * step) for k in range(1, robot.n)])
    expected = np.zeros((2 * modes, 2 * modes))
    expected[:modes, :modes] = elastic + stiff - mass  # in the plane of the spin
    expected[modes:, modes:] = elastic + stiff
    np.testing.assert_allclose(found[:, 1:], expected, atol=1e-7 * np.abs(elastic).max())


def test_sensors_of_an_end_loaded_cantilever() -> None:
    x, load = 0.3, 1e-2
    sensors = f"""
      <sensor name="gauge" type="strain_gauge" link="arm" station="{x}" direction="y"
        surface="0.02" gain="1" offset="0" noise="0" topic="/a"/>
      <sensor name="cell" type="load_cell" component="moment" link="arm" station="{x}"
        direction="y" gain="2" offset="0.5" noise="0" topic="/b"/>
      <sensor name="edge" type="load_cell" component="shear" link="arm" station="{x}"
        direction="y" gain="1" offset="0" noise="0" topic="/d"/>
      <sensor name="laser" type="deflection" link="arm" station="{LENGTH}" direction="y"
        gain="1" offset="0" noise="0" topic="/c"/>"""
    robot = load_robot(beam(bending(2), 'craig-bampton', sensors=sensors), gravity=NONE)
    q = robot.static_deflection(np.zeros(1), {'tip': np.array([0, load, 0, 0, 0, 0])})
    strain, cell, shear, laser = robot.sensor_values(q, np.zeros(3))
    assert strain == pytest.approx(-0.02 * load * (LENGTH - x) / EI, rel=1e-6)
    # the inboard part holds the outboard one; gain and offset are the raw reading's business
    assert cell == pytest.approx(-load * (LENGTH - x), rel=1e-6)
    assert shear == pytest.approx(-load, rel=1e-6)
    assert laser == pytest.approx(load * LENGTH**3 / (3 * EI), rel=1e-6)
