"""Gauges and load cells by mode acceleration: the moment of all that lies beyond the station."""

from __future__ import annotations

import numpy as np
import pytest

import denoc_ros as dn
from denoc_ros.types import Array

MASS, LENGTH, EI, TOOL, G = 3.0, 2.0, 2000.0, 1.0, 9.81  # kg/m, m, N m^2, kg, m/s^2
GAUGE, CELL, SURFACE = 0.3, 0.7, 0.02  # m
INERTIA = '<inertia ixx="0" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{0}"/>'
ARM = f"""<robot name="arm"><link name="base"/>
  <link name="beam"><inertial><origin xyz="1 0 0"/><mass value="6"/>
    {INERTIA.format(2.0)}</inertial></link>
  <link name="tool"><inertial><mass value="{TOOL}"/>{INERTIA.format(0.0)}</inertial></link>
  <joint name="swing" type="revolute"><parent link="base"/><child link="beam"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="9" effort="1e4"/></joint>
  <joint name="tip" type="fixed"><origin xyz="{LENGTH} 0 0"/><parent link="beam"/>
    <child link="tool"/></joint>
  <flexibility>
    <beam link="beam" length="{LENGTH}" SHAPE SEGMENTS>
      <bending direction="y" ei="{EI}" modes="2"/>
      <bending direction="z" ei="{EI}" modes="2" damping_ratio="0.02"/></beam>
    <sensor name="gauge" type="strain_gauge" link="beam" station="{GAUGE}" direction="z"
            surface="{SURFACE}"/>
    <sensor name="moment" type="load_cell" link="beam" station="{CELL}" direction="z"
            component="moment"/>
    <sensor name="shear" type="load_cell" link="beam" station="{CELL}" direction="z"
            component="shear"/>
    <sensor name="across" type="strain_gauge" link="beam" station="{GAUGE}" direction="y"
            surface="{SURFACE}"/>
  </flexibility></robot>"""


def arm(shape: str = 'craig-bampton', segments: int = 1) -> dn.Robot:
    text = ARM.replace('SHAPE', f'shape="{shape}"').replace('SEGMENTS', f'segments="{segments}"')
    return dn.load_robot(text)


def at_rest(robot: dn.Robot) -> Array:
    zero = np.zeros(robot.n)
    return robot.sensor_values(robot.static_deflection([0.0]), zero, zero)


def beyond(station: float, tool: float) -> tuple[float, float]:
    """Weight beyond a station [N] and its moment there [N m]."""
    length = LENGTH - station
    return G * (MASS * length + tool), G * (0.5 * MASS * length**2 + tool * length)


def weights(tool: float, ei: float = EI) -> Array:
    """Closed form: EI u'' of a deflection downwards is minus the moment."""
    return np.array(
        [SURFACE * beyond(GAUGE, tool)[1] / ei, -beyond(CELL, tool)[1], beyond(CELL, tool)[0], 0.0]
    )


@pytest.mark.parametrize(
    ('shape', 'segments'), [('craig-bampton', 1), ('clamped-free', 1), ('', 4)]
)
def test_weight_is_read_exactly_whatever_the_shapes(shape: str, segments: int) -> None:
    robot = arm(shape or 'craig-bampton', segments)
    # what is left is the lever's second order: the tip sags by 2 % of the length
    np.testing.assert_allclose(at_rest(robot), weights(TOOL), rtol=1e-3, atol=1e-12)


def test_payloads_and_stiffness_that_change_live_are_followed() -> None:
    robot = arm()
    at_rest(robot)
    robot.set_payload('tool', 4.0)
    np.testing.assert_allclose(at_rest(robot), weights(TOOL + 4.0), rtol=3e-3, atol=1e-12)
    numbers = robot.diagonals()
    numbers[0] *= 2.0
    robot.set_diagonals(numbers)
    np.testing.assert_allclose(
        at_rest(robot), weights(TOOL + 4.0, 2.0 * EI), rtol=3e-3, atol=1e-12
    )
    np.testing.assert_array_equal(at_rest(robot.copy()), at_rest(robot))
    assert np.allclose(at_rest(arm()), weights(TOOL), rtol=1e-3, atol=1e-12)


def test_derivatives_are_those_of_the_values() -> None:
    robot = arm()
    draw = np.random.default_rng(3)
    states: Array = 0.1 * draw.standard_normal((3, robot.n))
    for k, found in enumerate(robot.sensor_derivatives(states[0], states[1], states[2])):
        change = []
        for j in range(robot.n):
            ends = []
            for step in (1e-5, -1e-5):
                q, qd, qdd = moved = states.copy()
                moved[k, j] += step
                ends.append(robot.sensor_values(q, qd, qdd))
            change.append(ends[0] - ends[1])
        scale = np.abs(found).max(axis=1, keepdims=True) + 1e-12
        np.testing.assert_allclose(np.array(change).T / 2e-5 / scale, found / scale, atol=1e-6)


def test_rows_of_states_and_a_moving_base_are_read_one_by_one() -> None:
    robot = arm()
    draw = np.random.default_rng(4)
    q, qd, qdd = 0.1 * draw.standard_normal((3, 5, robot.n))
    values = robot.sensor_values(q, qd, qdd)
    np.testing.assert_allclose(values[2], robot.sensor_values(q[2], qd[2], qdd[2]), rtol=1e-12)
    # a lift that falls freely: nothing has a weight
    zero, falls = np.zeros(robot.n), (np.zeros(6), np.array([0, 0, -G, 0, 0, 0]))
    np.testing.assert_allclose(robot.sensor_values(zero, zero, zero, base=falls), 0.0, atol=1e-12)
    assert at_rest(robot)[2] > 40.0
