"""`denoc reduce`: links from meshes and from other programs' matrices."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sparse
import trimesh
from lxml import html
from pyyeti.nastran import op4
from skfem import MeshTet

from denoc_ros.cli.main import main
from denoc_ros.errors import SolverError
from denoc_ros.model.beams.link_file import read
from denoc_ros.reduction import craig_bampton
from denoc_ros.reduction.body import patches_of
from denoc_ros.reduction.elements import Elasticity, Solid
from denoc_ros.reduction.formats.matrices import read_matrices
from denoc_ros.reduction.link import Reduction, Wishes, reduce_link
from denoc_ros.reduction.mesh import patch_nodes
from denoc_ros.reduction.reduce_link import Frames, reduce_solid
from denoc_ros.types import Array

LENGTH, WIDTH, HEIGHT = 0.4, 0.004, 0.008  # m
YOUNG, POISSON, DENSITY = 70e9, 0.3, 2700.0
SHEAR = YOUNG / (2.0 * (1.0 + POISSON))
STEEL = Elasticity.of(YOUNG, SHEAR, DENSITY)
MATERIAL = ('--young', '70e9', '--poisson', '0.3', '--density', '2700')
TIP = ('--frame', f'tip={LENGTH},0,0')
URDF = """<robot name="arm"><link name="base"/><link name="fore">
<inertial><mass value="0.05"/><origin xyz="0.2 0 0"/>
<inertia ixx="1e-5" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="box.stl" scale="0.001 0.001 0.001"/></geometry></visual></link>
<link name="hand"><inertial><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="base"/><child link="fore"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/><origin xyz="0.4 0 0"/>
</joint></robot>"""


def block(along: int = 50) -> Solid:
    """Return the block as bricks of tetrahedra; no mesher is involved."""
    mesh = MeshTet.init_tensor(
        np.linspace(0.0, LENGTH, along + 1),
        np.linspace(-WIDTH / 2, WIDTH / 2, 2),
        np.linspace(-HEIGHT / 2, HEIGHT / 2, 3),
    )
    return Solid('block', mesh.p.T, mesh.t.T, STEEL)


def tip_frames(length: float = LENGTH) -> Frames:
    pose = np.eye(4)
    pose[0, 3] = length
    return Frames({'tip': pose}, {})


@pytest.fixture(scope='module')
def reduced() -> Reduction:
    return reduce_solid(block(), tip_frames(), Wishes(), 'block')


@pytest.fixture(scope='module')
def stl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the block's surface in millimetres."""
    mesh = trimesh.creation.box((1e3 * LENGTH, 1e3 * WIDTH, 1e3 * HEIGHT))
    mesh.apply_translation((500.0 * LENGTH, 0.0, 0.0))
    file = tmp_path_factory.mktemp('surface') / 'box.stl'
    mesh.export(file)
    return file


@pytest.mark.long
def test_meshed_block_bends_as_timoshenkos_beam(stl: Path, tmp_path: Path) -> None:
    """Exudyn's check: 1 N at the tip of 400 x 8 x 4 mm; linear tetrahedra lack 10 % at 2 mm."""
    options = ('--units', 'mm', *MATERIAL, *TIP, '--edge', '0.004', '--no-coarser', '--json')
    assert main(['reduce', str(stl), *options, '-o', str(tmp_path / 'box.npz')]) == 0
    link = read(tmp_path / 'box.npz')
    tip = link.frames['tip']
    sag = (tip.phi**2 / link.stiffness).sum(axis=1)
    for axis, across, deep in ((1, HEIGHT, WIDTH), (2, WIDTH, HEIGHT)):
        inertia = across * deep**3 / 12.0
        bending = LENGTH**3 / (3.0 * YOUNG * inertia)
        sheared = bending + LENGTH / (5.0 / 6.0 * SHEAR * across * deep)
        assert sag[axis] == pytest.approx(sheared, rel=3e-3)
        first = 1.8751041**2 * np.sqrt(YOUNG * inertia / (DENSITY * WIDTH * HEIGHT)) / LENGTH**2
        nearest = np.abs(link.frequencies / (first / (2.0 * np.pi)) - 1.0).min()
        assert nearest < 3e-3
    assert sag[2] == pytest.approx(1.78571e-3, rel=3e-3)


def test_points_hold_the_bodys_integrals(reduced: Reduction) -> None:
    link = reduced.link
    mass = DENSITY * LENGTH * WIDTH * HEIGHT
    assert link.mass == pytest.approx(mass, rel=1e-12)
    assert link.com == pytest.approx([LENGTH / 2, 0.0, 0.0], abs=1e-12)
    exact = [
        mass * (WIDTH**2 + HEIGHT**2) / 12.0,
        mass * (LENGTH**2 / 3.0 + HEIGHT**2 / 12.0),
        mass * (LENGTH**2 / 3.0 + WIDTH**2 / 12.0),
    ]
    assert np.diag(link.inertia) == pytest.approx(exact, rel=1e-10)
    phi = link.points[:, 4:22].reshape(len(link.points), 6, 3)
    assert np.einsum('kia,kja->ij', phi, phi) == pytest.approx(np.eye(6), abs=1e-9)


def slender_block() -> Solid:
    mesh = MeshTet.init_tensor(
        np.linspace(0.0, 0.4, 9), np.linspace(-0.05, 0.05, 3), np.linspace(-0.05, 0.05, 3)
    )
    return Solid('block', mesh.p.T, mesh.t.T, STEEL)


def test_large_bodies_are_refined_to_the_same_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for rows in (craig_bampton.FACTORED, 0):
        monkeypatch.setattr(craig_bampton, 'FACTORED', rows)
        found.append(reduce_solid(slender_block(), tip_frames(), Wishes(), 'block').link)
    factored, refined = found
    assert refined.frequencies == pytest.approx(factored.frequencies, rel=1e-8)
    sags = [(link.frames['tip'].phi ** 2 / link.stiffness).sum(axis=1) for link in found]
    assert sags[1] == pytest.approx(sags[0], rel=1e-7)
    curves = [link.frames['tip'].quadratic for link in found]
    sizes = [np.sort(np.linalg.norm(curve, axis=0)) for curve in curves]  # of either sign
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-6, abs=1e-6 * sizes[0].max())


@pytest.mark.parametrize(
    ('name', 'value', 'match'),
    [
        ('MOST_STEPS', 1, 'block: conjugate gradients must converge for .* got none in 1 steps'),
        ('LARGEST_RESIDUAL', 0.0, 'block: modes must converge: .* got a residual of'),
    ],
)
def test_a_large_body_that_does_not_converge_is_told(
    name: str, value: float, match: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(craig_bampton, 'FACTORED', 0)
    monkeypatch.setattr(craig_bampton, name, value)
    with pytest.raises(SolverError, match=match):
        reduce_solid(slender_block(), tip_frames(), Wishes(), 'block')


def test_sag_at_the_frame_is_that_of_the_whole_mesh(reduced: Reduction) -> None:
    tip = reduced.link.frames['tip']
    sag = (tip.phi**2 / reduced.link.stiffness).sum(axis=1)
    assert sag[1:] == pytest.approx(reduced.compliance['tip'][1:3], rel=1e-9)
    assert reduced.link.left_out['tip'][1:3] == pytest.approx(0.0, abs=1e-6)
    assert reduced.link.left_out['tip'][0] > 50.0  # no mode stretches it


def test_tip_mass_makes_the_first_mode_that_of_the_loaded_link() -> None:
    wishes = Wishes(modes=2, tip_mass={'tip': 10.0}, quadratic='none')
    link = reduce_solid(block(), tip_frames(), wishes, 'block').link
    tip = link.frames['tip'].phi
    loaded = np.eye(2) + 10.0 * tip.T @ tip
    slowest = np.linalg.eigvals(np.linalg.solve(loaded, np.diag(link.stiffness))).min()
    soft = YOUNG * HEIGHT * WIDTH**3 / 12.0
    carried = 10.0 + 33.0 / 140.0 * link.mass  # Rayleigh, exact for a heavy tip
    assert slowest == pytest.approx(3.0 * soft / LENGTH**3 / carried, rel=5e-3)


def test_quadratic_force_keeps_finite_turns_free_of_stress() -> None:
    """A turn to the second order, t w x r + t^2/2 w x (w x r), needs no force."""
    solid = block(3)
    axis = np.array([0.3, -0.5, 0.8])
    first = np.cross(axis, solid.nodes)
    second = np.cross(axis, first)
    body = solid.body()
    linear = body.displacement(body.stiffness @ body.values(second))
    quadratic = solid.quadratic_force(first, first)
    assert np.abs(linear).max() > 1.0
    assert linear + quadratic == pytest.approx(0.0, abs=1e-9 * np.abs(linear).max())


def test_bent_block_shortens_as_a_line_of_constant_length() -> None:
    """Both ways to the second order give 3/5 w^2 / L under a force at the tip."""
    for kind in ('derivatives', 'line'):
        link = reduce_solid(block(), tip_frames(), Wishes(quadratic=kind), 'block').link
        tip = link.frames['tip']
        for axis in (1, 2):
            d = tip.phi[axis] / link.stiffness
            sag = tip.phi[axis] @ d
            weights = np.where(link.pairs[:, 0] == link.pairs[:, 1], 0.5, 1.0)
            moved = tip.quadratic @ (weights * d[link.pairs[:, 0]] * d[link.pairs[:, 1]])
            assert moved[0] / sag**2 == pytest.approx(-0.6 / LENGTH, rel=4e-3)


def test_gauge_reads_the_strain_of_a_bent_beam() -> None:
    place, along = np.array([LENGTH / 2, 0.0, HEIGHT / 2]), np.array([1.0, 0.0, 0.0])
    wishes = Wishes(gauges={'g': (place, along)}, quadratic='none')
    link = reduce_solid(block(), tip_frames(), wishes, 'block').link
    d = link.frames['tip'].phi[2] / link.stiffness
    inertia = WIDTH * HEIGHT**3 / 12.0
    bent = -(LENGTH / 2) * (HEIGHT / 2) / (YOUNG * inertia)  # 1 N upwards compresses the top
    assert link.strain['g'].row @ d == pytest.approx(bent, rel=2e-2)


@pytest.fixture(scope='module')
def calculix(repository: Path) -> Path:
    return repository / 'test' / 'data' / 'calculix'


def test_stiffness_is_calculixs(calculix: Path) -> None:
    body = read_matrices(calculix / 'block.sti', None, None)
    order = np.concatenate([body.rows(axis) for axis in range(3)])
    mesh = MeshTet.init_tensor(
        np.linspace(0.0, 0.1, 3), np.linspace(-0.005, 0.005, 2), np.linspace(-0.005, 0.005, 2)
    )
    own = Solid('block', mesh.p.T, mesh.t.T, STEEL).body()
    assert body.nodes == pytest.approx(own.nodes, abs=1e-12)
    off = abs(body.stiffness[order][:, order] - own.stiffness).max()
    assert off < 1e-12 * abs(own.stiffness).max()
    assert body.mass.sum() == pytest.approx(own.mass.sum(), rel=1e-9)


def test_formats_of_other_programs_give_the_same_link(calculix: Path, tmp_path: Path) -> None:
    body = read_matrices(calculix / 'block.sti', None, None)
    order = np.argsort(body.dof_nodes * 3 + body.dof_axes, kind='stable')
    stiffness, mass = (each[order][:, order] for each in (body.stiffness, body.mass))
    table = np.column_stack([np.arange(1, len(body.nodes) + 1), body.nodes])
    np.savetxt(tmp_path / 'nodes.txt', table)
    np.savez(
        tmp_path / 'all.npz', nodes=body.nodes, stiffness=stiffness.toarray(), mass=mass.toarray()
    )
    for name, matrix in (('k', stiffness), ('m', mass)):
        scipy.io.mmwrite(tmp_path / f'{name}.mtx', matrix, precision=16)
        lower = sparse.tril(matrix).tocoo()
        rows = zip(lower.row, lower.col, lower.data, strict=True)
        lines = [f'{r // 3 + 1},{r % 3 + 1},{c // 3 + 1},{c % 3 + 1},{v:.16e}' for r, c, v in rows]
        (tmp_path / f'{name}_abaqus.mtx').write_text('\n'.join(lines), encoding='ascii')
    op4.write(str(tmp_path / 'both.op4'), {'KGG': stiffness.toarray(), 'MGG': mass.toarray()})
    nodes = str(tmp_path / 'nodes.txt')
    bodies = [
        body,
        read_matrices(tmp_path / 'all.npz', None, None),
        read_matrices(tmp_path / 'k.mtx', str(tmp_path / 'm.mtx'), nodes),
        read_matrices(tmp_path / 'k_abaqus.mtx', str(tmp_path / 'm_abaqus.mtx'), nodes),
        read_matrices(tmp_path / 'both.op4', None, nodes),
        read_matrices(calculix / 'block.sti', None, None, 0.001),
    ]
    first = []
    for each in bodies:
        size = float(np.ptp(each.nodes[:, 0]))
        frames = Frames(tip_frames(size).outer, {'*': 0.08 * size})
        places = frames.rows()
        patches = patches_of(
            'block', each.nodes, places, patch_nodes(each.nodes, None, frames.radii)
        )
        first.append(reduce_link(each, None, patches, Wishes(modes=2), 'block').link.frequencies)
    for other in first[1:-1]:
        assert other == pytest.approx(first[0], rel=1e-9)
    # the same numbers as N/mm and t: masses are 1000 times as large, stiffnesses too
    assert first[-1] == pytest.approx(first[0], rel=1e-9)


@pytest.mark.long
def test_link_of_a_urdf_takes_mesh_scale_joints_and_mass(
    stl: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(stl, tmp_path / 'box.stl')
    (tmp_path / 'arm.urdf').write_text(URDF, encoding='utf-8')
    options = ('--link', 'fore', '--material', 'steel', '--mass', 'scale', '--edge', '0.008')
    page = tmp_path / 'page.html'
    command = ['reduce', str(tmp_path / 'arm.urdf'), *options, '--page', str(page), '--json']
    assert main([*command, '-o', str(tmp_path / 'flexible.urdf')]) == 0
    row = json.loads(capsys.readouterr().out)
    assert row['modes'][0]['coarser_hz'] == pytest.approx(row['modes'][0]['hz'], rel=5e-3)
    link = read(tmp_path / 'fore.npz')
    assert link.mass == pytest.approx(0.05, rel=1e-9)
    assert link.frames['wrist'].origin == pytest.approx([LENGTH, 0.0, 0.0])
    written = (tmp_path / 'flexible.urdf').read_text(encoding='utf-8')
    assert '<flexible link="fore" file="fore.npz" inertial="file"/>' in written
    shown = page.read_text(encoding='utf-8').replace('\xa0', ' ')
    assert shown.count('data:image/png') == 6
    assert 'URDF: 0.05 kg' in html.fromstring(shown).text_content()


def open_surface(folder: Path) -> list[str]:
    mesh = trimesh.creation.box((LENGTH, WIDTH, HEIGHT))
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(folder / 'open.stl')
    return ['open.stl', '--units', 'm', *MATERIAL, *TIP]


def archive(folder: Path, **change: Any) -> list[str]:
    body = block(2).body()
    order = np.argsort(body.dof_nodes * 3 + body.dof_axes, kind='stable')
    arrays: dict[str, Array] = {
        'nodes': body.nodes,
        'stiffness': body.stiffness[order][:, order].toarray(),
        'mass': body.mass[order][:, order].toarray(),
    }
    for name, edit in change.items():
        arrays[name] = edit(arrays[name])
    given: dict[str, Any] = {k: v for k, v in arrays.items() if v is not None}
    np.savez(folder / 'all.npz', **given)
    return ['all.npz', *TIP, '--radius', '0.01']


def cut(folder: Path) -> list[str]:
    command = archive(folder)
    whole = (folder / 'all.npz').read_bytes()
    (folder / 'all.npz').write_bytes(whole[: len(whole) // 2])
    return command


def loose(matrix: Array) -> Array:
    """Return a stiffness without what holds the last node."""
    matrix[-9:, :] = matrix[:, -9:] = 0.0
    return matrix


BAD = {
    'open': (open_surface, r'mesh must be closed: .*got 3 of \d+ edges'),
    'units': (lambda _: ['box.stl', *MATERIAL, *TIP], '--units or --scale must be given'),
    'large': (lambda _: ['box.stl', '--units', 'm', *MATERIAL, *TIP], 'm across, got 400.1 m'),
    'off': (
        lambda _: ['box.stl', '--units', 'mm', *MATERIAL, '--frame', 'tip=9,0,0'],
        "frame 'tip' must be at the mesh.* got 8.6 m off",
    ),
    'material': (lambda _: ['box.stl', '--units', 'mm', *TIP], 'material must be given by name'),
    'singular': (lambda f: archive(f, stiffness=loose), 'stiffness must be positive definite'),
    'negative': (lambda f: archive(f, mass=lambda m: -m), 'mass of each degree of freedom must'),
    'zeros': (lambda f: archive(f, stiffness=lambda k: 0.0 * k), 'got zeros only'),
    'no nodes': (lambda f: archive(f, nodes=lambda _: None), r"'nodes' \(n, 3\) must be given"),
    'size': (lambda f: archive(f, nodes=lambda n: n[1:]), 'must have 3 or 6 rows for each of'),
    'nan': (lambda f: archive(f, mass=lambda m: m * np.nan), 'mass matrix must be finite'),
    'lopsided': (lambda f: archive(f, mass=np.triu), 'mass matrix must be symmetric'),
    'pickle': (lambda f: archive(f, mass=lambda m: m.astype(object)), 'npz of numbers, got'),
    'cut': (cut, 'must be a whole .npz'),
    'no mass': (lambda f: archive(f, mass=lambda _: None), 'mass matrix must be given'),
}


@pytest.mark.parametrize('name', BAD)
def test_bad_input_is_refused_by_name(
    name: str,
    stl: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    make, message = BAD[name]
    monkeypatch.chdir(tmp_path)
    shutil.copy(stl, tmp_path / 'box.stl')
    assert main(['reduce', *make(tmp_path), '-o', 'link.npz', '--json']) == 1
    said = capsys.readouterr().err
    assert re.search(message, said), said
    assert not (tmp_path / 'link.npz').exists()


def test_missing_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr('denoc_ros.reduction.reduce_verb.EXTRA', ('no_such_mesher',))
    assert main(['reduce', 'box.stl', *TIP, '-o', 'link.npz']) == 1
    assert "no_such_mesher must be installed: pip install 'denoc_ros[reduce]'" in (
        capsys.readouterr().err
    )
