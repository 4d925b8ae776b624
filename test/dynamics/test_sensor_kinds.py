"""A new type of sensor is a row of a table: model, readings, numbers and MuJoCo follow from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from segmented_robots import spatial_text
from strategies import random_state

import denoc_ros as dn
from denoc_ros.bags.series import read_readings
from denoc_ros.bags.writer import BagWriter
from denoc_ros.export.mjcf import mjcf
from denoc_ros.model import tree as sensor_types
from denoc_ros.model.numbers import values_of
from denoc_ros.model.sensors import inertial_values, message_place

ON_BEAM = 'link="upper" station="0.6" direction="{}" topic="/{}"'
ON_LINK = 'link="upper" station="0.6" xyz="0.1 0.2 0" rpy="0.3 -0.5 1.1" gyro_noise="0.1"'


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> dn.Robot:
    """Return an arm whose sensors of new types measure a part of those of known types."""
    cell = sensor_types.BeamSensorKind('moment')
    gyroscope = sensor_types.InertialSensorKind(('gyro',), 'sensor_msgs/msg/Imu')
    monkeypatch.setitem(sensor_types.BEAM_SENSORS, 'torque_cell', cell)
    monkeypatch.setitem(sensor_types.INERTIAL_SENSORS, 'gyroscope', gyroscope)
    beams = [
        f'<sensor name="{kind}_{axis}" type="{kind}" {more} {ON_BEAM.format(axis, kind)}/>'
        for axis in 'yz'
        for kind, more in (('load_cell', 'component="moment"'), ('torque_cell', ''))
    ]
    links = [f'<sensor name="{kind}" type="{kind}" {ON_LINK}/>' for kind in ('imu', 'gyroscope')]
    text = spatial_text(1, ''.join((*beams, *links)))
    return dn.load_robot(text, gravity=(0.7, -1.3, -9.6))


def test_readings_and_their_derivatives_are_those_of_the_quantity(robot: dn.Robot) -> None:
    state = random_state(robot.coordinate_names, 3)
    q, qd, qdd = state.q, state.qd, state.qdd
    names = list(robot.sensor_names)
    known = [names.index(f'load_cell_{axis}') for axis in 'yz']
    known += [names.index(f'imu/gyro_{axis}') for axis in 'xyz']
    new = [names.index(f'torque_cell_{axis}') for axis in 'yz']
    new += [names.index(f'gyroscope/gyro_{axis}') for axis in 'xyz']
    stiffer = robot.with_overrides({'beam.upper.y.ei': 12.0})
    for one in (robot, stiffer):
        loaded = one.sensor_values(q, qd, qdd)
        for values in (loaded, one.sensor_values(q)):
            np.testing.assert_array_equal(values[new], values[known])
        assert np.abs(loaded[known]).min() > 0.0
        for rows in one.sensor_derivatives(q, qd, qdd):
            np.testing.assert_array_equal(rows[new], rows[known])


def test_numbers_and_deviations_are_those_that_it_has(robot: dn.Robot) -> None:
    paths = [path for path in values_of(robot.tree) if path.startswith('sensor.gyroscope.')]
    assert paths == ['sensor.gyroscope.gyro_noise', 'sensor.gyroscope.gyro_bias']
    own = [value for value in inertial_values(robot.tree) if value.name.startswith('gyroscope')]
    assert [(value.kind, value.noise) for value in own] == [('gyro', 0.1)] * 3


def test_mujoco_reads_the_same(robot: dn.Robot) -> None:
    text = mjcf(robot.tree, robot.gravity_in_base).text
    known = text[
        text.index('name="sensor/load_cell_y"') : text.index('name="sensor/torque_cell_y"')
    ]
    new = text[text.index('name="sensor/torque_cell_y"') : text.index('name="sensor/load_cell_z"')]
    assert new == known.replace('load_cell', 'torque_cell')
    assert 'name="gyroscope/gyro"' in text
    assert 'name="gyroscope/accelerometer"' not in text


def test_wrench_in_a_bag_is_read_as_a_load_cells(robot: dn.Robot, tmp_path: Path) -> None:
    wrench = {'force': {'x': 1.0, 'y': 2.0, 'z': 3.0}, 'torque': {'x': 4.0, 'y': 5.0, 'z': 6.0}}
    kind = 'geometry_msgs/msg/WrenchStamped'
    with BagWriter(tmp_path / 'run.mcap') as bag:
        bag.add_topic('/torque_cell', kind)
        bag.write_message('/torque_cell', 7, wrench=wrench)
    found = {
        sensor.name: read_readings(
            tmp_path / 'run.mcap', sensor.topic, [message_place(sensor, robot.tree)]
        )[1][:, 0].tolist()
        for sensor in robot.tree.sensors
        if sensor.type == 'torque_cell'
    }
    assert found == {'torque_cell_y': [6.0], 'torque_cell_z': [5.0]}
