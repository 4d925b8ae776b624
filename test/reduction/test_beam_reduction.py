"""Beams whose planes, twist and stretch are coupled: `denoc reduce` of a `<beam>`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad_vec

import denoc_ros as dn
from denoc_ros.cli.main import main
from denoc_ros.errors import ModelError
from denoc_ros.model.beams.link_file import ReducedLink
from denoc_ros.model.reading.findings import Findings
from denoc_ros.model.reading.flexibility import read_flexibility
from denoc_ros.model.reading.source import parse_xml
from denoc_ros.reduction.body import Patch
from denoc_ros.reduction.coupled_beam import BeamSections, beam_body
from denoc_ros.reduction.craig_bampton import reduce_body
from denoc_ros.types import Array

LENGTH, EI_Y, EI_Z, GJ = 2.0, 300.0, 200.0, 100.0
DEFORMATIONS = (
    '<bending direction="y" modes="8"/><bending direction="z" modes="8"/><torsion modes="3"/>'
)
GRAVITY = (0.0, 0.0, -9.81)


def stations(root: str = '', tip: str | None = None, softer: float = 0.0) -> str:
    """Return two stations of one section with attributes of their own."""
    numbers = f'ei_y="{EI_Y}" ei_z="{EI_Z}" mass_per_length="2" polar_inertia="1e-4"'
    return ''.join(
        f'<at x="{x}" gj="{gj}" {numbers} {own}/>'
        for x, gj, own in (
            (0.0, GJ, root),
            (LENGTH, GJ * (1.0 - softer), root if tip is None else tip),
        )
    )


def arm(inside: str, origin: str = '', more: str = '', place: str = '2 0 0') -> str:
    """Return an arm with a tool at the tip of its beam."""
    return f"""<robot name="r"><link name="base"/>
    <link name="arm"><inertial><origin xyz="1 0 0"/><mass value="12"/>
      <inertia ixx="0.5" iyy="6" izz="6" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <link name="tool"><inertial><mass value="0.5"/>
      <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
      <limit lower="-3" upper="3" effort="100" velocity="5"/></joint>
    <joint name="t" type="fixed"><parent link="arm"/><child link="tool"/>
      <origin xyz="{place}"/></joint>
    <flexibility><beam link="arm" length="{LENGTH}">{origin}{inside}{DEFORMATIONS}</beam>{more}
    </flexibility></robot>"""


def reduced(folder: Path, text: str, *options: str) -> Path:
    """Return the URDF that `denoc reduce` makes of a robot's arm."""
    source, made = folder / 'arm.urdf', folder / 'made.urdf'
    source.write_text(text)
    options = (*options, '-o', str(made), '--json')
    assert main(['reduce', str(source), '--link', 'arm', *options]) == 0
    return made


def compliance(text: str) -> Array:
    """Displacement and turn (6, 6) of the tip under unit forces and moments there."""
    findings = Findings()
    element = read_flexibility(parse_xml('arm', text), findings).beams['arm']
    assert not findings.items
    body = beam_body('arm', BeamSections.of(element, None), element.origin, [])
    ends = [
        Patch(
            '' if not k else 'tip', body.nodes[k], np.eye(3), np.array([k % len(body.nodes)]), 0.0
        )
        for k in (0, -1)
    ]
    stiffness = reduce_body(body, ends, 1, lambda share: None).stiffness
    return np.asarray(np.linalg.inv(stiffness[:6, :6]), dtype=np.float64)


def modal_compliance(link: ReducedLink) -> Array:
    """Return the same of a link's modes."""
    frame = link.frames['t']
    rows = np.vstack([frame.phi, frame.theta])
    return np.asarray((rows / link.stiffness) @ rows.T)


def link_of(folder: Path, text: str, *options: str) -> ReducedLink:
    robot = dn.load_robot(reduced(folder, text, *options))
    modes = next(body.modes for body in robot.tree.bodies if body.name == 'arm')
    assert modes is not None
    return modes.link


def test_a_constant_turn_and_offset_is_a_beam_in_a_turned_frame() -> None:
    turned = arm(stations('angle="0.4" centroid_y="0.03" centroid_z="-0.02"'))
    frame = arm(stations(), '<origin xyz="0 0.03 -0.02" rpy="0.4 0 0"/>')
    one, other = (dn.load_robot(text, gravity=GRAVITY) for text in (turned, frame))
    q, qd, qdd = 0.05 * np.random.default_rng(1).standard_normal((3, one.n))
    np.testing.assert_allclose(
        one.inverse_dynamics(q, qd, qdd),
        other.inverse_dynamics(q, qd, qdd),
        rtol=1e-12,
        atol=1e-12,
    )


def test_offsets_of_zero_are_the_plain_beam() -> None:
    zero = 'angle="0" centroid_y="0" centroid_z="0" shear_center_y="0" shear_center_z="0"'
    one, other = (dn.load_robot(arm(each)) for each in (stations(zero), stations()))
    q = 0.05 * np.random.default_rng(2).standard_normal(one.n)
    assert (one.inverse_dynamics(q, q, q) == other.inverse_dynamics(q, q, q)).all()


def test_a_turned_section_deflects_out_of_the_plane_of_its_load() -> None:
    """Closed form: u = R diag(L^3 / (3 EI)) R^T F."""
    angle = 0.4
    robot = dn.load_robot(arm(stations(f'angle="{angle}"')), gravity=(0.0, 0.0, 0.0))
    q = robot.static_deflection(np.zeros(1), {'tool': np.array([0, 0, 0.1, 0, 0, 0.0])})
    moved = robot.frame_pose('tool', q)[1:3, 3]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    closed = turn @ np.diag(LENGTH**3 / 3.0 / np.array([EI_Y, EI_Z])) @ turn.T @ [0.0, 0.1]
    assert moved == pytest.approx(closed, rel=1e-5)
    assert abs(moved[0]) > 0.1 * abs(moved[1])


def test_a_twisted_blade_bends_as_the_integral_of_its_turned_rigidity(tmp_path: Path) -> None:
    text = arm(stations('angle="0"', 'angle="1.2"'))

    def bent(x: float) -> Array:
        cos, sin = np.cos(0.6 * x), np.sin(0.6 * x)
        turn = np.array([[cos, -sin], [sin, cos]])
        return np.asarray((LENGTH - x) ** 2 * turn @ np.diag([1 / EI_Y, 1 / EI_Z]) @ turn.T)

    closed, _ = quad_vec(bent, 0.0, LENGTH)
    assert compliance(text)[1:3, 1:3] == pytest.approx(closed, rel=1e-4)
    assert modal_compliance(link_of(tmp_path, text))[1:3, 1:3] == pytest.approx(closed, rel=2e-3)


def test_a_force_through_the_centroid_twists_about_the_shear_centre(tmp_path: Path) -> None:
    """Theta = F d L / (GJ), d from the line of force to the shear centre."""
    aside = 0.04
    text = arm(stations(f'shear_center_y="{-aside}"'))
    found = compliance(text)
    assert found[3, 2] == pytest.approx(aside * LENGTH / GJ, rel=1e-6)
    assert found[2, 2] == pytest.approx(
        LENGTH**3 / (3.0 * EI_Z) + aside**2 * LENGTH / GJ, rel=1e-6
    )
    assert abs(found[3, 1]) < 1e-9
    modal = modal_compliance(link_of(tmp_path, text, '--modes', '8'))
    assert modal[3, 2] == pytest.approx(found[3, 2], rel=0.02)


def test_a_force_off_the_centroid_stretches_and_bends() -> None:
    """An axial force on the axis of a beam whose centroid is e aside: u = F L (1/EA + e^2/EI)."""
    text = arm(stations('centroid_y="0.05" ea="2e5" shear_center_z="0.01"'))
    closed = LENGTH * (1.0 / 2e5 + 0.05**2 / EI_Y)
    assert compliance(text)[0, 0] == pytest.approx(closed, rel=1e-6)


@pytest.fixture(scope='module')
def twins(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a plain beam's arm that stands upright, and what `denoc reduce` makes of it."""
    folder = tmp_path_factory.mktemp('twins')
    gauge = (
        '<sensor name="gauge" type="strain_gauge" link="arm" station="0.3" direction="y" '
        'surface="0.02"/><sensor name="imu" type="imu" link="arm" station="1.3" xyz="0 0.1 0"/>'
    )
    # a twist that varies at all has the static one among its shapes
    made = reduced(
        folder, arm(stations(softer=1e-9), more=gauge, place='2 0.1 0.05'), '--modes', '12'
    )
    return folder / 'arm.urdf', made


@pytest.mark.parametrize('gravity', [(0.0, 0.0, 0.0), (-9.81, 0.0, 0.0), (9.81, 0.0, 0.0)])
def test_an_uncoupled_beam_stays_what_it_was(
    twins: tuple[Path, Path], gravity: tuple[float, float, float]
) -> None:
    """Gravity along the beam: the second order stiffens or softens it; rotary inertia is 1e-5."""
    plain, made = (dn.load_robot(path, gravity=gravity) for path in twins)
    expected = plain.natural_frequencies(np.zeros(plain.n))[:5]
    assert made.natural_frequencies(np.zeros(made.n))[:5] == pytest.approx(expected, rel=5e-4)


def test_sensors_of_the_beam_stay(twins: tuple[Path, Path]) -> None:
    plain, made = (dn.load_robot(path, gravity=GRAVITY) for path in twins)
    wrench = {'tool': np.array([0.0, 1.0, 0.5, 0.0, 0.0, 0.0])}
    values, poses = [], []
    for robot in (plain, made):
        q = robot.static_deflection(np.zeros(1), wrench)
        values.append(robot.sensor_values(q))
        poses.append(robot.frame_pose('tool', q))
    assert values[1][0] == pytest.approx(values[0][0], rel=5e-3)
    np.testing.assert_allclose(values[1][1:], values[0][1:], atol=1e-4 * 9.81)
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-4)


def test_energy_of_a_falling_coupled_arm_is_conserved(tmp_path: Path) -> None:
    text = arm(stations('shear_center_y="0.05" angle="0.3"', 'centroid_z="0.03"'))
    made = reduced(tmp_path, text, '--damping', '0')
    robot = dn.load_robot(made, gravity=(0.0, -9.81, 0.0))
    t = np.linspace(0.0, 0.3, 7)
    run = dn.simulate(robot, np.zeros(robot.n), np.zeros(robot.n), t, rtol=1e-10, atol=1e-12)
    total = run.energy.sum(axis=1)
    assert np.ptp(total) < 1e-7 * np.ptp(run.energy[:, 1])


COUPLED = stations('shear_center_y="0.05"')
SHEAR = (
    '<sensor name="cell" type="load_cell" component="shear" link="arm" station="0.1" '
    'direction="y"/>'
)


def test_a_coupled_beam_names_the_way(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r'shear_center_y .* on the beam axis .*denoc reduce'):
        dn.load_robot(arm(COUPLED))


@pytest.mark.parametrize(
    ('text', 'options', 'message'),
    [
        (arm(COUPLED).replace('<torsion modes="3"/>', ''), (), '<torsion> must be given'),
        (arm(COUPLED, more=SHEAR), (), "sensor 'cell' must be a strain gauge"),
        (arm(COUPLED), ('--gauge', 'g=5,0,0,1,0,0'), 'must stand between 0 and 2 m'),
        (arm(COUPLED), ('--gauge', 'g=1,0,0,0,1,0'), 'must be along its axis'),
        (arm(COUPLED).replace('"2" polar', '"2" polar_'), (), 'must be one of'),
    ],
)
def test_a_beam_that_cannot_be_reduced_is_told(
    text: str, options: tuple[str, ...], message: str, tmp_path: Path, capsys: Any
) -> None:
    source = tmp_path / 'arm.urdf'
    source.write_text(text)
    made = str(tmp_path / 'made.urdf')
    assert main(['reduce', str(source), '--link', 'arm', *options, '-o', made]) == 1
    assert message in capsys.readouterr().err


def test_the_reduction_is_told(tmp_path: Path, capsys: Any) -> None:
    reduced(tmp_path, arm(COUPLED))
    row = json.loads(capsys.readouterr().out)
    assert row['mass_kg'] == pytest.approx(4.0, rel=1e-12)
    assert 'inertial="urdf"' in row['block']
