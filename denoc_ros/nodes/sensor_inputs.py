"""The robot's sensors and the motion of its base as inputs of a node's loop."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import AccelStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

from denoc_ros.bags.sensor_messages import READERS
from denoc_ros.dynamics.base.base_motion import BaseMotion
from denoc_ros.estimation.base_track import BaseTrack
from denoc_ros.estimation.stamp_clock import StampClock
from denoc_ros.model.sensors import message_place
from denoc_ros.model.tree import InertialSensor, Sensor, Tree
from denoc_ros.nodes.base.messages import message_class
from denoc_ros.nodes.base.robot_node import RobotNode
from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor
from denoc_ros.runtime.inputs.message_readers import (
    BaseLimits,
    MessageReader,
    imu_mounting,
    read_accel,
    read_imu,
    read_odometry,
)
from denoc_ros.runtime.parameters.shared_parameters import BASE_LIMITS
from denoc_ros.types import Array

SEARCH_PERIOD = 0.5  # s between looks for topics that have appeared
QUEUE = 1024  # values kept for a late tick
# of a message stamp [ns] and raw values, for a sensor of its topic
Reader = Callable[[bytes, 'Member'], tuple[int, list[float]]]


@dataclass(frozen=True)
class Member:
    """A sensor of a topic."""

    sensor: Sensor | InertialSensor
    # place of its first value among those that are fused: one of each sensor on beams, then those
    # of the inertial ones, in file order
    first: int
    place: int = -1  # of a sensor on a beam among those with a topic; -1: it is inertial
    where: tuple[str, str, int] = ('', '', 0)  # a message has its reading

    @property
    def types(self) -> tuple[str, ...]:
        """Message types that it may come as."""
        sensor = self.sensor
        return (sensor.kind.message,) if isinstance(sensor, InertialSensor) else tuple(READERS)


def _imu(raw: bytes) -> tuple[int, Array]:
    stamp_ns, rate, force = read_imu(raw)
    return stamp_ns, np.concatenate((rate, force))


def _accel(raw: bytes) -> tuple[int, Array]:
    stamp_ns, acceleration = read_accel(raw)
    return stamp_ns, np.concatenate((np.zeros(3), acceleration[:3]))


# stamp [ns], angular rate and specific force (6,) of a message
INERTIAL_READERS: dict[str, Callable[[bytes], tuple[int, Array]]] = {
    'sensor_msgs/msg/Imu': _imu,
    'geometry_msgs/msg/AccelStamped': _accel,
}


def reader_of(type_name: str) -> Reader:
    """Return a reader of the messages of a topic."""
    if type_name in READERS:
        read = READERS[type_name]()

        def beam(raw: bytes, member: Member) -> tuple[int, list[float]]:
            stamp_ns, value = read(MessageReader, raw, member.where)
            return stamp_ns, [value]

        return beam
    read_motion = INERTIAL_READERS[type_name]

    def inertial(raw: bytes, member: Member) -> tuple[int, list[float]]:
        assert isinstance(member.sensor, InertialSensor)
        stamp_ns, values = read_motion(raw)
        return stamp_ns, values[member.sensor.kind.columns].tolist()

    return inertial


class SensorInputs:
    """The robot's sensors as inputs of a node.

    Parameters
    ----------
    node : RobotNode
        It subscribes.

    Attributes
    ----------
    sensors : tuple of Sensor
        Those on beams with a topic, in file order.
    places : (k,) array of int
        Where they stand among all the robot's sensors on beams.
    values : (k,) array
        Their newest calibrated values, tare taken off; NaN where none came yet, or where the
        last message lacked it.
    fresh : bool
        Whether one of these has come since the reader last set this to False.
    queue : deque of (place, time, value)
        Values not read yet, of inertial sensors as well: the place among those that are fused,
        when it was measured on the steady clock [s], and the calibrated value.
    """

    def __init__(self, node: RobotNode) -> None:
        self._node = node
        self.sensors: tuple[Sensor, ...] = ()
        self.places = np.zeros(0, dtype=np.intp)
        self.values: Array = np.zeros(0)
        self.fresh = False
        self.queue: deque[tuple[int, float, float]] = deque(maxlen=QUEUE)
        self._tare = np.zeros(0)
        self._members: dict[str, list[Member]] = {}  # by topic
        self._subscribed: set[str] = set()
        self._refused: set[str] = set()

    def update(self, tree: Tree) -> None:
        """Take the sensors of a model; subscriptions stay.

        Values and tare begin anew, unless the sensors are calibrated as they were.
        """
        chosen = [k for k, sensor in enumerate(tree.sensors) if sensor.topic]
        before = [(s.name, s.topic, s.gain, s.offset) for s in self.sensors]
        self.places = np.array(chosen, dtype=np.intp)
        self.sensors = tuple(tree.sensors[k] for k in chosen)
        if [(s.name, s.topic, s.gain, s.offset) for s in self.sensors] != before:
            self.fresh = False
            self.queue.clear()
            self.values, self._tare = np.full(len(chosen), np.nan), np.zeros(len(chosen))
        found = [
            Member(sensor, tree_place, place, message_place(sensor, tree))
            for place, (tree_place, sensor) in enumerate(zip(chosen, self.sensors, strict=True))
        ]
        first = len(tree.sensors)
        for sensor in tree.inertial_sensors:
            if sensor.topic:
                found.append(Member(sensor, first))
            first += len(sensor.parts)
        self._members = {}
        for member in found:
            topic = self._node.resolve_topic_name(member.sensor.topic)
            self._members.setdefault(topic, []).append(member)

    def search(self) -> None:
        """Subscribe to the topics that have appeared since the last call."""
        if self._subscribed.issuperset(self._members):
            return
        for topic, types in self._node.get_topic_names_and_types():
            if topic not in self._members or topic in self._subscribed:
                continue
            allowed = self._members[topic][0].types
            known = [name for name in types if name in allowed]
            if known:
                self._subscribe(topic, known[0])
            elif topic not in self._refused:
                self._refused.add(topic)
                wanted = ', '.join(allowed)
                self._node.get_logger().error(
                    f'sensor topic {topic}: type must be one of {wanted}, got {types}'
                )

    def tare(self, predicted: Array) -> list[str]:
        """Remove the sensors' offsets from `predicted` (k,); return the sensors' names."""
        gap = self.values - predicted
        heard = np.isfinite(gap)
        self._tare[heard] += gap[heard]
        self.values[heard] = predicted[heard]
        return [s.name for s, has in zip(self.sensors, heard, strict=True) if has]

    def _subscribe(self, topic: str, type_name: str) -> None:
        self._subscribed.add(topic)
        read, clock = reader_of(type_name), StampClock()

        def handle(raw: bytes, now: float) -> None:
            known = self._members.get(topic, [])  # of a changed model it may be another sensor's
            members = [each for each in known if type_name in each.types]
            self._take(raw, now, read, members, monitor, clock)

        monitor = self._node.listen_in_loop(message_class(type_name), topic, handle)

    def _take(
        self,
        raw: bytes,
        now: float,
        read_value: Reader,
        members: Sequence[Member],
        monitor: InputMonitor,
        clock: StampClock,
    ) -> None:
        read: list[tuple[Member, int, list[float]]] = []
        refusals: list[tuple[Member, InputError]] = []
        for member in members:
            try:
                stamp_ns, values = read_value(raw, member)
                if not all(map(math.isfinite, values)):
                    name = member.sensor.name
                    raise InputError('non_finite', f'{name} must be finite, got {values[0]}')
            except InputError as error:  # The message's other sensors may be good.
                refusals.append((member, error))
            else:
                read.append((member, stamp_ns, values))
        if refusals and not read:
            raise refusals[0][1]
        stamp_ns = read[0][1] if read else 0
        monitor.accept(stamp_ns, now)
        for member, refusal in refusals:
            self._node.refuse(monitor, refusal)
            if member.place >= 0:
                self.values[member.place] = math.nan
        taken = clock.taken_at(1e-9 * stamp_ns, now, 1e-9 * self._node.stamp_ns_at(now))
        for member, _, values in read:
            if isinstance(member.sensor, Sensor):
                values = [self._calibrated(member.sensor, member.place, values[0])]
            for place, value in enumerate(values, member.first):
                self.queue.append((place, taken, value))

    def _calibrated(self, sensor: Sensor, place: int, raw: float) -> float:
        """Return the value of a sensor on a beam; keep it as its newest."""
        value = sensor.gain * raw + sensor.offset - float(self._tare[place])
        self.values[place], self.fresh = value, True
        return value


class BaseInput:
    """The base's motion as messages say it.

    Parameters
    ----------
    node : RobotNode
        Its parameters `base_motion`, `base_motion_timeout` and `base_motion_cutoff` say how; it
        subscribes.

    Attributes
    ----------
    used : bool
        Whether the node listens to the base's motion.
    """

    def __init__(self, node: RobotNode) -> None:
        self._node = node
        self.source = node.settings.text('base_motion')
        self.used = self.source != 'off'
        self._timeout = node.settings.number('base_motion_timeout')
        self._clock = StampClock()
        self._monitor: InputMonitor | None = None
        self._beside: InputMonitor | None = None
        rate, acceleration, angular = (
            node.settings.number(f'base_{what}_limit') for what, *_ in BASE_LIMITS
        )
        self._limits = BaseLimits(rate, acceleration, angular, self._timeout)
        self.track = BaseTrack(1.0, 1.0, np.zeros(3))

    def build(self, gravity: Array) -> None:
        """Begin anew for a robot with its gravity (3,).

        Raises
        ------
        ConfigError
            The IMU's pose is not of three and three numbers, or there is no IMU.
        """
        settings, node = self._node.settings, self._node.get_fully_qualified_name()
        cutoff = settings.number('base_motion_cutoff')
        xyz, rpy = (settings.numbers(f'base_imu_{part}') for part in ('xyz', 'rpy'))
        mounting = imu_mounting(node, self.source, xyz, rpy)
        self.track = BaseTrack(cutoff, self._timeout, gravity, mounting)

    def connect(self) -> None:
        """Subscribe to the topic that the parameter names."""
        listen = self._node.listen_in_loop
        if self.source in ('odometry', 'odometry_accel'):
            self._monitor = listen(Odometry, 'base_motion', self._on_odometry)
        elif self.source == 'imu':
            self._monitor = listen(Imu, 'base_motion', self._on_imu)
        elif self.source == 'accel':
            self._monitor = listen(AccelStamped, 'base_motion', self._on_accel)
        if self.source == 'odometry_accel':
            self._beside = listen(AccelStamped, 'base_acceleration', self._on_accel)

    def begin(self) -> None:
        """Forget all messages before the loop starts."""
        self.track.reset()
        self._limits.forget()
        self._clock.reset()

    def trouble(self, now: float) -> str:
        """Return why the base's motion is not known, '' if it is or is not listened to."""
        if not self.used:
            return ''
        for monitor, stale, missing in (
            (self._monitor, 'stale base_motion', 'no base_motion yet'),
            (self._beside, 'stale base_acceleration', 'no base_acceleration yet'),
        ):
            if monitor is not None and not monitor.age(now) <= self._timeout:
                return stale if monitor.received else missing
        return 'no base_motion yet' if self.track.at(now) is None else ''

    def at(self, time: float) -> BaseMotion | None:
        """Return the motion at a time of the steady clock [s]; None: at rest, for all we know."""
        return self.track.at(time) if self.used else None

    def _taken(self, monitor: InputMonitor | None, stamp_ns: int, now: float) -> float:
        """Admit a message; return when it was measured on the steady clock."""
        assert monitor is not None
        monitor.accept(stamp_ns, now)
        taken = self._clock.taken_at(1e-9 * stamp_ns, now, 1e-9 * self._node.stamp_ns_at(now))
        return taken if math.isfinite(taken) else now

    def _on_odometry(self, raw: bytes, now: float) -> None:
        stamp_ns, pose, twist = read_odometry(raw)
        measured = _measured(stamp_ns, now)
        self._limits.require(measured, twist)
        self.track.take_odometry(self._taken(self._monitor, stamp_ns, now), pose, twist)
        self._limits.took(measured, twist)

    def _on_accel(self, raw: bytes, now: float) -> None:
        stamp_ns, acceleration = read_accel(raw)
        self._limits.require(now, None, acceleration)
        alone = self._beside is None
        monitor = self._monitor if alone else self._beside
        self.track.take_acceleration(self._taken(monitor, stamp_ns, now), acceleration, alone)

    def _on_imu(self, raw: bytes, now: float) -> None:
        stamp_ns, rate, force = read_imu(raw)
        measured, twist = _measured(stamp_ns, now), np.concatenate((np.zeros(3), rate))
        self._limits.require(measured, twist, force)
        self.track.take_imu(self._taken(self._monitor, stamp_ns, now), rate, force)
        self._limits.took(measured, twist)


def _measured(stamp_ns: int, now: float) -> float:
    """Return when a reading was taken [s], for differences."""
    return 1e-9 * stamp_ns if stamp_ns else now
