"""`<sensor type="imu">` and `type="accelerometer"`: clipped on a link, flexible or not."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal, NamedTuple

from denoc_ros.model.findings import Element, Findings, Reader
from denoc_ros.model.tree import INERTIAL_PARTS, Attachment, InertialSensor, Tree
from denoc_ros.types import Array

COMMON = ('name', 'type', 'link', 'station', 'xyz', 'rpy', 'topic', 'accel_noise', 'accel_bias')
GYRO = ('gyro_noise', 'gyro_bias')
OWN: dict[str, tuple[str, ...]] = {'imu': GYRO, 'accelerometer': ()}
UNITS = {'gyro': 'rad/s', 'accel': 'm/s^2'}


class SensorValue(NamedTuple):
    """One value of a sensor; noise and bias are its standard deviations, in its unit."""

    name: str  # such as imu/gyro_x
    place: int  # among the values of all sensors, in file order
    noise: float
    bias: float  # of a constant that is not known
    topic: str
    kind: Literal['beam', 'gyro', 'accel']


def inertial_values(tree: Tree) -> tuple[SensorValue, ...]:
    """Return the values of a robot's inertial sensors, in file order."""
    found = []
    for sensor in tree.inertial_sensors:
        for place, part in enumerate(sensor.parts, sensor.first):
            name = f'{sensor.name}/{part}'
            if part.startswith('gyro'):
                noise, bias = sensor.gyro_noise, sensor.gyro_bias
                found.append(SensorValue(name, place, noise, bias, sensor.topic, 'gyro'))
            else:
                noise, bias = sensor.accel_noise, sensor.accel_bias
                found.append(SensorValue(name, place, noise, bias, sensor.topic, 'accel'))
    return tuple(found)


@dataclass(frozen=True)
class InertialElement:
    """The sensor as the file says it."""

    name: str
    type: str  # imu | accelerometer
    link: str
    station: float | None  # m, on a link with a beam
    origin: Array  # (4, 4) of its axes, seen from the section or the link frame
    topic: str
    first: int  # place of its first value among those of all sensors
    gyro_noise: float  # rad/s
    accel_noise: float  # m/s^2
    gyro_bias: float  # rad/s
    accel_bias: float  # m/s^2

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of its values."""
        return INERTIAL_PARTS[self.type]


def read_inertial_sensor(
    element: Element,
    links: Collection[str | None],
    flexible: Collection[str],
    names: set[str],
    first: int,
    findings: Findings,
) -> InertialElement | None:
    """Return an IMU or accelerometer, None if it has findings.

    Parameters
    ----------
    element : lxml element
        `<sensor>` of one of the types of `OWN`.
    links : collection of str
        The robot's.
    flexible : collection of str
        Those with a beam.
    names : set of str
        Names of the sensors before it; its own is added.
    first : int
        Place of its first value among those of all sensors.
    findings : Findings
        Gathers what is wrong.
    """
    before, name = len(findings.items), element.get('name', '')
    reader = Reader(element, f'sensor {name!r}', findings)
    type_ = reader.choice('type', tuple(OWN))
    reader.only((*COMMON, *OWN.get(type_, GYRO)))
    reader.unique_name(names)
    link = reader.text('link')
    if link and link not in links:
        reader.fail('link', 'be a link of the robot', link)
    station = _read_station(reader, link, links, flexible)
    numbers = [
        reader.number(name, UNITS[name.partition('_')[0]], least=0.0, default=0.0)
        if name in (*COMMON, *OWN.get(type_, GYRO))
        else 0.0
        for name in ('gyro_noise', 'accel_noise', 'gyro_bias', 'accel_bias')
    ]
    topic, origin = reader.text('topic', ''), reader.pose()
    sensor = InertialElement(name, type_, link, station, origin, topic, first, *numbers)
    return sensor if len(findings.items) == before else None


def _read_station(
    reader: Reader, link: str, links: Collection[str | None], flexible: Collection[str]
) -> float | None:
    if link in flexible:
        return reader.number('station', 'm', least=0.0)
    if link in links and reader.element.get('station') is not None:
        rule = 'not stand for a link without a <beam>; xyz says where it is'
        reader.fail('station', rule, reader.element.get('station'))
    return None


def make_inertial_sensor(element: InertialElement, mount: Attachment) -> InertialSensor:
    """Return the sensor, given where its axes are mounted."""
    return InertialSensor(
        element.name,
        element.type,
        element.link,
        mount,
        element.first,
        element.gyro_noise,
        element.accel_noise,
        element.gyro_bias,
        element.accel_bias,
        element.topic,
    )
