"""A link of segments as it is drawn: one surface and one line along all of it."""

from __future__ import annotations

import numpy as np
from segmented_robots import spatial_text, strip

import denoc_ros as dn
from denoc_ros.nodes.markers import CentreLines
from denoc_ros.viewer.bending import Bending
from denoc_ros.viewer.outline import reach

MOMENT = 1.3  # N m, of EI 1 N m^2 over 1 m: the tip turns by as many radians


def bent() -> tuple[dn.Robot, np.ndarray]:
    """A strip bent to an arc of a circle."""
    robot = strip(12)
    load = {'tip': (0, 0, 0, 0, 0, MOMENT)}
    return robot, robot.static_deflection(np.zeros(0), wrenches=load)


def test_the_surface_follows_the_arc() -> None:
    robot, q = bent()
    bending = Bending(robot)
    (part,) = bending.flexible
    assert part.link == 'strip'
    flat = bending.at(0.0 * q).surfaces[0]
    drawn = bending.at(q).surfaces[0]
    radius = 1.0 / MOMENT
    angle, out = flat[:, 0] / radius, flat[:, 1]
    arc = np.column_stack([
        (radius - out) * np.sin(angle), radius - (radius - out) * np.cos(angle), flat[:, 2],
    ])  # fmt: skip
    # twelve segments turn by 0.1 rad each: an angle is off by its cube over 60
    np.testing.assert_allclose(drawn, arc, atol=1e-3)
    assert len(np.unique(np.round(angle, 6))) > 12


def test_the_strain_is_that_of_the_arc() -> None:
    robot, q = bent()
    bending = Bending(robot)
    flat = bending.at(0.0 * q).surfaces[0]
    np.testing.assert_allclose(bending.strains(q)[0], -MOMENT * flat[:, 1], atol=1e-9)


def test_the_marker_s_line_follows_the_arc() -> None:
    robot, q = bent()
    lines = CentreLines(robot).points(q)
    assert [(link, flexible) for link, flexible, _ in lines] == [('strip', True)]
    radius = 1.0 / MOMENT
    distance = np.linalg.norm(lines[0][2][:, :2] - [0.0, radius], axis=1)
    np.testing.assert_allclose(distance, radius, atol=1e-3)


def test_every_link_of_the_arm_has_one_line_and_one_surface() -> None:
    robot = dn.load_robot(spatial_text(3))
    q = np.zeros(robot.n)
    names = [link for link, _, _ in CentreLines(robot).points(q)]
    assert sorted(names) == ['fore', 'upper']
    assert [part.link for part in Bending(robot).flexible] == ['upper', 'fore']
    whole = dn.load_robot(spatial_text(1))
    np.testing.assert_allclose(reach(robot), reach(whole), rtol=1e-12)
