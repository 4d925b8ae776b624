"""`<sensor type="imu">` in the file: what it makes, and what it refuses."""

from __future__ import annotations

import pytest
from small_robots import ARM

from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.numbers import values_of
from denoc_ros.model.overrides import with_overrides
from denoc_ros.model.reading.urdf import load_tree

IMU = (
    '<sensor name="imu" type="imu" link="upper_arm" station="3" xyz="0 0.1 0" rpy="0 0 1"'
    ' topic="imu" gyro_noise="1e-3" accel_noise="0.02" gyro_bias="0.01" accel_bias="0.2"/>'
)
TAP = '<sensor name="tap" type="accelerometer" link="tool" accel_noise="0.1"/>'
GOOD = ARM.replace('<sensor name="gauge"', f'{IMU}<sensor name="gauge"').replace(
    '<actuator', f'{TAP}<actuator'
)
BAD = [
    (' station="3"', '', "sensor 'imu': station must be >= 0 m, got nothing"),
    ('station="3"', 'station="-1"', "sensor 'imu': station must be >= 0 m, got -1"),
    ('station="3"', 'station="x"', "sensor 'imu': station must be >= 0 m, got 'x'"),
    ('type="imu" link="upper_arm"', 'type="imu" link="arm"', "link must be a link .*, got 'arm'"),
    (
        'link="tool" accel',
        'link="tool" station="0.1" accel',
        "sensor 'tap': station must not stand for a link without a <beam>; xyz says where it is, "
        "got '0.1'",
    ),
    ('xyz="0 0.1 0" rpy', 'xyz="0 0.1" rpy', "sensor 'imu': xyz must be three finite numbers"),
    ('rpy="0 0 1" topic', 'rpy="0 nan 1" topic', "sensor 'imu': rpy must be three finite"),
    ('gyro_noise="1e-3"', 'gyro_noise="-1"', 'gyro_noise must be >= 0 rad/s, got -1'),
    ('accel_bias="0.2"', 'accel_bias="inf"', "accel_bias must be >= 0 m/s\\^2, got 'inf'"),
    ('accel_noise="0.1"', 'gyro_noise="0.1"', "sensor 'tap': attribute .*, got 'gyro_noise'"),
    ('gyro_noise="1e-3"', 'gain="2"', "sensor 'imu': attribute of <sensor> must .*, got 'gain'"),
    ('name="tap"', 'name="imu"', "sensor 'imu': name must be unique, got it twice"),
    ('type="accelerometer"', 'type="compass"', 'type must be one of .*imu, accelerometer, got'),
]


@pytest.mark.parametrize(('good', 'bad', 'message'), BAD)
def test_bad_ones_are_findings(good: str, bad: str, message: str) -> None:
    assert GOOD.count(good) == 1
    with pytest.raises(ModelError, match=message):
        load_tree(GOOD.replace(good, bad))


def test_values_stand_in_file_order() -> None:
    tree = load_tree(GOOD)
    assert [sensor.first for sensor in tree.inertial_sensors] == [0, 9]
    assert tree.sensor_names[:7] == (
        'imu/gyro_x', 'imu/gyro_y', 'imu/gyro_z', 'imu/accel_x', 'imu/accel_y', 'imu/accel_z',
        'gauge',
    )  # fmt: skip
    assert tree.sensor_names[9:] == ('tap/accel_x', 'tap/accel_y', 'tap/accel_z')
    assert tree.beam_sensor_places == [6, 7, 8]


def test_a_station_beyond_the_tip_is_the_tip_with_a_warning() -> None:
    tree = load_tree(GOOD.replace('station="3"', 'station="7"'))
    assert tree.inertial_sensors[0].mount.station == 6.0
    message = "sensor 'imu': station must be at most the length 6 m of beam 'upper_arm', got 7"
    assert any(message in warning for warning in tree.warnings)


def test_noise_and_bias_are_overridden() -> None:
    tree = load_tree(GOOD)
    values = values_of(tree)
    assert values['sensor.imu.gyro_bias'] == 0.01
    assert 'sensor.tap.gyro_bias' not in values
    changed = with_overrides(tree, {'sensor.imu.accel_noise': 0.5, 'sensor.tap.accel_bias': 0.3})
    assert changed.inertial_sensors[0].accel_noise == 0.5
    assert changed.inertial_sensors[1].accel_bias == 0.3
    with pytest.raises(ConfigError, match=r'sensor.imu.<gyro_noise\|accel_noise\|gyro_bias'):
        with_overrides(tree, {'sensor.imu.gain': 2.0})
