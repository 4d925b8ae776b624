"""`<sensor>`: the reading of a gauge, load cell or deflection sensor from the amplitudes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from denoc_ros.model.beams.segments import locate
from denoc_ros.model.reading.findings import Element, Findings, Reader
from denoc_ros.model.tree import (
    BEAM_SENSORS,
    INERTIAL_SENSORS,
    INERTIAL_UNITS,
    Beam,
    BeamSensorKind,
    ComponentModes,
    InertialElement,
    Sensor,
    SensorElement,
    Tree,
)
from denoc_ros.types import Array

COMMON = ('name', 'type', 'link', 'station', 'direction', 'gain', 'offset', 'noise')
ON_MESH = ('name', 'type', 'link', 'point', 'gain', 'offset', 'noise')
# of geometry_msgs/WrenchStamped, in its order
WRENCH_FIELDS = ('force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z')


def read_sensor(
    element: Element,
    flexible: Collection[str],
    components: Collection[str],
    names: set[str],
    findings: Findings,
) -> SensorElement | None:
    """Return a sensor, None if it has findings.

    Parameters
    ----------
    names : set of str
        Names of the sensors before it; its own is added.
    """
    before, name = len(findings.items), element.get('name', '')
    reader = Reader(element, f'sensor {name!r}', findings)
    type_ = reader.choice('type', (*BEAM_SENSORS, *INERTIAL_SENSORS))
    kind = BEAM_SENSORS.get(type_, BeamSensorKind('', ('surface', 'component')))
    link = element.get('link', '')
    on_mesh = link in components
    if on_mesh:
        reader.only((*ON_MESH, 'topic', 'field'))
        if type_ and not kind.on_mesh:
            known = [name for name, each in BEAM_SENSORS.items() if each.on_mesh]
            listed = ', '.join((*known, *INERTIAL_SENSORS))
            reader.fail('type', f'be one of {listed} on a <flexible>', type_)
    else:
        reader.only((*COMMON, *kind.attributes, 'topic', 'field'))
    reader.unique_name(names)
    reader.text('link')
    if link and link not in flexible and not on_mesh:
        reader.fail('link', 'be a link with a <beam> or a <flexible>', link)
    gain = reader.number('gain', default=1.0)
    if gain == 0.0:
        reader.fail('gain', 'not be zero', 0)
    own = kind.attributes if type_ and not on_mesh else ()
    sensor = SensorElement(
        name,
        type_,
        link,
        0.0 if on_mesh else reader.number('station', 'm', least=0.0),
        '' if on_mesh else reader.choice('direction', ('y', 'z')),
        reader.number('surface', 'm') if 'surface' in own else 0.0,
        reader.choice('component', ('moment', 'shear')) if 'component' in own else '',
        gain,
        reader.number('offset', default=0.0),
        reader.number('noise', least=0.0, default=0.0),
        reader.text('topic', ''),
        reader.text('field', ''),
        reader.text('point') if on_mesh else '',
    )
    return sensor if len(findings.items) == before else None


def sensor_row(element: SensorElement, beam: Beam, station: float) -> Array:
    """Return the derivative of a sensor's value by the amplitudes of its segment.

    Parameters
    ----------
    beam : Beam
        The segment of its link's beam that holds it, bending in the sensor's direction.
    station : float
        On the segment [m].

    Returns
    -------
    ndarray (ny + nz + nt,)
        -surface s'' (strain), s (deflection), (EI s'')' (shear force), and the bending moment,
        -EI s'' about z for a deflection along y, EI s'' about y for one along z. Force
        and moment are those on the part outboard of the station, in the segment's axes.
    """
    deformation = beam.bending(element.direction)
    shapes, at = deformation.shapes, np.array([station])
    if element.quantity == 'strain':
        part = -element.surface * shapes.curvatures(at)
    elif element.quantity == 'deflection':
        part = shapes.values(at)
    elif element.quantity == 'shear':
        share = at / beam.length
        part = deformation.stiffness_at(share)[:, None] * shapes.third_derivatives(at)
        slope = deformation.stiffness / beam.length * deformation.along.values(share, 1)
        part = part + slope[:, None] * shapes.curvatures(at)
    else:
        sign = -1.0 if element.direction == 'y' else 1.0
        part = sign * deformation.stiffness_at(at / beam.length)[:, None] * shapes.curvatures(at)
    return _among_all(element, beam, part[0])


def deflection_row(
    element: SensorElement, beams: Sequence[Beam], segment: int, station: float
) -> Array:
    """Return the derivative of a small deflection by all amplitudes up to its segment.

    Parameters
    ----------
    element : SensorElement
        A deflection sensor.
    beams : sequence of Beam
        The segments of its link's beam.
    segment : int
        Which of them holds it, from 0.
    station : float
        On that segment [m].

    Returns
    -------
    ndarray ((segment + 1) (ny + nz + nt),)
        s(tip) + lever s'(tip) of the segments inboard, s of its own.
    """
    rows = []
    for k, beam in enumerate(beams[:segment]):
        shapes, tip = beam.bending(element.direction).shapes, np.array([beam.length])
        value, slope = shapes.values(tip)[0], shapes.slopes(tip)[0]
        lever = (segment - 1 - k) * beam.length + station
        rows.append(_among_all(element, beam, value + lever * slope))
    return np.concatenate([*rows, sensor_row(element, beams[segment], station)])


def _among_all(element: SensorElement, beam: Beam, part: Array) -> Array:
    """Return a row over all amplitudes of a segment from one over those of its direction."""
    ny, nz, nt = beam.modes
    row = np.zeros(ny + nz + nt)
    first = 0 if element.direction == 'y' else ny
    row[first : first + len(part)] = part
    return row


def make_sensor(element: SensorElement, body: int, beams: Sequence[Beam]) -> Sensor:
    """Return the sensor of a beam, given the index of its first segment's body."""
    beam = beams[0]
    segment, station = locate(beam.whole_length, beam.segments, element.station)
    if element.quantity == 'deflection' and segment > 0:
        row = deflection_row(element, beams, segment, station)
    else:
        body, row = body + segment, sensor_row(element, beams[segment], station)
    element = replace(element, station=min(element.station, beam.whole_length))
    return Sensor(**vars(element), body=body, row=row)


def make_strain_sensor(element: SensorElement, body: int, modes: ComponentModes) -> Sensor:
    """Return the gauge on a strain point of a link reduced from finite elements."""
    return Sensor(**vars(element), body=body, row=modes.link.strain[element.point].row)


def message_place(sensor: Sensor, tree: Tree) -> tuple[str, str, int]:
    """Return where a message has a sensor's reading.

    Its name, its field, and its component of a wrench: the field, else by direction.
    """
    wrench = sensor.field
    if wrench not in WRENCH_FIELDS:
        beam = tree.bodies[sensor.body].beam
        bends_y = beam is not None and bool(np.any(sensor.row[: beam.modes[0]]))
        if sensor.quantity == 'shear':
            wrench = 'force.y' if bends_y else 'force.z'
        else:
            wrench = 'torque.z' if bends_y else 'torque.y'
    return sensor.name, sensor.field, WRENCH_FIELDS.index(wrench)


# IMUs and accelerometers ------------------------------------------------------------------------

PLACED = ('name', 'type', 'link', 'station', 'xyz', 'rpy', 'topic')


def deviation_fields(type_: str) -> tuple[str, ...]:
    """Return the attributes of an inertial sensor that are standard deviations; of any for ''."""
    kind = INERTIAL_SENSORS.get(type_)
    vectors = INERTIAL_UNITS if kind is None else kind.vectors
    return tuple(f'{vector}_{cause}' for cause in ('noise', 'bias') for vector in vectors)


class SensorValue(NamedTuple):
    """One value of a sensor; noise and bias are its standard deviations, in its unit."""

    name: str  # such as imu/gyro_x
    place: int  # among the values of all sensors, in file order
    noise: float
    bias: float  # of a constant that is not known
    topic: str
    kind: str  # beam, or a vector of `INERTIAL_UNITS`


def inertial_values(tree: Tree) -> tuple[SensorValue, ...]:
    """Return the values of a robot's inertial sensors, in file order."""
    found = []
    for sensor in tree.inertial_sensors:
        spreads = sensor.deviations('noise').tolist(), sensor.deviations('bias').tolist()
        for k, (part, noise, bias) in enumerate(zip(sensor.parts, *spreads, strict=True)):
            name, vector = f'{sensor.name}/{part}', part.partition('_')[0]
            found.append(SensorValue(name, sensor.first + k, noise, bias, sensor.topic, vector))
    return tuple(found)


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
    first : int
        Place of its first value among those of all sensors.
    """
    before, name = len(findings.items), element.get('name', '')
    reader = Reader(element, f'sensor {name!r}', findings)
    type_ = reader.choice('type', tuple(INERTIAL_SENSORS))
    own = deviation_fields(type_)
    reader.only((*PLACED, *own))
    reader.unique_name(names)
    link = reader.text('link')
    if link and link not in links:
        reader.fail('link', 'be a link of the robot', link)
    station = _read_station(reader, link, links, flexible)
    numbers = [
        reader.number(field, INERTIAL_UNITS[field.partition('_')[0]], least=0.0, default=0.0)
        if field in own
        else 0.0
        for field in deviation_fields('')
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
