"""The drawn surface against the robot's own kinematics and beam theory."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from strategies import seeded_robot
from yourdfpy import URDF

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import rotations
from denoc_ros.types import Array
from denoc_ros.viewer.bending import Bending, BentLink, cut_along, exaggerated, strain_colours
from denoc_ros.viewer.outline import outlines

ROBOTS = ('canadarm', 'ssrms', 'stanford_flexible', 'two_flexible_links', 'ur10', 'five_bar_ffff')


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, repository: Path) -> Robot:
    return dn.load_robot(repository / 'config' / 'robots' / f'{request.param}.urdf')


def state(robot: Robot, seed: int, amplitude: float) -> Array:
    """Return coordinates with joints within 1 and amplitudes within a number."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, robot.n)
    q[robot.flexible_indices] *= amplitude
    return q


def points(bending: Bending, q: Array) -> dict[str, list[Array]]:
    """Return the vertices of every outline in the base frame, by link."""
    shape = bending.at(q)
    found: dict[str, list[Array]] = {}
    for part, pose in zip(bending.rigid, shape.poses, strict=True):
        found.setdefault(part.link, []).append(part.vertices @ pose[:3, :3].T + pose[:3, 3])
    for bent, surface in zip(bending.flexible, shape.surfaces, strict=True):
        found.setdefault(bent.link, []).append(surface)
    return found


def test_undeformed_surface_stands_where_the_urdf_puts_it(robot: Robot) -> None:
    q = state(robot, 1, 0.0)
    with_names = dict(zip(robot.joint_names, q[robot.joint_indices], strict=True))
    rigid = rigid_robot(robot.tree.source)
    rigid.update_cfg(with_names)
    drawn = points(Bending(robot), q)
    for outline in outlines(robot):
        pose = rigid.get_transform(outline.link)
        expected = outline.vertices @ pose[:3, :3].T + pose[:3, 3]
        surfaces = np.vstack(drawn[outline.link])
        # a bent surface has more vertices, but all of the outline's: both ends of its box
        gap = [np.linalg.norm(surfaces - point, axis=1).min() for point in expected]
        assert max(gap) < 1e-9  # m; rounding of two chains of products, links of metres


def rigid_robot(text: str) -> URDF:
    """Return the library's own reading of the same file."""
    return URDF.load(io.BytesIO(text.encode()), load_meshes=False)


@pytest.mark.parametrize('scale', [1.0, 20.0])
def test_tip_vertices_move_with_the_tip_frame(repository: Path, scale: float) -> None:
    robot = dn.load_robot(repository / 'config' / 'robots' / 'ssrms.urdf')
    bending = Bending(robot)
    q = exaggerated(robot, state(robot, 2, 0.05), scale)
    still = state(robot, 2, 0.0)
    # what is fixed to the tip of link 3: the frame of link 4 up to its joint's turn
    for link, child in (('link_2', 'link_3'), ('link_3', 'link_4')):
        before = robot.frame_pose(child, still)
        after = robot.frame_pose(child, q)
        (index,) = [k for k, part in enumerate(bending.flexible) if part.link == link]
        part = bending.flexible[index]
        assert isinstance(part, BentLink)
        length = part.stations.max()
        undeformed = bending.at(still).surfaces[index]
        root = robot.frame_pose(link, still)
        at_tip = np.isclose((undeformed - root[:3, 3]) @ root[:3, 0], length)
        assert at_tip.sum() == 9  # the corners, the middles of the edges and the end's middle
        local = (undeformed[at_tip] - before[:3, 3]) @ before[:3, :3]
        expected = local @ after[:3, :3].T + after[:3, 3]
        np.testing.assert_allclose(bending.at(q).surfaces[index][at_tip], expected, atol=1e-9)


@pytest.mark.parametrize('seed', range(4))
def test_scale_enlarges_small_deflections_in_proportion(seed: int) -> None:
    robot = dn.load_robot(seeded_robot(seed))
    bending = Bending(robot)
    q = state(robot, seed, 1e-6)
    still = points(bending, exaggerated(robot, q, 0.0))
    once = points(bending, exaggerated(robot, q, 1.0))
    hundred = points(bending, exaggerated(robot, q, 100.0))
    moved = 0.0
    for link in still:
        for a, b, c in zip(still[link], once[link], hundred[link], strict=True):
            moved = max(moved, float(np.abs(b - a).max()))
            # second-order terms: (100 x 1e-6 of slope)^2, arms of metres
            np.testing.assert_allclose(c - a, 100.0 * (b - a), atol=1e-6)
    assert moved > 1e-7 or not len(robot.flexible_indices)


def test_strain_is_surface_times_curvature(repository: Path) -> None:
    robot = dn.load_robot(repository / 'config' / 'robots' / 'ssrms.urdf')
    bending = Bending(robot)
    q = state(robot, 3, 0.05)
    still = state(robot, 3, 0.0)
    h = 1e-3  # m; differences of second order are off by h^2 s'''' / 12, about 1e-7 here
    for index, part in enumerate(bending.flexible):
        assert isinstance(part, BentLink)
        frame = robot.frame_pose(part.link, still)
        local = (bending.at(still).surfaces[index] - frame[:3, 3]) @ frame[:3, :3]
        strain = bending.strains(q)[index]
        inner = (local[:, 0] > 0.1) & (local[:, 0] < part.stations.max() - 0.1)
        assert np.abs(strain[inner]).max() > 1e-4
        for vertex in np.flatnonzero(inner)[::7]:
            x = local[vertex, 0]
            u = [robot.tip_deflection(part.link, q, x + step)[1:] for step in (-h, 0.0, h)]
            curvature = (u[0] - 2.0 * u[1] + u[2]) / h**2
            assert strain[vertex] == pytest.approx(-local[vertex, 1:] @ curvature, abs=1e-7)


def test_loops_stay_closed_however_large_the_deflection_is_drawn(repository: Path) -> None:
    robot = dn.load_robot(repository / 'config' / 'robots' / 'five_bar_ffff.urdf')
    guess = np.zeros(robot.n)
    guess[robot.joint_indices] = (2.0, -1.2, 1.1, 1.2)
    guess[robot.flexible_indices] = 1e-3
    q = robot.assemble(guess)
    assert np.array_equal(exaggerated(robot, q, 1.0), q)
    for scale in (0.0, 10.0, 50.0):
        drawn = exaggerated(robot, q, scale)
        flexible = robot.flexible_indices
        np.testing.assert_array_equal(drawn[flexible], scale * q[flexible])
        assert np.abs(robot.closure(drawn)).max() < 1e-6


def test_rotations_are_the_exponential() -> None:
    from scipy.spatial.transform import Rotation

    vectors = np.vstack([np.zeros(3), np.random.default_rng(0).normal(size=(20, 3))])
    # rounding of a sine near pi
    np.testing.assert_allclose(
        rotations(vectors), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-14
    )


@pytest.mark.parametrize('shape', ['box', 'turned box', 'cylinder', 'sphere'])
def test_cutting_leaves_the_surface_as_it_was(shape: str) -> None:
    solid = {
        'box': trimesh.creation.box(extents=(2.0, 0.2, 0.1)),
        'turned box': trimesh.creation.box(extents=(2.0, 0.2, 0.1)),
        'cylinder': trimesh.creation.cylinder(radius=0.1, segment=[[0, 0, 0], [2, 0, 0]]),
        'sphere': trimesh.creation.icosphere(radius=0.7),
    }[shape]
    if shape == 'turned box':
        solid.apply_transform(trimesh.transformations.rotation_matrix(0.5, [1, 0, 0]))
    solid.apply_translation((0.3, 0.0, 0.0))
    cut = trimesh.Trimesh(*cut_along(np.array(solid.vertices), np.array(solid.faces), 2.0))
    # the slicing library joins points nearer than its 1e-8 m
    assert cut.volume == pytest.approx(solid.volume, rel=1e-6)
    assert cut.area == pytest.approx(solid.area, rel=1e-6)
    width = np.ptp(cut.vertices[cut.faces][:, :, 0], axis=1)
    inside = (cut.triangles_center[:, 0] > 0.1) & (cut.triangles_center[:, 0] < 1.9)
    assert width[inside].max() < 0.1 + 1e-6  # a twentieth of 2 m


def test_colours_of_strain_are_even_and_bounded() -> None:
    strain = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    colours = strain_colours(strain, 1.0)
    np.testing.assert_array_equal(colours[0], colours[1])
    np.testing.assert_array_equal(colours[3], colours[4])
    assert len(np.unique(colours, axis=0)) == 3
    assert colours[0, 2] > colours[0, 0]  # pressed: blue
    assert colours[4, 0] > colours[4, 2]  # stretched: red


def test_a_link_without_a_drawable_visual_gets_a_plain_body(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = """<robot name="r"><link name="a"><visual><geometry><mesh filename="gone.stl"/>
    </geometry></visual></link><link name="b"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
    <joint name="j" type="revolute"><parent link="a"/>
    <child link="b"/><origin xyz="0 0 2"/><axis xyz="0 1 0"/>
    <limit effort="1" velocity="1" lower="-1" upper="1"/></joint></robot>"""
    drawn = outlines(dn.load_robot(text), tmp_path)
    assert 'gone.stl' in caplog.text
    rod = next(outline for outline in drawn if outline.link == 'a')
    assert rod.vertices[:, 2].max() == pytest.approx(2.0)  # up to the joint
    assert {outline.link for outline in drawn} == {'a', 'b'}
