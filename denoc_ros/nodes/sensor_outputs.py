"""The simulated robot's sensors as topics: raw values, as the real ones would send them."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.tree import InertialSensor, Sensor
from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.messages import (
    STATE,
    CommandMessage,
    FloatMessage,
    InertialMessage,
    message_class,
    raw_publish,
)
from denoc_ros.types import Array


class SensorOutputs:
    """Publishes raw = (value + noise - offset) / gain of every sensor that has a topic.

    A topic of one sensor without `field` is a Float64; one whose sensors have indices as fields
    a Float64MultiArray; any other a JointState whose names are the fields (else the sensors').

    Parameters
    ----------
    node : DenocNode
    robot : Robot
    noisy : bool
        Whether each sensor's `noise` is added.
    generator : numpy.random.Generator
    """

    def __init__(
        self, node: DenocNode, robot: Robot, noisy: bool, generator: np.random.Generator
    ) -> None:
        self._places = [k for k, sensor in enumerate(robot.tree.sensors) if sensor.topic]
        sensors = [sensor for sensor in robot.tree.sensors if sensor.topic]
        self._gain = np.array([sensor.gain for sensor in sensors])
        self._offset = np.array([sensor.offset for sensor in sensors])
        self._deviation = np.array([sensor.noise if noisy else 0.0 for sensor in sensors])
        self._noise, self._raw = np.zeros((2, len(sensors)))
        self._generator = generator
        self._topics = [
            _Topic(node, topic, [(k, s) for k, s in enumerate(sensors) if s.topic == topic])
            for topic in dict.fromkeys(sensor.topic for sensor in sensors)
        ]

    def __bool__(self) -> bool:
        return bool(self._topics)

    def send(self, stamp_ns: int, values: Array) -> None:
        """Publish readings of all sensors of the robot, from their values (sensors,)."""
        raw = self._raw
        np.take(values, self._places, out=raw)
        self._generator.standard_normal(out=self._noise)
        self._noise *= self._deviation
        raw += self._noise
        raw -= self._offset
        raw /= self._gain
        for topic in self._topics:
            topic.send(stamp_ns, raw)


class _Topic:
    """One topic: which raw values go where in which message."""

    def __init__(self, node: DenocNode, topic: str, members: list[tuple[int, Sensor]]) -> None:
        self._from = np.array([k for k, _ in members], dtype=np.intp)
        fields = [sensor.field for _, sensor in members]
        names = [sensor.field or sensor.name for _, sensor in members]
        self._to = np.arange(len(members))
        if fields == ['']:
            single = FloatMessage()
            self._message: FloatMessage | CommandMessage | JointStateMessage = single
            self._values, kind = single.values, Float64
        elif all(field.isdecimal() for field in fields):
            self._to = np.array([int(field) for field in fields], dtype=np.intp)
            array = CommandMessage([str(k) for k in range(int(self._to.max()) + 1)])
            self._message, self._values, kind = array, array.values, Float64MultiArray
        else:
            state = JointStateMessage(names, ('position',))
            self._message, self._values, kind = state, state.position, JointState
        self._publish = raw_publish(node.create_publisher(kind, topic, STATE))

    def send(self, stamp_ns: int, raw: Array) -> None:
        self._values[self._to] = raw[self._from]
        self._publish(self._message.bytes(stamp_ns))


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
        count, kind = len(sensor.parts), sensor.kind
        self._part, self._columns = slice(sensor.first, sensor.first + count), kind.columns
        self._motion = np.zeros(6)
        self._deviation, self._bias = np.zeros((2, count))
        self._is_noisy = noisy
        if noisy:
            self._deviation = sensor.deviations('noise')
            self._bias = sensor.deviations('bias') * generator.standard_normal(count)
        noise = {name: getattr(sensor, f'{name}_noise') for name in kind.vectors}
        self._message = InertialMessage(kind.message, sensor.name, noise if noisy else {})
        publisher = node.create_publisher(message_class(kind.message), sensor.topic, STATE)
        self._publish = raw_publish(publisher)

    def send(self, stamp_ns: int, values: Array, generator: np.random.Generator) -> None:
        """Publish this sensor's part of all values, with bias and noise."""
        reading = values[self._part] + self._bias
        if self._is_noisy:
            reading += self._deviation * generator.standard_normal(len(reading))
        self._motion[self._columns] = reading
        self._message.write(self._motion)
        self._publish(self._message.bytes(stamp_ns))
