"""What is put into a page's scene, without a page: meshes, arrows, modes, charts."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.types import Array
from denoc_ros.units import round_up
from denoc_ros.viewer.bending import exaggerated, strain_colours
from denoc_ros.viewer.charts import WINDOW, Charts, grouped
from denoc_ros.viewer.folders import MOST_SAG, SWING, ModeShapes, settled, start_configuration
from denoc_ros.viewer.outline import reach
from denoc_ros.viewer.overlays import LONGEST, Arrows, Overlays
from denoc_ros.viewer.view import BANDS, Surfaces


class Recorder:
    """Stands for viser's scene and gui: keeps what is added, by name."""

    def __init__(self) -> None:
        self.added: dict[str, SimpleNamespace] = {}

    def _add(self, name: str, **values: Any) -> SimpleNamespace:
        self.added[name] = SimpleNamespace(**values, name=name)
        return self.added[name]

    def add_mesh_simple(self, name: str, vertices: Array, faces: Array, **more: Any) -> Any:
        return self._add(name, **{'vertices': vertices, 'faces': faces, 'visible': True, **more})

    def add_batched_meshes_simple(self, name: str, *_: Array, **more: Any) -> Any:
        return self._add(name, **more)

    def add_arrows(self, name: str, points: Array, colour: Any, **more: Any) -> Any:
        return self._add(name, points=points, colour=colour, **more)

    def add_folder(self, name: str, **_: Any) -> Any:
        return Folder()

    def add_uplot(self, **more: Any) -> Any:
        return self._add(more['title'], **more)


class Folder:
    """Stands for a folder of viser's gui."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def remove(self) -> None:
        pass


def load(
    repository: Path, name: str, gravity: tuple[float, float, float] = (0, 0, -9.81)
) -> Robot:
    return dn.load_robot(repository / 'config' / 'robots' / f'{name}.urdf', gravity=gravity)


def bent(robot: Robot, amplitude: float) -> Array:
    q = np.linspace(-1.0, 1.0, robot.n)
    q[robot.flexible_indices] = amplitude * np.cos(np.arange(len(robot.flexible_indices)))
    return q


def area(triangles: Array) -> float:
    sides = triangles[:, 1:] - triangles[:, :1]
    return float(0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum())


def test_every_triangle_is_in_the_band_of_its_strain(repository: Path) -> None:
    robot, scene = load(repository, 'ssrms'), Recorder()
    surfaces = Surfaces(scene, robot)
    for amplitude in (0.05, -0.02, 0.05):  # bands shrink and grow
        q = bent(robot, amplitude)
        shape, strains = surfaces.bending.at(q), surfaces.bending.strains(q)
        limit = 0.7 * max(np.abs(strain).max() for strain in strains)
        surfaces.draw(shape, strains, limit)
        drawn = []
        for k in range(BANDS):
            band = scene.added[f'/robot/band_{k}']
            triangles = band.vertices[band.faces].astype(float)
            wide = triangles[[area(t[None]) > 1e-9 for t in triangles]]
            drawn.append(wide)
            assert band.color == tuple(
                strain_colours(np.array([2.0 * k / (BANDS - 1) - 1.0]), 1.0)[0]
            )
        every = [
            s[p.faces] for s, p in zip(shape.surfaces, surfaces.bending.flexible, strict=True)
        ]
        count = sum(len(part) for part in every)
        assert sum(len(part) for part in drawn) == count
        # single precision of metres
        assert sum(map(area, drawn)) == pytest.approx(sum(map(area, every)), rel=1e-4)
        for triangles, part, strain in zip(every, surfaces.bending.flexible, strains, strict=True):
            share = np.clip(strain[part.faces].mean(axis=1) / limit, -1.0, 1.0)
            for index in (0, len(share) // 3, len(share) - 1):
                nearest = int(np.argmin(np.abs(np.linspace(-1.0, 1.0, BANDS) - share[index])))
                gap = np.abs(drawn[nearest] - triangles[index]).max(axis=(1, 2))
                assert gap.min() < 1e-5


def test_without_colour_all_triangles_are_in_one_mesh(repository: Path) -> None:
    robot, scene = load(repository, 'canadarm'), Recorder()
    surfaces = Surfaces(scene, robot)
    q = bent(robot, 0.05)
    for limit in (1e-3, None):
        surfaces.draw(surfaces.bending.at(q), surfaces.bending.strains(q), limit)
    filled = [
        k
        for k in range(BANDS + 1)
        if area((m := scene.added[f'/robot/band_{k}']).vertices[m.faces]) > 0.0
    ]
    assert filled == [BANDS]


def test_ghost_stands_where_links_would_be_straight(repository: Path) -> None:
    robot, scene = load(repository, 'canadarm'), Recorder()
    surfaces = Surfaces(scene, robot)
    q = bent(robot, 0.1)
    straight = exaggerated(robot, q, 0.0)
    surfaces.draw_ghost(surfaces.bending.poses(straight))
    shown = np.vstack([m.vertices for name, m in scene.added.items() if name.startswith('/ghost')])
    tip = robot.frame_pose('link_3', straight)
    # the ghost is 1.5 % smaller than links of at most 6.4 m
    assert np.linalg.norm(shown - tip[:3, 3], axis=1).min() < 0.2
    surfaces.draw_ghost(None)
    assert not any(m.visible for name, m in scene.added.items() if name.startswith('/ghost'))


def test_arrows_keep_their_scale_and_leave_out_rounding() -> None:
    scene = Recorder()
    arrows = Arrows(scene, 'a', 10.0, (0, 0, 0))
    handle = scene.added['/a']
    arrows.draw(np.zeros((1, 3)), np.array([[1e-9, 0.0, 0.0]]))
    assert not handle.visible
    assert arrows.largest == 0.0
    arrows.draw(np.zeros((2, 3)), np.array([[4.0, 0.0, 0.0], [0.0, 1e-7, 0.0]]))
    assert handle.points.shape == (1, 2, 3)
    np.testing.assert_allclose(handle.points[0, 1], [LONGEST * 10.0, 0.0, 0.0])
    arrows.draw(np.ones((1, 3)), np.array([[0.0, 2.0, 0.0]]))
    np.testing.assert_allclose(handle.points[0, 1] - 1.0, [0.0, LONGEST * 5.0, 0.0], atol=1e-6)


def test_torque_arrows_stand_on_their_joints_along_the_axes(repository: Path) -> None:
    robot, scene = load(repository, 'ssrms'), Recorder()
    overlays = Overlays(scene, robot)
    q = bent(robot, 0.01)
    overlays.draw_torques(Snapshot(0.0, q, None, {'joint_2': -3.0}), q)
    (arrow,) = scene.added['/torques'].points
    pose = robot.frame_pose('link_2', q)
    axis = next(b.joint.axis for b in robot.tree.bodies if b.joint and b.joint.name == 'joint_2')
    np.testing.assert_allclose(arrow[0], pose[:3, 3], atol=1e-5)
    length = LONGEST * reach(robot)
    np.testing.assert_allclose(arrow[1] - arrow[0], -length * (pose[:3, :3] @ axis), atol=1e-5)


@pytest.mark.parametrize('name', ['ssrms', 'five_bar_ffff'])
@pytest.mark.parametrize('with_torque', [False, True])
def test_reactions_are_drawn_for_trees_and_loops(
    repository: Path, name: str, with_torque: bool
) -> None:
    robot, scene = load(repository, name, (0, -9.81, 0)), Recorder()
    start = {'joint_1': 1.88, 'joint_2': -1.25, 'joint_3': 1.25, 'joint_4': 1.25}
    q = start_configuration(robot, start)
    torque = dict.fromkeys(robot.joint_names, 10.0) if with_torque else None
    Overlays(scene, robot).draw_reactions(Snapshot(0.0, q, None, torque), q)
    forces = scene.added['/reaction_forces']
    assert forces.visible
    roots = forces.points[:, 0]
    # the body on the base feels the most of a hanging robot's weight: its arrow is there
    assert np.linalg.norm(roots - robot.frame_pose('link_1', q)[:3, 3], axis=1).min() < 1e-5


@pytest.mark.parametrize('name', ['ssrms', 'rssr_fff', 'five_bar_ffff'])
def test_modes_swing_by_the_same_whatever_their_stiffness(repository: Path, name: str) -> None:
    robot = load(repository, name, (0, 0, 0))
    posture = {'joint_1': 2.0, 'joint_2': -3.9, 'joint_3': 0.18} if name == 'rssr_fff' else {}
    q = start_configuration(robot, posture)
    modes = ModeShapes(robot, q)
    assert len(modes.labels) == len(modes.found.frequencies) > 2
    bending = [
        k for k, label in enumerate(robot.coordinate_names) if '/y' in label or '/z' in label
    ]
    for k in range(3):
        quarter = 0.25 / modes.shown_frequency(k)
        swing = modes.at(k, quarter) - modes.q
        assert np.abs(swing[bending]).max() <= SWING * reach(robot) * (1.0 + 1e-9)
        np.testing.assert_allclose(modes.at(k, 0.0), modes.q)
        direction = swing / np.linalg.norm(swing)
        shape = modes.found.shapes[:, k] / np.linalg.norm(modes.found.shapes[:, k])
        assert abs(direction @ shape) == pytest.approx(1.0)


def test_a_robot_made_for_space_does_not_sag_on_the_ground(repository: Path) -> None:
    on_ground = load(repository, 'ssrms')
    assert settled(on_ground, np.zeros(on_ground.n)) is None
    rig = load(repository, 'two_flexible_links')
    rest = settled(rig, np.zeros(rig.n))
    assert rest is not None
    assert np.linalg.norm(rig.tip_deflection('link_1', rest)) < MOST_SAG * 0.2


def test_channels_make_one_chart_per_group() -> None:
    names = ['deflection [m]/predicted', 'torque [N m]/a', 'deflection [m]/true', 'lone']
    assert grouped(names) == {
        'deflection [m]': ['deflection [m]/predicted', 'deflection [m]/true'],
        'torque [N m]': ['torque [N m]/a'],
        '': ['lone'],
    }


def test_live_charts_keep_a_window_and_gaps() -> None:
    gui = Recorder()
    charts = Charts(gui)
    for t in np.arange(0.0, 3.0 * WINDOW, 0.1):
        charts.add(t, {'g/a': np.sin(t)} if t < WINDOW else {'g/a': np.sin(t), 'g/b': 1.0})
    charts.add(3.0 * WINDOW, {'g/a': 0.0})
    charts.draw()
    t, a, b, now = gui.added['g'].data
    assert t[-1] - t[0] == pytest.approx(WINDOW, rel=0.4)  # cut by the quarter
    np.testing.assert_allclose(a, np.sin(t), atol=0.4)
    assert np.isnan(b[-1])
    assert np.nanmax(b) == 1.0
    assert np.isnan(now).all()
    low, high = gui.added['g'].scales['y']['range']
    assert low < -0.99
    assert high > 1.0


def test_a_recorded_chart_marks_the_instant() -> None:
    gui = Recorder()
    charts = Charts(gui)
    t = np.linspace(0.0, 10.0, 101)
    charts.record(t, ['g/a'], np.sin(t)[:, None])
    charts._drawn = -np.inf
    charts.point(5.0)
    now = gui.added['g'].data[-1]
    marked = t[np.isfinite(now)]
    assert len(marked) == 2
    assert marked[0] <= 5.0 <= marked[1]


def test_the_scale_of_colours_is_a_round_number() -> None:
    values = np.array([1.0, 1.1, 2.0, 2.1, 5.1, 9.99, 10.0, 3.3e-5])
    rounded = [round_up(value) for value in values]
    np.testing.assert_allclose(rounded, [1, 2, 2, 5, 10, 10, 10, 5e-5])
