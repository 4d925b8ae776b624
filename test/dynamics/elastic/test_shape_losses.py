"""Shapes by what a beam carries, and how much too stiff shapes make it."""

from __future__ import annotations

import numpy as np
import pytest
from segmented_robots import rod

from denoc_ros.dynamics.elastic.shape_losses import ShapeLoss, shape_losses
from denoc_ros.dynamics.robot import Robot, load_robot

PIN = """<loop name="pin" type="revolute"><parent link="base" xyz="1 0 0"/>
<child link="arm" xyz="1 0 0"/><axis xyz="0 0 1"/></loop>"""


def arm(
    attributes: str = '', modes: int = 2, hung: str = '', at: float = 1.0, more: str = ''
) -> Robot:
    """An arm of 1 m that bends along y and twists, with a link at a station."""
    inertial = f'<inertial>{hung}</inertial>' if hung else ''
    return load_robot(
        f"""<robot name="arm"><link name="base"/>{rod('arm', 1.0, 1.0, 1e-3)}
    <link name="end">{inertial}</link>
    <joint name="hub" type="continuous"><parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/></joint>
    <joint name="tip" type="fixed"><parent link="arm"/><child link="end"/>
    <origin xyz="{at} 0 0"/></joint><flexibility><beam link="arm" length="1" {attributes}>
    <bending direction="y" ei="3" modes="{modes}"/><torsion gj="2" modes="2"/></beam>{more}
    </flexibility></robot>""",
        gravity=(0.0, 0.0, 0.0),
    )


BALL = '<mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'


def losses(robot: Robot) -> dict[tuple[str, str], ShapeLoss]:
    return {(loss.direction, loss.at): loss for loss in shape_losses(robot)}


@pytest.mark.parametrize(
    ('robot', 'shape'),
    [
        (arm(), 'clamped-free'),  # a frame without mass bends nothing
        (arm(hung=BALL), 'craig-bampton'),
        (arm(hung=BALL, at=0.5), 'craig-bampton'),
        (arm(hung=BALL, at=0.0), 'clamped-free'),  # at the root: on the link frame
        (arm(hung=BALL, modes=1), 'clamped-free'),  # too few for the two static shapes
        (arm('shape="clamped-free"', hung=BALL), 'clamped-free'),  # said so
        (arm(more=PIN), 'craig-bampton'),
        (arm('segments="3"', hung=BALL), 'craig-bampton'),
    ],
)
def test_a_beam_that_carries_something_has_shapes_that_turn_under_a_moment(
    robot: Robot, shape: str
) -> None:
    assert losses(robot)['y', 'tip'].shape == shape


def test_two_clamped_free_modes_have_four_fifths_of_the_rotation_under_a_moment() -> None:
    # 1 - sum of (s'(l))^2 / (k l) EI: 20, 10 and 5 percent at 2, 4 and 8 modes; under a force
    # 12 / beta^4 of the modes left out
    for modes, moment in ((2, 0.1986), (4, 0.1007), (8, 0.0505)):
        found = losses(arm('shape="clamped-free"', modes, BALL))['y', 'end']
        assert found.moment == pytest.approx(moment, abs=2e-3)
        assert found.force is not None
        assert 0.0 < found.force < 5e-3
    assert 'craig-bampton' in losses(arm('shape="clamped-free"', 2, BALL))['y', 'end'].remedy


def test_craig_bampton_shapes_lose_nothing_at_the_tip() -> None:
    found = losses(arm(hung=BALL))['y', 'end']
    assert found.force == pytest.approx(0.0, abs=1e-9)
    assert found.moment == pytest.approx(0.0, abs=1e-9)
    assert found.remedy == ''


def test_the_loss_is_what_a_static_wrench_shows() -> None:
    for at in (0.6, 1.0):
        robot = arm('shape="clamped-free"', 3, BALL, at)
        found = losses(robot)['y', 'end']
        for row, exact, lost in ((1, at**3 / 9.0, found.force), (5, at / 3.0, found.moment)):
            wrench = 1e-6 * np.eye(6)[row]
            q = robot.static_deflection(np.zeros(1), {'end': wrench})
            pose = robot.frame_pose('end', q)
            moved = pose[1, 3] if row == 1 else np.arctan2(pose[1, 0], pose[0, 0])
            assert lost is not None
            assert moved / (1e-6 * exact) == pytest.approx(1.0 - lost, rel=1e-5)


def test_the_frequency_that_segments_correct_is_told() -> None:
    heavy = BALL.replace('"0.5"', '"20"').replace('1e-3', '5')
    off = losses(arm('shape="clamped-free"', 2, heavy))['y', 'end'].frequency
    right = losses(arm(hung=heavy))['y', 'end'].frequency
    assert off is not None
    assert right is not None
    assert off > 0.02 > 10 * right
