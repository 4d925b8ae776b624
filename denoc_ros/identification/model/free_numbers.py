"""Numbers of a robot that may be free, and how each enters the model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.numbers import values_of
from denoc_ros.model.payloads import carrying_links, payloads_of
from denoc_ros.types import Array

SMALL_RATIO = 0.01  # what a damping ratio that is 0 changes by
SMALL_FRICTION = 0.02  # the same of friction, of the joint's largest torque
OFFSET = 0.1  # of effort, of its largest
PAYLOAD = 0.1  # of the robot's mass: a payload's where the model has none, at most 1 kg
LEVER = 0.1  # m, of a payload's centre of mass
DELAY = 0.01  # s
INERTIAL_OFFSET = {'gyro': 0.1, 'accel': 1.0}  # rad/s, m/s^2: of sensors that were not recorded
POSE_OFFSET = 0.1  # m or rad, between a tracker's axes and the robot's
POSE_PARTS = ('x', 'y', 'z', 'rx', 'ry', 'rz')


@dataclass(frozen=True)
class Number:
    """A number that may be free.

    Attributes
    ----------
    path : str
    value : float
        As the robot has it.
    scale : float
        What it changes by per theta; of a positive one the least size that counts.
    positive : bool
        It is value times exp(theta).
    run : str
        The recording whose number it is; '': all of them share it.
    """

    path: str
    value: float
    scale: float
    positive: bool
    run: str = ''

    @property
    def shared_path(self) -> str:
        """The path without the recording."""
        return self.path.removesuffix(f'[{self.run}]') if self.run else self.path

    def in_run(self, run: str) -> Number:
        """Return the same number of one recording: `effort.joint_1.offset[monday.mcap]`."""
        return replace(self, path=f'{self.path}[{run}]', run=run)

    def at(self, theta: float) -> float:
        """Return the number at a coordinate of the search."""
        if self.positive:
            return float(self.value * np.exp(theta))
        return float(self.value + self.scale * theta)


def free_numbers(
    robot: Robot, efforts: Mapping[str, float], spreads: Mapping[str, float]
) -> list[Number]:
    """Return every number of a robot that may be free.

    Parameters
    ----------
    robot : Robot
    efforts : dict of str to float
        The largest measured torque of each joint.
    spreads : dict of str to float
        By how much the value of each sensor was measured to vary, by its name.
    """
    found: list[Number] = []
    for path, value in values_of(robot.tree).items():
        found.extend(_of_model(path, float(np.ravel(np.asarray(value))[0]), efforts, spreads))
    for body in robot.tree.bodies:
        if body.joint is not None:
            joint = body.joint.name
            found.append(Number(f'effort.{joint}.gain', 1.0, 0.0, True))
            scale = OFFSET * efforts.get(joint, 1.0)
            found.append(Number(f'effort.{joint}.offset', 0.0, scale, False))
    for link in carrying_links(robot.tree):
        mass, centre = payload_of(robot, link)
        found.append(_positive(f'payload.{link}.mass', mass, _payload_scale(robot)))
        found.extend(
            Number(f'payload.{link}.com.{axis}', float(value), LEVER, False)
            for axis, value in zip('xyz', centre, strict=True)
        )
    found.extend(_of_channels(robot, spreads))
    return found


def _of_channels(robot: Robot, spreads: Mapping[str, float]) -> Iterator[Number]:
    """Yield parameters of the sensors: delays, axes, biases."""
    for sensor in robot.tree.sensors:
        yield Number(f'delay.{sensor.name}', 0.0, DELAY, False)
    yield Number('delay.effort', 0.0, DELAY, False)
    for inertial in robot.tree.inertial_sensors:
        yield Number(f'delay.{inertial.name}', 0.0, DELAY, False)
        for part in inertial.parts:
            usual = INERTIAL_OFFSET[part.partition('_')[0]]
            spread = spreads.get(f'{inertial.name}/{part}', usual)
            yield Number(f'sensor.{inertial.name}.gain.{part}', 1.0, 0.0, True)
            yield Number(f'sensor.{inertial.name}.offset.{part}', 0.0, spread or usual, False)
    for frame in robot.tree.frames:
        yield Number(f'delay.pose.{frame}', 0.0, DELAY, False)
        for part in POSE_PARTS:
            yield Number(f'pose.{frame}.offset.{part}', 0.0, POSE_OFFSET, False)


def _of_model(
    path: str, value: float, efforts: Mapping[str, float], spreads: Mapping[str, float]
) -> list[Number]:
    """Return the number of a path of the model; none where it is no number to be identified."""
    kind, _, rest = path.partition('.')
    name, _, term = rest.rpartition('.')
    if kind == 'beam':
        return [_positive(path, value, 0.0 if term in ('ei', 'gj') else SMALL_RATIO)]
    if kind == 'flexible':
        return [_positive(path, value, 0.0 if term == 'stiffness' else SMALL_RATIO)]
    if kind == 'joint' and term == 'stiffness':
        return [Number(path, value, 0.0, True)]
    if kind == 'joint' and (value > 0.0 or term in ('damping', 'friction', 'armature')):
        return [_positive(path, value, SMALL_FRICTION * efforts.get(name, 1.0))]
    if kind == 'sensor' and term == 'gain':
        return [Number(path, value, 0.0, True)]
    if kind == 'sensor' and term == 'offset':
        return [Number(path, value, spreads.get(name, 0.0) or abs(value) or 1.0, False)]
    return []


def _positive(path: str, value: float, scale: float) -> Number:
    """Return a number that must not be negative; one that is 0 starts from its scale's share."""
    return Number(path, value if value > 0.0 else scale, scale, True)


def _payload_scale(robot: Robot) -> float:
    """Return the least mass of a payload that counts [kg]."""
    beams = [body.beam for body in robot.tree.bodies if body.beam is not None]
    mass = sum(body.inertia.mass for body in robot.tree.bodies)
    mass += sum(beam.mass_per_length * beam.length for beam in beams)
    mass += sum(body.modes.link.mass for body in robot.tree.bodies if body.modes is not None)
    return min(1.0, PAYLOAD * mass) or 1.0


def unit_of(path: str) -> str:
    """Return the unit of a number that may have any sign, '' of a sensor's own."""
    kind, _, rest = path.partition('[')[0].partition('.')
    if kind == 'link':
        return 'kg m' if '.first_moment.' in rest else 'kg m^2'
    if kind == 'pose':
        return 'rad' if rest.rpartition('.')[2] in ('rx', 'ry', 'rz') else 'm'
    if kind == 'sensor':
        part = rest.rpartition('.')[2].partition('_')[0]
        return {'gyro': 'rad/s', 'accel': 'm/s^2'}.get(part, '')
    return {'delay': 's', 'effort': 'N m or N', 'payload': 'm'}.get(kind, '')


def payload_of(robot: Robot, link: str) -> tuple[float, Array]:
    """Return mass and centre of mass (3,) of the payload that the model has on a link."""
    found = payloads_of(robot.tree.overrides, robot.tree).get(link)
    return (0.0, np.zeros(3)) if found is None else (found.mass, found.com)
