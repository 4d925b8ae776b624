"""Damping by the joints: power, eigenvalues, and a simulated arm that comes to rest sooner."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from planar_chains import PlanarLink, planar_chain

import denoc_ros as dn
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.feedback.strain_damping import StrainDamping
from denoc_ros.types import Array

ARM = (PlanarLink(1.0, 2.0, 150.0), PlanarLink(0.8, 1.0, 60.0))
GAUGES = ''.join(
    f'<sensor name="{link}_{where}" type="strain_gauge" link="{link}" station="{station}"'
    f' direction="y" surface="0.01" topic="/strain"/>'
    for link in ('link_1', 'link_2')
    for where, station in (('middle', 0.4), ('root', 0.02))
)
JOINTS = ('joint_1', 'joint_2')
GAINS = (300.0, 60.0)
LIMITS = (20.0, 20.0)


def arm(armature: float = 0.5, sensors: str = GAUGES) -> dn.Robot:
    text = planar_chain(ARM, 2, damping_ratio=0.005, sensors=sensors)
    robot = dn.load_robot(text, gravity=(0, 0, 0))
    return robot.with_overrides({f'joint.{joint}.armature': armature for joint in JOINTS})


def damping(robot: dn.Robot, scale: float = 1.0, delay: float = 1.5e-3) -> StrainDamping:
    return StrainDamping(robot, JOINTS, scale * np.array(GAINS), LIMITS, 100.0, delay)


def bent(robot: dn.Robot, reach: float) -> Array:
    """Coordinates with both tips deflected."""
    q = np.zeros(robot.n)
    q[robot.flexible_indices] = reach * np.array([1.0, 0.0, -0.5, 0.0])
    return q


def ratios(system: Array) -> Array:
    """Damping ratios of what oscillates slower than 50 Hz."""
    values = np.linalg.eigvals(system)
    values = values[(values.imag > 1.0) & (np.abs(values) < 300.0)]
    return np.sort(-values.real / np.abs(values))


def test_gauge_at_the_root_is_read() -> None:
    robot = arm()
    names = [robot.tree.sensors[place].name for place in damping(robot).places]
    assert names == ['link_1_root', 'link_2_root']


def test_every_mode_is_damped_more() -> None:
    robot = arm()
    for posture in ([0.0, 0.0], [0.3, 1.2], [-2.0, -0.4]):
        q = np.zeros(robot.n)
        q[robot.joint_indices] = posture
        with_torque = ratios(damping(robot).closed_loop(robot, q))
        without = ratios(damping(robot, 1e-9).closed_loop(robot, q))
        assert len(with_torque) >= 3
        assert with_torque[0] > 1.5 * without[0]


def test_simulated_arm_comes_to_rest_sooner() -> None:
    left = []
    for scale in (0.0, 1.0):
        robot = arm()
        stepper, found = Stepper(robot.copy(), 1e-3), damping(robot, scale)
        q, qd, tau = bent(robot, 0.02), np.zeros(robot.n), np.zeros(robot.n)
        start = robot.energy(q, qd).sum()
        for _ in range(1500):
            values = robot.sensor_values(q)[found.places]
            tau[robot.joint_indices] = found.torque(values, 1e-3)
            stepper.free(q, qd, tau)
        left.append(robot.energy(q, qd).sum() / start)
    assert left[1] < 0.5 * left[0]


def test_torque_is_that_of_the_closed_loop_shown() -> None:
    robot = arm()
    found, step = damping(robot, delay=0.0), 1e-4
    stepper = Stepper(robot.copy(), step)
    q, qd, tau = bent(robot, 1e-5), np.zeros(robot.n), np.zeros(robot.n)
    values = robot.sensor_values(q)[found.places]
    start = np.concatenate((q, qd, values, np.zeros(2)))
    for _ in range(1000):
        tau[robot.joint_indices] = found.torque(robot.sensor_values(q)[found.places], step)
        stepper.free(q, qd, tau)
    system = found.closed_loop(robot, np.zeros(robot.n))
    expected = (scipy.linalg.expm(0.1 * system) @ start)[: robot.n]
    # the torque is held over steps of 0.1 ms, 0.06 of the filter's time
    np.testing.assert_allclose(q, expected, atol=0.02 * np.abs(expected).max())


def test_torque_is_limited_and_none_without_a_value() -> None:
    found = damping(arm())
    assert not found.torque(np.zeros(2), 1e-3).any()
    np.testing.assert_array_equal(np.abs(found.torque(np.array([1.0, -1.0]), 1e-3)), LIMITS)
    np.testing.assert_array_equal(found.torque(np.array([np.nan, -1.0]), 1e-3)[0], 0.0)
    found.reset()
    assert not found.torque(np.array([3.0, 3.0]), 1e-3).any()


@pytest.mark.parametrize(
    ('robot', 'change', 'message'),
    [
        ({}, {'delay': 0.05}, 'must take power from every mode, got one at'),
        ({'armature': 0.0}, {}, 'must take power from every mode, got one at'),
        ({'sensors': ''}, {}, "'joint_1' must have a strain gauge with a topic"),
        ({}, {'gains': (1.0,)}, 'gains must be 2 finite numbers >= 0'),
        ({}, {'gains': (1.0, -1.0)}, r'>= 0, got \[1.0, -1.0\]'),
        ({}, {'bandwidth': 0.0}, 'bandwidth must be > 0 Hz'),
    ],
)
def test_what_does_not_dissipate_is_refused(
    robot: dict[str, object], change: dict[str, object], message: str
) -> None:
    given = {'gains': GAINS, 'limits': LIMITS, 'bandwidth': 100.0, 'delay': 0.0, **change}
    with pytest.raises(dn.StateError, match=message):
        StrainDamping(arm(**robot), JOINTS, **given)  # type: ignore[arg-type]
