"""IMUs, trackers, delays and wild values in what a whole model is identified from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification_runs import recorded, sweeping

import denoc_ros as dn
from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.sources import Recording, RecordingSettings, read_source
from denoc_ros.types import Array

ROBOTS = Path(__file__).resolve().parents[3] / 'config' / 'robots'
IMU = '<sensor name="imu" type="imu" link="link_2" station="7" topic="/imu"/></flexibility>'
TRUTH = {'beam.link_1.y.ei': 1.3e5, 'beam.link_2.y.ei': 0.8e5}


@pytest.fixture(scope='module')
def arm() -> Robot:
    """Return an arm that has an IMU at the tip of its second link."""
    text = (ROBOTS / 'canadarm_gauges.urdf').read_text().replace('</flexibility>', IMU)
    return dn.load_robot(text, gravity=(0, 0, 0)).with_overrides({'payload.tool.mass': 100.0})


@pytest.fixture(scope='module')
def run(arm: Robot) -> Recording:
    """Return what an arm with other beams shows, its tool tracked."""
    return recorded(arm.with_overrides(TRUTH), sweeping(3, 1), 3.0, frames=['tool'])


def only(run: Recording, sensors: tuple[str, ...], poses: tuple[str, ...] = ()) -> Recording:
    """Return a recording without effort, of these sensors and frames."""
    return replace(
        run,
        effort=np.full_like(run.effort, np.nan),
        sensors={name: run.sensors[name] for name in sensors},
        poses={name: run.poses[name] for name in poses},
    )


@pytest.mark.long
def test_an_imu_alone_tells_stiffness_its_biases_gains_and_delay(
    arm: Robot, run: Recording
) -> None:
    t, values = run.sensors['imu']
    bias = np.array([0.0, 0.0, 0.02, 0.1, -0.2, 0.0])
    raw = (values - bias) / np.array([1.0, 1.0, 1.05, 1.0, 0.9, 1.0])
    late = replace(only(run, ('imu',)), sensors={'imu': (t + 0.004, raw)})
    free = ['beam.*.ei', 'delay.imu', 'sensor.imu.offset', 'sensor.imu.gain']
    found = dn.identify_model(arm, late, free)
    for path, value in TRUTH.items():
        assert found.verdict[path] == 'found'
        assert found.values[path] == pytest.approx(value, rel=0.01)
    assert found.values['delay.imu'] == pytest.approx(0.004, abs=3e-4)
    assert found.values['sensor.imu.gain.accel_y'] == pytest.approx(0.9, rel=0.01)
    assert found.values['sensor.imu.gain.gyro_z'] == pytest.approx(1.05, rel=0.01)
    for part, wanted in (('gyro_z', 0.02), ('accel_x', 0.1), ('accel_y', -0.2)):
        assert found.values[f'sensor.imu.offset.{part}'] == pytest.approx(wanted, abs=0.01)
    # an arm in a plane turns about z alone
    assert found.verdict['sensor.imu.gain.gyro_x'] == 'not identifiable'


@pytest.mark.long
def test_a_tracked_tip_tells_stiffness_its_axes_and_delay(arm: Robot, run: Recording) -> None:
    t, poses = run.poses['tool']
    moved = poses.copy()
    moved[:, :3] += (0.02, -0.01, 0.03)
    late = replace(only(run, (), ('tool',)), poses={'tool': (t + 0.003, moved)})
    found = dn.identify_model(arm, late, ['beam.*.ei', 'delay.pose.tool', 'pose.tool.offset'])
    for path, value in TRUTH.items():
        assert found.verdict[path] == 'found'
        assert found.values[path] == pytest.approx(value, rel=0.02)
    assert found.values['delay.pose.tool'] == pytest.approx(0.003, abs=3e-4)
    assert found.values['pose.tool.offset.z'] == pytest.approx(0.03, abs=1e-3)


@pytest.mark.long
def test_wild_values_move_nothing_out_of_its_interval(arm: Robot, run: Recording) -> None:
    draw = np.random.default_rng(5)
    wild = {name: (t, spoiled(draw, values)) for name, (t, values) in run.sensors.items()}
    assert run.velocity is not None
    given = replace(
        run,
        effort=spoiled(draw, run.effort),
        position=spoiled(draw, run.position),
        velocity=spoiled(draw, run.velocity),
        sensors=wild,
        poses={},
    )
    found = dn.identify_model(arm, given, ['beam.*.ei', 'payload.tool.mass', 'delay.effort'])
    for path, value in {**TRUTH, 'payload.tool.mass': 100.0, 'delay.effort': 0.0}.items():
        low, high = found.interval[path]
        assert low <= value <= high
        assert np.isfinite([low, high]).all()
    # an interval as wide as one likes would have the truth in it as well
    for path, value in TRUTH.items():
        assert found.verdict[path] == 'found'
        assert found.values[path] == pytest.approx(value, rel=0.005)


def spoiled(draw: np.random.Generator, values: Array) -> Array:
    """Return values of which one in a hundred is anywhere within ten times the largest."""
    where = draw.random(values.shape) < 0.01
    anywhere = 10.0 * np.abs(values).max() * draw.uniform(-1.0, 1.0, values.shape)
    spoilt: Array = np.where(where, anywhere, values)
    return spoilt


def write_bag(path: Path, run: Recording) -> None:
    """Write joint states, the IMU and the tracked tool as a bag, the tool's on two topics."""
    joints, imu, pose = '/joint_states', '/imu', 'geometry_msgs/msg/PoseStamped'
    with BagWriter(path) as writer:
        writer.add_topic(joints, 'sensor_msgs/msg/JointState')
        writer.add_topic(imu, 'sensor_msgs/msg/Imu')
        for topic in ('/tracker', '/again'):
            writer.add_topic(topic, pose)
        for k, t in enumerate(run.t):
            stamp = round(1e9 * t) + 1_000_000_000
            position, effort = run.position[k].tolist(), run.effort[k].tolist()
            writer.write_message(
                joints, stamp, name=list(run.joints), position=position, effort=effort
            )
            values = [
                dict(zip('xyz', three, strict=True))
                for three in run.sensors['imu'][1][k].reshape(2, 3).tolist()
            ]
            writer.write_message(
                imu, stamp, angular_velocity=values[0], linear_acceleration=values[1]
            )
            at, turned = np.split(run.poses['tool'][1][k], [3])
            whole = {
                'position': dict(zip('xyz', at.tolist(), strict=True)),
                'orientation': dict(zip('xyzw', turned.tolist(), strict=True)),
            }
            for topic in ('/tracker', '/again'):
                writer.write_message(topic, stamp, pose=whole)


def test_imus_and_poses_are_read_from_a_bag(arm: Robot, run: Recording, tmp_path: Path) -> None:
    path = tmp_path / 'run.mcap'
    write_bag(path, run)
    read = read_source(path, arm, RecordingSettings(poses={'/tracker': 'tool'}))
    np.testing.assert_allclose(read.sensors['imu'][1], run.sensors['imu'][1])
    np.testing.assert_allclose(read.sensors['imu'][0], run.t, atol=1e-8)
    np.testing.assert_allclose(read.poses['tool'][1], run.poses['tool'][1])
    with pytest.raises(dn.IdentificationError, match='must name a frame of the robot'):
        read_source(path, arm, RecordingSettings(poses={'/tracker': 'nowhere'}))
    with pytest.raises(dn.BagError, match='must be geometry_msgs/msg/PoseStamped, got'):
        read_source(path, arm, RecordingSettings(poses={'/imu': 'tool'}))
    two = {'/tracker': 'tool', '/again': 'tool'}
    with pytest.raises(dn.IdentificationError, match='each frame once'):
        read_source(path, arm, RecordingSettings(poses=two))


def test_readings_of_another_shape_are_refused(run: Recording) -> None:
    t, values = run.sensors['imu']
    with pytest.raises(dn.IdentificationError, match='imu: readings must have shape'):
        replace(run, sensors={'imu': (t, values[:, :4])})
    with pytest.raises(dn.IdentificationError, match='tool: readings must have shape'):
        replace(run, poses={'tool': (t, values)})
