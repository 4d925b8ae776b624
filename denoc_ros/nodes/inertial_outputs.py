"""The simulated robot's IMUs and accelerometers as topics."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import AccelStamped
from sensor_msgs.msg import Imu

from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.tree import InertialSensor
from denoc_ros.nodes.base import STATE, DenocNode
from denoc_ros.nodes.messages import AccelMessage, ImuMessage, raw_publish
from denoc_ros.types import Array


class InertialOutputs:
    """Publishers of the readings of every IMU and accelerometer with a topic.

    Parameters
    ----------
    node : DenocNode
    robot : Robot
    noisy : bool
        Whether noise is added, and a constant bias of each axis that is drawn once.
    generator : numpy.random.Generator
    """

    def __init__(
        self, node: DenocNode, robot: Robot, noisy: bool, generator: np.random.Generator
    ) -> None:
        self._generator = generator
        self._outputs = [
            _Output(node, sensor, noisy, generator)
            for sensor in robot.tree.inertial_sensors
            if sensor.topic
        ]

    def __bool__(self) -> bool:
        return bool(self._outputs)

    def send(self, stamp_ns: int, values: Array) -> None:
        """Publish the readings, from the values of all sensors of the robot."""
        for output in self._outputs:
            output.send(stamp_ns, values, self._generator)


class _Output:
    """One sensor's topic."""

    def __init__(
        self,
        node: DenocNode,
        sensor: InertialSensor,
        noisy: bool,
        generator: np.random.Generator,
    ) -> None:
        count = len(sensor.parts)
        self._part = slice(sensor.first, sensor.first + count)
        gyro, accel = (sensor.gyro_noise, sensor.accel_noise) if noisy else (0.0, 0.0)
        self._deviation = _per_axis(gyro, accel, count)
        bias = _per_axis(sensor.gyro_bias, sensor.accel_bias, count)
        self._bias = bias * generator.standard_normal(count) if noisy else np.zeros(count)
        self._is_noisy = noisy
        kind: type = Imu
        self._message: ImuMessage | AccelMessage
        if sensor.type == 'imu':
            self._message = ImuMessage(sensor.name, gyro, accel)
        else:
            self._message, kind = AccelMessage(sensor.name), AccelStamped
        self._publish = raw_publish(node.create_publisher(kind, sensor.topic, STATE))

    def send(self, stamp_ns: int, values: Array, generator: np.random.Generator) -> None:
        """Publish this sensor's part of all values, with bias and noise."""
        reading = values[self._part] + self._bias
        if self._is_noisy:
            reading += self._deviation * generator.standard_normal(len(reading))
        self._message.write(reading)
        self._message.stamp(stamp_ns)
        self._publish(self._message.bytes())


def _per_axis(gyro: float, accel: float, count: int) -> Array:
    """Return a number for each value: rates first, of which an accelerometer has none."""
    return np.array([gyro] * (count - 3) + [accel] * 3)
